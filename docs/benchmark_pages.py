"""Reference page of the benchmark, made from ``docs/benchmark.json``, which sims/benchmark_table.py measures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hil.parts.campaigns.benchmark_page import HEAD, MEANING, cells_of

_DATA = Path(__file__).parent / "benchmark.json"


def benchmark() -> str:
    """Return the page: a comparison of the laws, and all numbers of each."""
    found = json.loads(_DATA.read_text(encoding="utf-8"))
    laws: dict[str, Any] = found["laws"]
    names = dict.fromkeys(row["row"] for law in laws.values() for row in law["rows"])
    parts = [
        f"""# Benchmark

`hil benchmark LAW --runs {found["runs"]} --seed {found["seed"]}` with the phase plane, the [predictive
law](../../explanation/control.md#predictive-law), and examples of `examples/backends` (`python sims/benchmark_table.py
--out FOLDER`). Shares are of {found["runs"]} cases each, with Wilson's intervals of
95 %; the last rows have one [fault](faults.md) each, after which a flight may end in an abort.

{MEANING}

## Accepted, and median propellant over the impulsive bound

""",
        _table(("row", *laws), [_compared(name, list(laws.values())) for name in names]),
        "\nCost of a cycle of scheme 1, with plant and mock devices, processor time: "
        + ", ".join(f"{name} {law['cycle_us']} us" for name, law in laws.items())
        + ".\n",
    ]
    for name, law in laws.items():
        parts += [f"\n## {name[0].upper()}{name[1:]}\n\n", _law_table(law["rows"])]
    if found["ideal"]:
        parts += [
            f"""
## What physics leaves

`hil benchmark --only scheme-3 --ideal`: with perfect sensors, with perfect thrusters and masses, and with both,
{found["ideal"][0]["accepted"]["runs"]} cases each with the phase plane.

""",
            _law_table(found["ideal"]),
        ]
    return "".join(parts)


def _law_table(rows: list[dict[str, Any]]) -> str:
    text = _table(HEAD, [_named(*cells_of(row)) for row in rows])
    above = [_named(row["row"], *cells) for row in rows for cells in row["above_table_v"]]
    head = ("row", "deviation, m, m/s, deg, deg/s", "largest of all cases", "Table V of the bench paper")
    return text + (f"\n{_table(head, above)}" if above else "")


def _compared(name: str, laws: list[dict[str, Any]]) -> tuple[str, ...]:
    """Return the cells of the row ``name`` of each law; a law that has not flown it has none."""
    cells = []
    for law in laws:
        row = next((row for row in law["rows"] if row["row"] == name), None)
        if row is None:
            cells.append("-")
            continue
        share, over = row["accepted"], row["propellant_over_bound"]["median"]
        interval = f"{100 * share['low']:.0f} to {100 * share['high']:.0f} %"
        cells.append(f"{share['passed']} ({interval}); {'-' if over is None else f'{over:.2f}'}")
    return _named(name, *cells)


def _named(name: str, *cells: str) -> tuple[str, ...]:
    return (f"`{name}`", *cells)


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"
