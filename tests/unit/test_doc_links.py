"""Links and names in the documentation lead to files, headings and packages that exist, and every page is reachable."""

import re
from pathlib import Path

import pytest

from docs import diagrams, package_pages
from tests.support import doc_words

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
NAMED_FILE = re.compile(
    r"(?<![\w/.-])((?:hil|docs|tests|benchmarks|sims|examples|configs)/[\w./-]+\.(?:py|toml|c|h|md|png|svg))(?![\w.]*\w)"
)
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "benchmarks" / "README.md", *ROOT.glob("plugins/*/README.md")]
    + [page for page in DOCS.rglob("*.md") if "notebooks" not in page.parts]
)


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of ``page``, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def links(page: Path) -> list[str]:
    """Return the relative links of ``page``, without those in code."""
    text = re.sub(r"```.*?```|(`+)[^`]*\1", "", page.read_text(), flags=re.DOTALL)
    return re.findall(r"\]\((?!https?:)([^)]+)\)", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_exist(page: Path) -> None:
    for link in links(page):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_page_is_reachable_from_the_index() -> None:
    found: set[Path] = set()
    ahead = [DOCS / "index.md"]
    while ahead:
        page = ahead.pop()
        if page not in found:
            found.add(page)
            targets = [(page.parent / link.partition("#")[0]).resolve() for link in links(page)]
            ahead += [target for target in targets if target.suffix == ".md" and target.exists()]
    assert {page for page in PAGES if DOCS in page.parents} <= found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_named_files_of_the_repository_exist(page: Path) -> None:
    for name in NAMED_FILE.findall(page.read_text()):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("folder", ["hil", "configs", "sims", "benchmarks", "examples", "tests"])
def test_files_named_in_sources_exist(folder: str) -> None:
    sources = [path for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".toml", ".js", ".c", ".h")]
    named = {(name, path) for path in sources for name in NAMED_FILE.findall(path.read_text())}
    assert not {(name, str(path)) for name, path in named if not (ROOT / name).exists()}


def test_page_of_the_packages_describes_every_package_and_module() -> None:
    page = package_pages.packages()
    packages = {path.name for path in (ROOT / "hil").iterdir() if (path / "__init__.py").exists()}
    assert packages == set(re.findall(r"^### hil/(\w+)$", page, re.MULTILINE))
    assert re.findall(r"^\| `[\w./]+` \|\s*\|$|^### hil/\w+\n\n\n", page, re.MULTILINE) == []


@pytest.mark.parametrize("name", diagrams.DIAGRAMS)
def test_diagram_is_that_of_the_code(name: str) -> None:
    drawn = diagrams.DIAGRAMS[name]()
    assert (diagrams.FOLDER / name).read_text() == drawn, "run python -m docs.diagrams"
    assert all((ROOT / file).exists() for file in NAMED_FILE.findall(drawn))


def test_pages_written_by_hand_stay_as_short_as_promised() -> None:
    counts = doc_words.by_kind()
    assert counts["tutorials"] >= 4000
    assert sum(counts.values()) <= 56_200, "python -m tests.support.doc_words"
    assert {page.name for page in (DOCS / "decisions").glob("0*.md") if doc_words.words(page) > 300} == set()
    assert doc_words.words(ROOT / "CHANGELOG.md") <= 600
