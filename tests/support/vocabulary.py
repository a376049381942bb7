"""Vocabulary check of documentation, docstrings, comments and displayed texts.

`python -m tests.support.vocabulary [PATH...]` prints `file:line: word: text` for each private word in the given
files and folders (default: ALL), then the counts per word, kind of text and file. Code is not checked: inline code,
link targets and code blocks of Markdown (except comments in them), and string literals without a space. Of tests, whose
string literals are input and expected output, docstrings, comments and the names of the tests are checked.
"""

import ast
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]

TESTS = ROOT / "tests"
ALL = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "docs",
    "benchmarks",
    "configs",
    "examples",
    "hil",
    "plugins/foxglove/README.md",
    "plugins/foxglove/hil_foxglove",
    "sims",
    "tests",
)

# name of the word -> pattern; the field's term or plain English replaces it ("if" for "where", "per" for "a")
WORDS = {
    "whoever": r"whoever|whomever|somebody|nobody|anybody|everybody",
    "say": r"say|says|said|saying",
    "hear": r"hear|hears|heard|hearing",
    "tell": r"tell|tells|told|telling",
    "know": r"know|knows|knew|knowing",
    "believe": r"believe|believes|believed",
    "anew": r"anew",
    "left away": r"(?:left|leave|leaves|leaving) (?:\w+ )?away",
    "fast as time": r"as fast as time|faster than time|slower than time",
    "wall": r"the wall(?![ -]clock)|wall seconds?",
    "lamp": r"lamps?",
    "a word on": r"an? (?!command )(?:\w+ )?words? (?:on|with|for|about)|in words|word for word",
    "picture": r"pictures?|pictured",
    "share": r"shares? of|(?:the|a|an|its|this|same|smaller|larger|smallest|largest|what|given) shares?"
    r"(?! (?:memory|a|an|the|no|one|its))",
    "go on": r"(?:goes|go|went|gone|going) on",
    "where there is": r"where (?:there (?:is|are)|none|nothing|no|one (?:is|was))",
    "beside": r"beside",
    "stations": r"stations?",
    "seat": r"seats?",
    "eye": r"(?<!hand-)eyes?",
    "keeper": r"(?<!rate )keepers?",
    "desk": r"desks?",
    "glide": r"glides?|gliding",
    "liberty": r"liberty|liberties",
    "sieve": r"sieves?",
    "dialect": r"dialects?",
    "blackboard": r"blackboards?",
    "parting": r"partings?",
    "slave": r"slaves?",
    "diary": r"diary|diaries",
    "fitness": r"fitness",
    "reach check": r"reach checks?",
    "supervisor": r"supervisors?",
    "tally": r"tally|tallies",
    "rouse": r"rouses?|roused",
    "obey": r"obey|obeys|obeyed",
    "wish": r"wish|wishes|wished",
    "owed": r"owed|owes",
    "mend": r"mend|mends|mended",
    "complain": r"complains?|complained",
    "err": r"errs?|erred",
    "foreign": r"foreign",
    "chance": r"what chance|that chance|chance (?:makes|made|has|had|draws|drew|does|did)",
    "turn": r"(?:small|the|(?<!half )a|this|its|remaining) turns?(?! (?:of|in|out|to|into|around|on|off|it))",
    "room": r"(?:has|have|is|no|the) (?:much |more |no )?room",
    "ours": r"ours'?",
    "nothing but": r"nothing but",
    "asked back": r"(?:asks?|asked|asking) back",
    "goodbye": r"good-?bye",
    "put right": r"(?:put|puts) right",
    "put down": r"(?:put|puts) down",
    "the begin": r"the begin",
    "laid beside": r"laid (?:over|beside)",
    "opinion": r"opinions?",
    "kindness": r"kindness",
    "stands in": r"stands? (?:in|here|there|beside|at) ",
    "what stands": r"what (?:stands|lies)|lies behind",
    "dear": r"dear|dearer",
    "haste": r"haste",
    "life": r"(?:another|this|its|one) life(?![- ]cycle|time)|says that it lives|lives? on",
    "a, not per": r"times an? (?:second|minute|hour|day|cycle)"
    r"|(?:cycles|frames|images|pictures|messages|datagrams|samples|rows|bytes|[kKMG]B|updates|runs|cases|once|twice"
    r"|seconds|steps|words|commands|poses|packets|requests|events|lines?|file|page) an? (?:second|minute|hour|day"
    r"|cycle|frame|step|case|image|picture|file|run|axis|row|page|core|period|computer|side)",
}
Line = tuple[int, str, str]  # number, kind of text, text

PATTERNS = {word: re.compile(rf"(?<![\w/-])(?:{pattern})(?![\w-])", re.IGNORECASE) for word, pattern in WORDS.items()}
ANY = re.compile(rf"(?<![\w/-])(?:{'|'.join(WORDS.values())})(?![\w-])", re.IGNORECASE)

# legitimate uses of these words, removed from a line before it is checked: terms of the field, titles, physical objects
ALLOWED = re.compile(r"rate keeper|hand-eye|space station|in other words|beside the (?:recording|file)", re.IGNORECASE)


class Finding(NamedTuple):
    """A finding: file, line number, kind of text, entry of WORDS and the line."""

    path: Path
    line: int
    kind: str
    word: str
    text: str

    def __str__(self) -> str:
        """Return the finding as printed, `file:line: word: text`."""
        return f"{self.path}:{self.line}: {self.word}: {self.text}"


def findings(paths: Iterable[Path]) -> list[Finding]:
    """Return the private words in the given files, and in all files with prose of the given folders."""
    files = [file for path in paths for file in (sorted(path.rglob("*")) if path.is_dir() else [path])]
    return [finding for file in files if file.suffix in READERS for finding in _check(file)]


def _check(path: Path) -> Iterator[Finding]:
    for number, kind, text in READERS[path.suffix](path):
        prose = ALLOWED.sub("", text)
        if not ANY.search(prose):
            continue
        for word, pattern in PATTERNS.items():
            if pattern.search(prose):
                yield Finding(path, number, kind, word, text.strip())


def _markdown(path: Path) -> Iterator[Line]:
    """Yield the prose of a page, and the comments of its code blocks; of a changelog only the unreleased part."""
    in_code = False
    releases = 0
    for number, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        releases += path.name == "CHANGELOG.md" and text.startswith("## ")
        if releases > 1:
            return
        if text.lstrip().startswith("```"):
            in_code = not in_code
        elif in_code:
            yield number, "docs", text.partition("#")[2]
        else:
            yield number, "docs", re.sub(r"\]\([^)]*\)|<!--.*?-->", "]", CODE.sub("", text))


def _python(path: Path) -> Iterator[Line]:
    """Yield docstrings, comments and string literals with a space; of tests their names instead of the literals."""
    source = path.read_text(encoding="utf-8")
    is_test = TESTS in path.parents
    for number, comment in _comments(source):
        yield number, "comment", CODE.sub("", comment)
    nodes = list(ast.walk(ast.parse(source)))
    # a string that is a statement is a docstring: of a module, class, function or attribute
    docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    for node in nodes:
        if is_test and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
            yield node.lineno, "name", node.name.replace("_", " ")
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            kind = "docstring" if id(node) in docstrings else "text"
            if is_test and kind == "text":
                continue
            for offset, text in enumerate(node.value.splitlines()):
                yield node.lineno + offset, kind, CODE.sub("", text)


def _comments(source: str) -> Iterator[tuple[int, str]]:
    """Yield the number of the line and the text of each comment of a Python source."""
    number, counted = 1, 0
    for found in STRING_OR_COMMENT.finditer(source):
        if found[0].startswith("#"):
            number, counted = number + source.count("\n", counted, found.start()), found.start()
            yield number, found[0]


def _toml(path: Path) -> Iterator[Line]:
    for number, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        yield number, "comment", CODE.sub("", text.partition("#")[2])


def _page(path: Path) -> Iterator[Line]:
    """Yield comments, string literals with a space, and text between tags, of the console's page or of C."""
    for number, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        for comment in re.findall(r"(?:^|\s)//.*|/\*.*?(?:\*/|$)|^\s*\*.*", text):
            yield number, "comment", CODE.sub("", comment)
        for shown in re.findall(r'"[^"]*"|`[^`]*`|>[^<>]+<', re.sub(r"(?:^|\s)//.*", "", text)):
            if " " in shown:
                yield number, "text", re.sub(r"\$\{[^}]*\}", "", shown)


CODE = re.compile(r"(`+)[^`]*\1")
STRING_OR_COMMENT = re.compile(
    r'''"""(?:\\.|[^\\])*?"""|\'\'\'(?:\\.|[^\\])*?\'\'\'|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|#[^\n]*''', re.DOTALL
)
"""Of a Python source; tokenize, which finds the same, takes ten times as long."""
READERS: dict[str, Callable[[Path], Iterator[Line]]] = {
    ".md": _markdown,
    ".py": _python,
    ".toml": _toml,
    ".js": _page,
    ".html": _page,
    ".c": _page,
    ".h": _page,
}


def main(arguments: list[str]) -> int:
    """Print the findings and their counts; return the exit status."""
    found = findings([Path(argument).resolve() for argument in arguments] or [ROOT / path for path in ALL])
    for finding in found:
        print(finding)
    for title, counts in (("word", Counter(f.word for f in found)), ("kind", Counter(f.kind for f in found))):
        print(f"\nper {title}: " + ", ".join(f"{name} {count}" for name, count in counts.most_common()))
    print("\nper file:")
    for path, count in sorted(Counter(f.path for f in found).items()):
        print(f"{count:6} {path}")
    print(f"{len(found):6} in total")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
