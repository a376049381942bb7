"""Map from lines to tests: blocks of a module, who names them, kernels that a kernel reaches, and what is printed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support import line_tests, tests_of
from tests.support.coverage_contexts import called_by
from tests.support.named_blocks import Names, blocks_of

SHAPE, TEST_FILE = (f"{folder}.py" for folder in ("hil/shape", "tests/test_shape"))
SOURCE = '''"""Module."""

from hil.other import scale

LIMIT = 2.0


class Row:
    """A row."""

    size: int = 3

    def area(self):
        """Return the area."""
        return self.size * scale(LIMIT)


def largest(rows):
    best = 0.0
    for row in rows:
        best = max(best, row.area())
    return best
'''
TEST = """
from hil.shape import LIMIT, largest

def test_limit():
    assert LIMIT == 2.0
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Return a tree with a module and a test of it."""
    for name, text in ((SHAPE, SOURCE), (TEST_FILE, TEST)):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return tmp_path


def test_blocks_are_functions_methods_and_statements(root: Path) -> None:
    blocks = {block.name: block for block in blocks_of(root / SHAPE, root)}
    assert list(blocks) == ["LIMIT", "Row", "Row.size", "Row.area", "largest"]
    assert blocks["Row.area"].body == (15,)
    assert (blocks["largest"].first, blocks["largest"].last) == (18, 22)
    assert blocks["Row.size"].is_field
    assert not blocks["LIMIT"].is_field


def test_name_belongs_to_the_tests_and_functions_that_name_it(root: Path) -> None:
    limit, _, size, area, _ = blocks_of(root / SHAPE, root)
    assert Names(root).users(limit) == ({TEST_FILE + "::test_limit"}, {area})
    assert Names(root).users(size) == (set(), {area})


def test_kernel_reaches_the_kernels_and_entries_that_it_calls() -> None:
    from hil.loop.compiled.run_cycles import run_cycles

    assert "_run_gnc" in {function.__name__ for function in called_by(run_cycles)}
    reached = dict(line_tests._reached("hil.loop.compiled.run_cycles", "run_cycles"))
    assert {"hil/loop/core.py", "hil/gnc/control.py", "hil/maths/quat.py"} <= reached.keys()


def test_narrowest_tests_of_each_run_of_lines_come_first(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_tests, "ROOT", root)
    monkeypatch.setattr(line_tests, "MAP", root / "map.json")
    monkeypatch.setattr(tests_of, "ROOT", root)
    monkeypatch.setattr(tests_of, "MAP", root / "map.json")
    narrow, wide = TEST_FILE + "::test_limit", TEST_FILE + "::test_gone"
    line_tests.write_map({SHAPE: {narrow: 1 << 19, wide: 0b1111 << 19}})
    written = json.loads((root / "map.json").read_text())
    assert [run[:2] for run in written["files"][SHAPE]["largest"][1:]] == [[1, 1], [2, 4]]
    largest = blocks_of(root / SHAPE, root)[-1]
    known = tests_of.LineMap(root / "map.json")
    assert known.tests(largest, 19) == ([narrow], True)  # a test that is gone is left out
    assert known.tests(largest, 21) == ([], True)
    (root / SHAPE).write_text(SOURCE.replace("best = 0.0", "best = -1.0"))
    assert known.tests(blocks_of(root / SHAPE, root)[-1], 21) == ([narrow], False)


@pytest.mark.parametrize("target", ["", "hil", "tests/conftest.py", "hil/" + "no_such.py", "hil/errors.py:2"])
def test_what_is_no_line_of_the_program_is_bad_input(target: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert tests_of.main([target]) == 2
    assert capsys.readouterr().err.startswith(f"tests-of: FILE={target}: ")
