"""Relative links of the documentation lead to files and headings that exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NAMED_FILE = re.compile(
    r"(?<![\w/.-])((?:hil|docs|tests|benchmarks|sims|examples|configs)/[\w./-]+\.(?:py|toml|c|h|md|png))(?![\w.]*\w)"
)
PAGES = sorted([ROOT / "README.md", ROOT / "benchmarks" / "README.md", *(ROOT / "docs").rglob("*.md")])


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of ``page``, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_exist(page: Path) -> None:
    text = re.sub(r"```.*?```|(`+)[^`]*\1", "", page.read_text(), flags=re.DOTALL)
    for link in re.findall(r"\]\((?!https?:)([^)]+)\)", text):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_index_lists_every_page() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in PAGES if ROOT / "docs" in page.parents}
    assert pages - {"index.md"} == {link.partition("#")[0] for link in re.findall(r"\]\(([^)]+)\)", index)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_named_files_of_the_repository_exist(page: Path) -> None:
    for name in NAMED_FILE.findall(page.read_text()):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("folder", ["hil", "configs", "sims", "benchmarks", "examples", "tests"])
def test_files_named_in_sources_exist(folder: str) -> None:
    sources = [path for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".toml", ".js", ".c", ".h")]
    named = {(name, path) for path in sources for name in NAMED_FILE.findall(path.read_text())}
    assert not {(name, str(path)) for name, path in named if not (ROOT / name).exists()}


def test_architecture_page_names_every_package() -> None:
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text()
    packages = {path.name for path in (ROOT / "hil").iterdir() if (path / "__init__.py").exists()}
    assert packages == set(re.findall(r"^\| `hil/(\w+)` \|", page, re.MULTILINE))
