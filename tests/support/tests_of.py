"""Tests that run the lines of a file: ``make tests-of FILE=hil/maths/quat.py``, or ``FILE=hil/maths/quat.py:41``.

Reads the map of ``tests.support.line_tests``. Functions and names are looked up as they are now: one whose text has
changed since the map was measured has all tests that ran any of its lines, and is marked ``~``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Final

from tests.support.named_blocks import Block, blocks_of

ROOT: Final = Path(__file__).resolve().parents[2]
MAP: Final = ROOT / "tests" / "data" / "line_tests.json"
_SHOWN: Final = 2  # tests of a function, unless a line is asked for


class LineMap:
    """The map. Tests that no longer exist are left out."""

    def __init__(self, path: Path) -> None:
        found = json.loads(path.read_text())
        self._tests: list[str] = found["tests"]
        self._files: dict[str, dict[str, list]] = found["files"]

    def tests(self, block: Block, line: int | None = None) -> tuple[list[str], bool]:
        """Return the tests of ``block`` or of a line of it, narrowest first, and whether its text is as measured."""
        digest, *runs = self._files.get(block.file, {}).get(block.name, ["", [0, 0]])
        same = digest == block.digest
        if line is not None and same:
            runs = [run for run in runs if run[0] <= line - block.first <= run[1]] if block.body else runs
            if not runs and line < block.body[0]:  # the head of a function: that of its first statement
                return self.tests(block, block.body[0])
        ranked = dict.fromkeys(run[place] for place in range(2, 9) for run in runs if place < len(run))
        return [self._tests[number] for number in ranked if self._exists(self._tests[number])], same or not digest

    def _exists(self, test: str) -> bool:
        file, _, name = test.partition("::")
        path = ROOT / file
        return path.exists() and f"def {name.rpartition('::')[2]}(" in path.read_text()


def report(target: str) -> tuple[list[str], list[str]]:
    """Return the lines to print for a file or a line of it, and the tests to run. Raises ValueError."""
    file, _, number = target.partition(":")
    path, line = (ROOT / file).resolve(), int(number) if number.isdecimal() else None
    if not path.is_file() or not path.is_relative_to(ROOT / "hil") or (number and line is None):
        raise ValueError(f"FILE={target}: not a file of hil/")
    blocks = [block for block in blocks_of(path, ROOT) if line is None or block.first <= line <= block.last]
    if not blocks:
        raise ValueError(f"FILE={target}: no statement")
    lines, run = [], dict[str, None]()
    if not MAP.is_file():
        raise ValueError(f"{MAP.relative_to(ROOT)}: is missing: python -m tests.support.line_tests measures it")
    known = LineMap(MAP)
    for block in blocks:
        tests, same = known.tests(block, line)
        shown = tests if line is not None else tests[:_SHOWN]
        run |= dict.fromkeys(shown)
        head = f"{block.first:4}-{block.last:<4}{' ' if same else '~'} {block.name}"
        more = [f"({len(tests) - len(shown)} more: FILE=...:LINE)"] if len(tests) > len(shown) else []
        lines += [head, *(f"            {test}" for test in [*shown, *more] or ["no test"])]
    return lines, list(run)


def main(arguments: list[str]) -> int:
    """Print the tests, and the command that runs them; return 0, 1 if there are none, 2 for bad input."""
    try:
        lines, tests = report("".join(arguments))
    except ValueError as error:
        print(f"tests-of: {error}", file=sys.stderr)
        return 2
    print("\n".join(lines))
    if tests:
        print("\npytest -n 0 " + " ".join(tests))
    return 0 if tests else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
