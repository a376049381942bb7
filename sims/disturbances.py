"""Vision unit and docking monitor on images with the errors of real lenses, sensors, calibrations and scene files.

python sims/disturbances.py vmu|monitor|all [--seeds 3] [--count N] [--row TEXT] [--workers N] [--json FILE]
    [--page FILE] [--again]

The images are those of renderers of their own. One line per row: frames solved or portions measured per seed, gross
errors (beyond 3 deg or 1 % of the range, and beyond 4 sigma), error over sigma, 2-sigma coverage, statuses of the
refused images, processor time per pair or portion, and what is not as expected. Calibrations of the vision unit (1
sigma): very good is 0.05 px, 0.02 % of the focal length, 0.003 deg, 0.03 mm, LEDs to 0.05 mm; usual is 0.2 px, 0.1 %,
0.02 deg, 0.1 mm, LEDs to 0.1 mm. The monitor's portions are at 3 to 12 m, each of a new monitor.

--json FILE is written after each row and seed; rows that it has with the same count are not repeated, unless --again.
--page FILE: replace the tables between its markers by those of all results. Exit code 1 if a row is not as expected.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np

from tests.support.disturbance_verdicts import SeedResult, Verdict, judge
from tests.support.monitor_disturbances import MONITOR_ROWS, MonitorRow
from tests.support.vmu_crowded import CROWDED_ROWS
from tests.support.vmu_disturbances import ROWS, Row
from tests.support.vmu_lab import LAB_ROWS
from tests.support.vmu_lookalikes import LOOKALIKE_ROWS

TABLES: dict[str, tuple[dict[str, Row | MonitorRow], int]] = {
    "vmu": ({row.name: row for row in (*ROWS, *LOOKALIKE_ROWS, *LAB_ROWS, *CROWDED_ROWS)}, 40),
    "monitor": ({row.name: row for row in MONITOR_ROWS}, 20),
}
HEAD = "| row | {} | gross | error over sigma, rms | within 2 sigma, % | refused | ms | |\n" + 8 * "|---" + "|"
Key = tuple[str, str, int, int]  # unit, row, count, seed


def solve(key: Key) -> SeedResult:
    """Return the results of one row with one seed."""
    unit, name, count, seed = key
    return TABLES[unit][0][name].run(count, seed).result()


class Results:
    """Results by unit, row, count and seed; kept in a JSON file if there is one."""

    def __init__(self, path: Path | None, again: bool) -> None:
        self._path, self.found = path, dict[Key, SeedResult]()
        if path is not None and path.exists() and not again:
            for row in json.loads(path.read_text())["results"]:
                key = (row.pop("unit"), row.pop("row"), row.pop("count"), row.pop("seed"))
                self.found[key] = SeedResult(**row)

    def add(self, key: Key, result: SeedResult) -> None:
        """Keep a result, and write the file."""
        self.found[key] = result
        if self._path is None:
            return
        names = ("unit", "row", "count", "seed")
        rows = [dict(zip(names, key, strict=True)) | asdict(self.found[key]) for key in sorted(self.found)]
        verdicts = [
            {"unit": unit, "row": row, "count": count} | asdict(verdict)
            for (unit, row, count), verdict in self.verdicts().items()
        ]
        partial = self._path.with_suffix(".part")
        partial.write_text(json.dumps({"verdicts": verdicts, "results": rows}, indent=1) + "\n")
        partial.replace(self._path)

    def verdicts(self) -> dict[tuple[str, str, int], Verdict]:
        """Return the verdict on each row that the tables have, in their order."""
        out = {}
        for unit, (rows, _) in TABLES.items():
            for name, row in rows.items():
                for count in sorted({key[2] for key in self.found if key[:2] == (unit, name)}):
                    out[unit, name, count] = judge(row.expected, self.of(unit, name, count))
        return out

    def of(self, unit: str, name: str, count: int) -> list[SeedResult]:
        """Return the results of a row, by seed."""
        return [self.found[key] for key in sorted(self.found) if key[:3] == (unit, name, count)]

    def line(self, unit: str, name: str, count: int, verdict: Verdict) -> str:
        """Return the row of a table."""
        costs = [cost for one in self.of(unit, name, count) for cost in one.costs_s]
        solved = ", ".join(map(str, verdict.solved))
        refused = ", ".join(f"{number} `{status}`" for status, number in verdict.refused.items())
        found = f"{verdict.rms:.2f} | {100.0 * verdict.within:.1f}" if np.isfinite(verdict.rms) else "|"
        cost_ms = 1e3 * float(np.median(costs))
        return f"| {name} | {solved} | {verdict.gross} | {found} | {refused} | {cost_ms:.0f} | {verdict.why} |"

    def table(self, unit: str) -> str:
        """Return the table of a unit, of the rows with the usual number of frames or portions."""
        usual = TABLES[unit][1]
        lines = [
            self.line(of, name, count, verdict)
            for (of, name, count), verdict in self.verdicts().items()
            if of == unit and count == usual
        ]
        return "\n".join([HEAD.format(f"solved of {usual}, by seed"), *lines])


def write_page(results: Results, page: Path) -> None:
    """Replace the text between the markers ``<!-- UNIT -->`` and ``<!-- end -->`` of ``page``."""
    text = page.read_text()
    for unit in TABLES:
        before, rest = text.split(f"<!-- {unit} -->\n")
        text = f"{before}<!-- {unit} -->\n{results.table(unit)}\n<!-- end -->{rest.split('<!-- end -->', 1)[1]}"
    page.write_text(text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("unit", choices=[*TABLES, "all"])
    parser.add_argument("--count", type=int, help="frames (40) or portions (20) per row and seed")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--row", default="", help="rows whose name contains this text")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--again", action="store_true")
    chosen = parser.parse_args()
    results = Results(chosen.json, chosen.again)
    keys = [
        (unit, name, chosen.count or usual, seed)
        for unit, (rows, usual) in TABLES.items()
        if chosen.unit in (unit, "all")
        for name in rows
        if chosen.row in name
        for seed in range(chosen.seeds)
    ]
    left = [key for key in keys if key not in results.found]
    with ProcessPoolExecutor(chosen.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        waiting = {pool.submit(solve, key): key for key in left}
        for done in as_completed(waiting):
            unit, name, count, _seed = waiting[done]
            results.add(waiting[done], done.result())
            if all((unit, name, count, k) in results.found for k in range(chosen.seeds)):
                print(results.line(unit, name, count, results.verdicts()[unit, name, count]), flush=True)
    if chosen.page is not None:
        write_page(results, chosen.page)
    asked = {key[:3] for key in keys}
    return int(any(verdict.why for row, verdict in results.verdicts().items() if row in asked))


if __name__ == "__main__":
    sys.exit(main())
