"""Numbers that README and documentation state, ``docs/numbers.toml``, measured again.

    python sims/stated_numbers.py [TEXT] [--all | --write]

Runs each command that contains TEXT with a tenth of its cases and prints each number with its interval; exit
code 1 if one is outside. --all: with all cases. --write: with all, and enter what was measured in table and pages.

A row has the ``command``, with ``{cases}`` in place of their number if they can be fewer; ``pages`` with the phrases in
which its numbers stand; and ``numbers``: kind, value as it stands, and the expression that is measured, of columns of
the campaign, keys of the JSON, or ``printed(LINE, k)``, number k behind LINE. Kinds, all intervals have 99.99 %:

- rate: number of cases for which it holds; the interval is that of a beta-binomial distribution. In phrases {x} is the
  percentage, {x_low} and {x_high} are Wilson's bounds of 95 %, {x_count} is the number;
- mean, rms, median: over cases; behind the expression is the standard deviation with one case, both samples count;
- probability: with its coefficient of variation, behind the expression; the interval is that of the logarithm;
- exact: the stated digits.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
from scipy import stats

from hil.parts.campaigns.statistics import wilson
from hil.parts.campaigns.store import read_table

ROOT: Final = Path(__file__).resolve().parents[1]
TABLE: Final = ROOT / "docs/numbers.toml"
FEWEST: Final = 20  # cases of a sample
TAIL: Final = 5e-5  # of an interval, on either side
SIGMAS: Final = float(stats.norm.isf(TAIL))
Row = dict[str, Any]
Found = dict[str, tuple[float, float]]  # number and spread, by name


def rows() -> list[Row]:
    """Return the rows of the table."""
    return list(tomllib.loads(TABLE.read_text(encoding="utf-8"))["row"])


def phrases(row: Row) -> Iterator[tuple[Path, str]]:
    """Yield page and text of each phrase of ``row``, with its values."""
    values: Row = {"cases": row["cases"]}
    for name, (kind, value, *_) in row["numbers"].items():
        values[name] = value
        if kind == "rate":
            rate = wilson(int(value), row["cases"])
            values |= {name: _percent(rate["rate"]), f"{name}_count": int(value)}
            values |= {f"{name}_{end}": _percent(rate[end]) for end in ("low", "high")}
    yield from ((ROOT / page, text.format(**values)) for page, texts in row["pages"].items() for text in texts)


def _percent(fraction: float) -> str:
    percent = 100.0 * fraction
    return f"{percent:.{0 if percent in (0.0, 100.0) else 1 if 0.1 <= percent <= 99.9 else 2}f}"


def place(text: str, page: str) -> re.Match[str] | None:
    """Return the place of ``text`` in ``page``, with any white space between its words."""
    return re.search(r"(?<![\w.])" + r"\s+".join(map(re.escape, text.split())) + r"(?!\w|\.\d)", page)


def interval(number: list[Any], cases: int, of_table: int) -> tuple[float, float]:
    """Return the interval of what ``cases`` give if the table, with ``of_table``, is true."""
    kind, text, _, spread = (*number, 0.0)[:4]
    value, half = float(text), 0.500001 * 10.0 ** int(Decimal(text).as_tuple().exponent)
    if kind == "rate":
        predicted = stats.betabinom(cases, value + 0.5, of_table - value + 0.5)
        return float(predicted.ppf(TAIL)), float(predicted.isf(TAIL))
    if kind == "probability":
        factor = float(np.exp(SIGMAS * np.sqrt(2.0) * spread))
        return (value - half) / factor, (value + half) * factor
    half += SIGMAS * spread * float(np.sqrt(1.0 / cases + 1.0 / of_table))
    return value - half, value + half


def estimate(kind: str, sample: Any) -> tuple[float, float]:
    """Return number and spread of what was measured."""
    values = np.asarray(sample, dtype=float)
    if kind in ("rate", "exact"):
        return float(values.sum()), 0.0
    if kind == "probability":
        return float(values[0]), float(values[1])
    values = values[np.isfinite(values)]
    if kind == "median":
        width = 0.5 / np.sqrt(len(values))
        low, middle, high = np.quantile(values, [0.5 - width, 0.5, 0.5 + width])
        return float(middle), float((high - low) / (4.0 * width))
    if kind == "rms":
        rms = float(np.sqrt(np.mean(values**2)))
        return rms, float(np.std(values**2, ddof=1)) / (2.0 * rms)
    return float(values.mean()), float(values.std(ddof=1))


def names_of(command: str, folder: Path) -> dict[str, Any]:
    """Run ``command`` and return the names that its row may use. Raises RuntimeError if it fails."""
    words = shlex.split(command)[1:]
    if command.startswith("hil "):
        words = ["-m", "hil", *words, "--json", str(folder / "numbers.json")]
        words += ["--out", str(folder)] * (words[2] == "campaign")
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):  # 1: the verdict is fail
        raise RuntimeError(f"{command}: exit code {done.returncode}: {done.stderr[-2000:]}")
    names: dict[str, Any] = {"np": np, "printed": _printed(done.stdout)}
    results = (folder / "numbers.json").read_text() if command.startswith("hil ") else done.stdout
    if results.startswith("{"):
        names |= vars(json.loads(results, object_hook=lambda keys: SimpleNamespace(**keys)))
    if (folder / "cases.parquet").exists():
        cases = read_table(folder / "cases.parquet")
        names |= {name: cases.column(name).to_numpy() for name in cases.column_names}
    return names


def _printed(text: str) -> Callable[[str, int], float]:
    lines = [" ".join(line.split()) for line in text.splitlines()]

    def number(begin: str, k: int) -> float:
        behind = next(line.partition(begin)[2] for line in lines if begin in line)
        return float(re.findall(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?", behind)[k])

    return number


def measure(row: Row, whole: bool) -> tuple[int, Found]:
    """Return how many cases were run, and what was found."""
    cases = row["cases"]
    if "{cases}" in row["command"] and not whole:
        cases = min(cases, max(FEWEST, cases // 10))
    with tempfile.TemporaryDirectory() as folder:
        names = names_of(row["command"].replace("{cases}", str(cases)), Path(folder))
    numbers = row["numbers"].items()
    found = {name: estimate(kind, eval(measured, names)) for name, (kind, _, measured, *_) in numbers}
    if not np.isfinite([number for number, _ in found.values()]).all():
        raise RuntimeError(f"{row['command']}: a number has no value: {found}")
    return cases, found


def enter(command: str, found: Found) -> None:
    """Enter what was found for ``command`` in the row of the table and in its pages."""
    i = [row["command"] for row in rows()].index(command)
    row, blocks = rows()[i], TABLE.read_text(encoding="utf-8").split("[[row]]\n")
    before = [text for _, text in phrases(row)]
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    lines = {"commit": json.dumps(commit[:8])}
    for name, (value, spread) in found.items():
        number = row["numbers"][name]
        number[1:] = [_shown(value, number[1]), number[2], *([float(f"{spread:.3g}")] if spread else [])]
        lines[name] = json.dumps(number)
    blocks[i + 1] = re.sub(
        r"^(\w+) = .*", lambda at: f"{at[1]} = {lines[at[1]]}" if at[1] in lines else at[0], blocks[i + 1], flags=re.M
    )
    TABLE.write_text("[[row]]\n".join(blocks), encoding="utf-8")
    for old, (page, new) in zip(before, phrases(row), strict=True):
        text = page.read_text(encoding="utf-8")
        if (at := place(old, text)) is None:
            raise RuntimeError(f"{page}: does not have: {old}")
        spaced = re.split(r"(\s+)", at[0])
        spaced[::2] = new.split()
        page.write_text(text[: at.start()] + "".join(spaced) + text[at.end() :], encoding="utf-8")


def _shown(value: float, like: str) -> str:
    mantissa, e, _ = like.partition("e")
    text = f"{value:.{len(mantissa.partition('.')[2])}{e or 'f'}}"
    return re.sub(r"e([+-])0", r"e\1", text).replace("e+", "e")


def main() -> int:
    """Measure the rows and print their numbers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("text", nargs="?", default="")
    for option in ("--all", "--write"):
        parser.add_argument(option, action="store_true")
    given = parser.parse_args()
    outside = total = 0
    for row in (each for each in rows() if given.text in each["command"]):
        cases, found = measure(row, given.all or given.write)
        print(row["command"].replace("{cases}", str(cases)))
        for name, (value, _) in found.items():
            number = row["numbers"][name]
            low, high = interval(number, cases, row["cases"])
            bad = not low <= value <= high
            total, outside = total + 1, outside + bad
            print(f"  {name:8} {value:.5g}, stated {number[1]}, {low:.5g} .. {high:.5g}{'  OUTSIDE' * bad}", flush=True)
        if given.write:
            enter(row["command"], found)
    print(f"{total} numbers, {outside} outside of their intervals")
    return int(outside > 0 and not given.write)


if __name__ == "__main__":
    sys.exit(main())
