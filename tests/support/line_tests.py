"""Map from each line of ``hil`` to the tests that run it: ``python -m tests.support.line_tests`` measures it again.

Joins what coverage measured, in child processes as well, with the kernels that each test called, closed over the
kernels that those call: of a kernel all lines belong to all tests that reach it. A module-level name belongs to the
tests that name it, and to those of the functions that name it. Of the tests of a line those that run the least of the
program are kept. Arguments are those of pytest, by default all tests that are not slow.

``tests/data/line_tests.json`` has a line for each function, method and name: digest of its text, and runs of lines,
counted from its first, with the numbers of their tests.
"""

from __future__ import annotations

import importlib
import json
import os
import shutil
import sqlite3
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

from tests.support import coverage_contexts as contexts
from tests.support.named_blocks import Block, Names, blocks_of

ROOT: Final = Path(__file__).resolve().parents[2]
MAP: Final = ROOT / "tests" / "data" / "line_tests.json"
KEPT: Final = 6  # tests of a line
_SETTINGS = """
[run]
source_dirs = {root}/hil
data_file = {folder}/data
core = ctrace
parallel = true
sigterm = true
patch = subprocess, fork, _exit
plugins = tests.support.coverage_contexts
disable_warnings = no-data-collected, module-not-measured, module-not-imported, module-not-python, already-imported
"""

Masks = dict[str, int]
"""Test -> lines of a file that it runs, as bits."""


def measure(options: Iterable[str]) -> int:
    """Run the tests under coverage, at least once per process and context; return pytest's exit code."""
    shutil.rmtree(contexts.FOLDER, ignore_errors=True)
    contexts.FOLDER.mkdir(parents=True)
    settings = contexts.FOLDER / "settings"
    settings.write_text(_SETTINGS.format(root=ROOT, folder=contexts.FOLDER))
    command = [sys.executable, "-m", "coverage", "run", f"--rcfile={settings}", "-m", "pytest"]
    command += ["-p", "tests.support.coverage_contexts", "--timeout", "1200", "-p", "no:cacheprovider", *options]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode


def _rows(path: Path) -> Iterator[list[str]]:
    if path.exists():
        yield from map(json.loads, path.read_text().splitlines())


def _users() -> dict[str, set[str]]:
    """Return context -> tests that it belongs to: a test to itself, a fixture to its tests."""
    users = defaultdict[str, set[str]](set)
    for test, *shared in _rows(contexts.USES):
        for context in (test, *shared):
            users[context].add(test)
    return users


def _measured(users: Mapping[str, set[str]]) -> dict[str, Masks]:
    """Return file -> test -> lines, of all processes."""
    files = defaultdict[str, Masks](lambda: defaultdict(int))
    query = """SELECT path, context, numbits FROM line_bits
        JOIN file ON file.id = file_id JOIN context ON context.id = context_id"""
    for path in contexts.FOLDER.glob("data.*"):
        with sqlite3.connect(path) as data:
            for file, context, bits in data.execute(query):
                for test in users.get(context.rpartition("|")[2], ()):
                    files[os.path.relpath(file, ROOT)][test] |= int.from_bytes(bits, "little")
    return files


def _add_kernels(files: dict[str, Masks], users: Mapping[str, set[str]]) -> None:
    """Add the kernels that each test calls, with all that they call."""
    for context, module, name in _rows(contexts.CALLS):
        for file, mask in _reached(module, name):
            for test in users.get(context, ()):
                files[file][test] |= mask


@cache
def _reached(module: str, name: str) -> list[tuple[str, int]]:
    """Return file and lines of each function that a kernel reaches, its own as well."""
    if not module.startswith("hil."):
        return []
    try:
        pending: list[Any] = [attrgetter(name)(importlib.import_module(module))]
    except AttributeError:  # made by another function
        return []
    reached, masks = set[Any](), defaultdict[str, int](int)
    while pending:
        kernel = pending.pop()
        code = getattr(kernel, "py_func", kernel).__code__
        if code in reached or not code.co_filename.startswith(f"{ROOT}/hil/"):
            continue
        reached.add(code)
        for _, _, line in code.co_lines():
            masks[os.path.relpath(code.co_filename, ROOT)] |= 1 << (line or 0)
        pending += contexts.called_by(kernel)
    return list(masks.items())


class LineTests:
    """Tests of blocks of lines, those that run the least first."""

    def __init__(self, files: Mapping[str, Masks]) -> None:
        breadth = defaultdict[str, int](int)
        for masks in files.values():
            for test, mask in masks.items():
                breadth[test] += mask.bit_count()
        self._files, self._breadth = files, breadth
        self._names = Names(ROOT)

    def narrowest(self, tests: Iterable[str]) -> list[str]:
        """Return the tests that are kept, of those that were measured."""
        return self._ranked(set(tests) & self._breadth.keys())[:KEPT]

    def _ranked(self, tests: Iterable[str]) -> list[str]:
        return sorted(tests, key=lambda test: (self._breadth[test], test))

    def runs(self, block: Block) -> list[tuple[int, int, list[str]]]:
        """Return runs of lines of a function, counted from its first, with their tests."""
        masks = self._masks(block)
        ranked = self._ranked(masks)
        runs: list[tuple[int, int, list[str]]] = []
        for line in range(block.last - block.first + 1):
            tests = [test for test in ranked if masks[test] >> line & 1][:KEPT]
            if tests and runs and runs[-1][2] == tests:
                runs[-1] = (runs[-1][0], line, tests)
            elif tests:
                runs.append((line, line, tests))
        return runs

    @cache  # noqa: B019  # one object per process
    def _masks(self, block: Block) -> Masks:
        """Return test -> lines of the body of ``block`` that it runs, as bits counted from its first line."""
        body = sum(1 << (line - block.first) for line in block.body)
        masks = {test: mask >> block.first & body for test, mask in self._files.get(block.file, {}).items()}
        return {test: mask for test, mask in masks.items() if mask}

    def of_name(self, block: Block) -> list[str]:
        """Return the tests that name a statement, and those that run a function that does."""
        tests, functions = self._names.users(block)
        if block.is_field:
            tests &= self._run(self._names.functions(block.file)) or tests
        found = self.narrowest(tests)
        return (found + [test for test in self.narrowest(self._run(functions)) if test not in found])[:KEPT]

    def _run(self, functions: Iterable[Block]) -> set[str]:
        """Return the tests that run any line of ``functions``."""
        return {test for function in functions for test in self._masks(function)}


def write_map(files: Mapping[str, Masks]) -> None:
    """Write the map."""
    lines = LineTests(files)
    numbers: dict[str, int] = {}
    parts = []
    for path in sorted((ROOT / "hil").rglob("*.py")):
        blocks = []
        for block in blocks_of(path, ROOT):
            runs = lines.runs(block) if block.body else [(0, block.last - block.first, lines.of_name(block))]
            numbered = [[a, b, *(numbers.setdefault(test, len(numbers)) for test in tests)] for a, b, tests in runs]
            if any(tests for _, _, *tests in numbered):
                blocks.append(
                    f"{json.dumps(block.name)}:{json.dumps([block.digest, *numbered], separators=(',', ':'))}"
                )
        parts.append(f'"{path.relative_to(ROOT)}": {{\n' + ",\n".join(blocks) + "\n}")
    tests = ",\n".join(map(json.dumps, numbers))
    MAP.write_text(f'{{"tests": [\n{tests}\n],\n"files": {{\n' + ",\n".join(parts) + "\n}}\n")


def main(options: list[str]) -> int:
    """Measure and write the map; return pytest's exit code."""
    code = measure(options or ["-m", "not slow", "-n", "3", "--dist", "loadgroup", "-q"])
    users = _users()
    files = _measured(users)
    _add_kernels(files, users)
    write_map(files)
    return code


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
