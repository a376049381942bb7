"""Fly the benchmark with the built-in laws and the examples, and write ``docs/benchmark.json``.

python sims/benchmark_table.py --out FOLDER [--runs 20] [--seed 20261127]

``docs/generate.py`` makes the page of the benchmark of it. Campaigns in FOLDER are resumed. With 20 cases
per row it takes about a quarter of an hour of one core.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final

from hil.parts.campaigns.api import benchmark
from hil.parts.campaigns.benchmark_page import above_table_v, rows_and_ideals

ROOT: Final = Path(__file__).resolve().parents[1]
LAWS: Final = {
    "phase plane": "builtin",
    "predictive": "predictive",
    "LQR example": str(ROOT / "examples/backends/lqr.py") + ":lqr",
    "PD example": str(ROOT / "examples/backends/pd.py") + ":pd",
}


def kept(row: dict[str, Any]) -> dict[str, Any]:
    """Return ``row`` without what the page does not show, rounded."""
    found = {name: value for name, value in row.items() if name not in ("worst", "ideal")}
    text = json.dumps(found | {"above_table_v": above_table_v(row)})
    return dict(json.loads(text, parse_float=lambda number: float(f"{float(number):.4g}")))


def main() -> None:
    """Fly what is missing and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=20261127)
    parser.add_argument("--page", type=Path, default=ROOT / "docs/benchmark.json", help="file to be written")
    given = parser.parse_args()
    laws = {}
    for name, law in LAWS.items():
        overrides = {} if law == "builtin" else {"gnc.control.backend": law}
        folder = given.out / name.replace(" ", "-")
        found = benchmark.fly(
            benchmark.rows_of("*"),
            given.runs,
            folder,
            given.seed,
            overrides,
            1,
            lambda row, name=name: print(name, row),
        )
        laws[name] = {"cycle_us": round(found["cycle_us"], 1), "rows": [kept(row) for row in found["rows"]]}
    rows = benchmark.rows_of("scheme-3")  # the only one above Table V whatever its dispersions
    ideal = benchmark.fly(rows, 3 * given.runs, given.out / "ideal", given.seed, workers=1, progress=print, ideal=True)
    shown = [kept(row) for row in rows_and_ideals(ideal)]
    text = json.dumps({"runs": given.runs, "seed": given.seed, "laws": laws, "ideal": shown})
    given.page.write_text(text.replace('{"row"', '\n{"row"') + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
