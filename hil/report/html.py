"""Elements of a self-contained HTML page: every text is escaped here, nothing is loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""Of the page: no script runs, and nothing is loaded, whatever the texts in it hold."""

_WIDE = 6  # columns of numbers, above which their letters are small on narrow screens
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1a1a1a; max-width: 1150px; margin: 1.5em auto; padding: 0 1em; }
h1 { font-size: 1.6em; margin-bottom: .2em; } h2 { font-size: 1.25em; margin-top: 2em; border-bottom: 1px solid #bbb; }
h3 { font-size: 1.05em; }
table { border-collapse: collapse; margin: .6em 0 1em; } caption { text-align: left; font-weight: 600; }
th, td { padding: .2em .7em; border-bottom: 1px solid #ddd; text-align: right; vertical-align: top; }
th:first-child, td:first-child, .words td, .words th { text-align: left; }
.words td:first-child { white-space: nowrap; } .words td:not(:first-child) { overflow-wrap: anywhere; }
img { width: 100%; height: auto; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: 12px; background: #f5f5f5;
  padding: .7em; }
.verdict { font-size: 1.3em; font-weight: 700; padding: .4em .8em; display: inline-block; border: 3px solid; }
.pass { color: #00543b; border-color: #009e73; } .fail { color: #7c2d00; border-color: #d55e00; }
.open { color: #5c4400; border-color: #e69f00; }
.note { background: #fff4d6; padding: .5em .8em; border-left: 5px solid #e69f00; }
.out { color: #7c2d00; font-weight: 700; }
.waived { background: #c00000; color: #fff; font-weight: 700; padding: .4em .8em; margin: .3em 0; }
@media (max-width: 700px) {
  body { padding: 0 .6em; } table { width: 100%; font-size: 13px; } th, td { padding: .2em .25em; }
  th:first-child, td:first-child, .words td, .verdict { overflow-wrap: anywhere; }
  th:first-child, td:first-child { min-width: 3em; }
  .wide { font-size: 11px; } .wide th, .wide td { padding: .2em .15em; }
  .words td:first-child { white-space: normal; }
  .words thead { display: none; } .words tr { display: block; padding: .4em 0; border-bottom: 1px solid #bbb; }
  .words td { display: block; border: 0; } .words td:empty { display: none; }
  .words td[data-label]::before { content: attr(data-label) ": "; color: #555; }
  figure { margin: 1em 0; }
}
@media print { h2 { break-after: avoid; } img, table { break-inside: avoid; } }
"""


def page(title: str, body: Sequence[str]) -> str:
    """Return a complete page."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(body)
        + "\n</main>\n</body>\n</html>\n"
    )


def heading(level: int, text: str) -> str:
    return f"<h{level}>{escape(text)}</h{level}>"


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph; kind: its class."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def table(head: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "", words: bool = False) -> str:
    """Return a table; cells with a failure are marked. words: all columns are text.

    A head of empty words is left out.
    """
    kind = "words" if words else "wide" if len(head) > _WIDE else ""
    opening = f'<table class="{kind}">' if kind else "<table>"
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    words_of_head = "".join(f'<th scope="col">{escape(word)}</th>' for word in head)
    top = f"<thead><tr>{words_of_head}</tr></thead>\n" if any(head) else ""
    labels = head if words else [""] * len(head)
    lines = "\n".join("<tr>" + "".join(map(_cell, row, labels)) + "</tr>" for row in rows)
    return f"{opening}{title}{top}<tbody>\n{lines}\n</tbody></table>"


def _cell(word: str, label: str) -> str:
    """Return a cell. label: of its column, for narrow screens, on which the cells of a row stand below each other."""
    kind = ' class="out"' if word == "out" or word.startswith("fail") else ""
    named = f' data-label="{escape(label)}"' if label else ""
    return f"<td{kind}{named}>{escape(word)}</td>"


def image(title: str, address: str) -> str:
    """Return a figure with its title; address: ``data:``."""
    assert address.startswith("data:")
    return f'<figure><figcaption>{escape(title)}</figcaption><img alt="{escape(title)}" src="{address}"></figure>'


def folded(title: str, text: str) -> str:
    """Return text that is folded until clicked."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"
