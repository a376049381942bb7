"""Reference page of the packages, made from their docstrings, the import contract, the tests and the decisions."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
PACKAGE: Final = ROOT / "hil"


def layers() -> list[tuple[str, list[str]]]:
    """Return name and packages of each layer of the import contract, from top to bottom."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contract = text[text.index("layers = [") : text.index("\n]", text.index("layers = ["))]
    rows = re.findall(r'^    "([^"]+)",\s*# (.*)$', contract, re.MULTILINE)
    return [(name, re.split(r"\s*[|:]\s*", packages)) for packages, name in rows]


def packages() -> str:
    """Return the page of all packages: what each is for, its modules, its tests, the decisions that name it."""
    parts = [
        """# Packages

From the top layer to the bottom one; a package imports those of lower layers only
([architecture](../../explanation/architecture.md)). A module is described by its first line.
"""
    ]
    for name, found in layers():
        parts += [f"## {name}\n", *(_section(package) for package in found if (PACKAGE / package).is_dir())]
    return "\n".join(parts)


def _section(name: str) -> str:
    folder = PACKAGE / name
    found = sorted(folder.rglob("*.py"), key=lambda path: (path.parent, path.name != "__init__.py", path.name))
    names = {path: path.relative_to(folder).as_posix().removesuffix("__init__.py") for path in found}
    rows = [f"| `{names[path]}` | {summary(path)} |" for path in found if names[path]]
    facts = [text for text in (_tests(name), _decisions(name)) if text]
    return (
        f"### hil/{name}\n\n{docstring(folder / '__init__.py')}\n\n"
        + "".join(f"{fact}\n\n" for fact in facts)
        + "| module | content |\n|---|---|\n"
        + "\n".join(rows)
        + "\n"
    )


def docstring(path: Path) -> str:
    """Return the docstring of a module as Markdown, "" without one."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return re.sub(r"docs/([\w/-]+)/([\w-]+)\.md", r"[\2](../../\1/\2.md)", text.replace("``", "`"))


def summary(path: Path) -> str:
    """Return the first paragraph of a module's docstring in one line of a table."""
    return " ".join(docstring(path).split("\n\n")[0].split()).replace("|", "\\|")


def _tests(name: str) -> str:
    folder = ROOT / "tests" / "unit" / name
    count = len(list(folder.rglob("test_*.py")))
    return f"Tests: `tests/unit/{name}`, {count} files." if count else ""


def _decisions(name: str) -> str:
    named = re.compile(rf"hil/{name}\b")
    links = []
    for page in sorted((ROOT / "docs" / "decisions").glob("0*.md")):
        text = page.read_text(encoding="utf-8")
        if named.search(text):
            title = text.splitlines()[0].removeprefix("# ")
            links.append(f"[{title}](../../decisions/{page.name})")
    return f"Decisions: {'; '.join(links)}." if links else ""
