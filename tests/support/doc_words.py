"""Words of the documentation that are written by hand: ``python -m tests.support.doc_words``.

Counted as by ``wc -w``: prose, tables, code and link targets of every page below ``docs/``. Not counted are pages in
``docs/reference/generated`` and notebooks, which are made when the site is built, and tables between ``<!-- NAME -->``
and ``<!-- end -->``, which a command measures and writes. Texts outside of ``docs/`` are listed apart, and so is
``docs/hazards.toml``, from which a page is made.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
DOCS: Final = ROOT / "docs"
MADE: Final = ("generated", "notebooks")
KINDS: Final = ("tutorials", "how-to", "explanation", "reference", "decisions")
_MEASURED: Final = re.compile(r"^<!-- (?!end)\w+ -->$.*?^<!-- end -->$", re.DOTALL | re.MULTILINE)


def pages() -> list[Path]:
    """Return the pages below ``docs/`` that are written by hand."""
    return sorted(page for page in DOCS.rglob("*.md") if not set(MADE) & set(page.parts))


def words(page: Path) -> int:
    """Return the number of words of ``page`` that are written by hand."""
    return len(_MEASURED.sub("", page.read_text(encoding="utf-8")).split())


def by_kind() -> dict[str, int]:
    """Return the number of words of each kind of page, of the index as "index"."""
    counts = dict.fromkeys(KINDS, 0) | {"index": 0}
    for page in pages():
        kind = page.relative_to(DOCS).parts[0]
        counts[kind if kind in KINDS else "index"] += words(page)
    return counts


def main() -> None:
    """Print the words of each page, of each kind, and of all."""
    for page in sorted(pages(), key=words):
        print(f"{words(page):6} {page.relative_to(ROOT)}")
    for kind, count in by_kind().items():
        print(f"{count:6} {kind}")
    print(f"{sum(by_kind().values()):6} docs, written by hand")
    for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "benchmarks/README.md"):
        print(f"{words(ROOT / name):6} {name}")
    print(f"{len((DOCS / 'hazards.toml').read_text(encoding='utf-8').split()):6} docs/hazards.toml")


if __name__ == "__main__":
    main()
