"""Runs, campaigns and replays of the shipped scenarios keep their bits, on every computer.

Once more they run with a library before the C library, BLAS and LAPACK that changes the last bit of each result: no
processor and no other version changes more.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.golden_runs import FILE, cases, platform_of_the_bits

pytestmark = [
    pytest.mark.xdist_group("campaign"),
    pytest.mark.skipif(
        json.loads(FILE.read_text())["platform"] != platform_of_the_bits(),
        reason="the digests are those of other versions of numpy, scipy or numba",
    ),
]

_GOLDEN = json.loads(FILE.read_text())["digests"]
_NAMES = [name for name, _ in cases()]
_ROOT = Path(__file__).parent.parent.parent


@pytest.mark.parametrize(("name", "digest"), [pytest.param(name, digest, id=name) for name, digest in cases()])
def test_bits_are_those_of_before(name: str, digest: Callable[[], str]) -> None:
    assert digest() == _GOLDEN[name], "python -m tests.support.golden_runs writes the new ones"


def test_file_has_every_case_and_no_other() -> None:
    assert list(_GOLDEN) == _NAMES


@pytest.fixture(scope="module")
def other_libraries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the library that stands before the C library, BLAS and LAPACK."""
    library = tmp_path_factory.mktemp("preload") / "other_libraries.so"
    source = _ROOT / "tests" / "support" / "other_libraries.c"
    command = ["cc", "-O1", "-shared", "-fPIC", "-fno-builtin", "-o", str(library), str(source), "-ldl", "-lm"]
    subprocess.run(command, check=True)
    return library


def _with(library: Path, *command: str) -> str:
    environment = os.environ | {"LD_PRELOAD": str(library) if library.name else "", "PYTHONPATH": str(_ROOT)}
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("call", ["math.sin(1.0)", "math.pow(1.1, 2)", "np.dot([1.1, 2.2], [3.3, 4.4])"])
def test_other_libraries_change_what_they_return(other_libraries: Path, call: str) -> None:
    text = f"import math; import numpy as np; print(repr({call}))"
    assert _with(other_libraries, "-c", text) != _with(Path(), "-c", text)


@pytest.fixture(scope="module")
def bits_elsewhere(other_libraries: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the digests with the other libraries."""
    file = tmp_path_factory.mktemp("digests") / "digests.json"
    _with(other_libraries, "-m", "tests.support.golden_runs", str(file))
    digests: dict[str, str] = json.loads(file.read_text())["digests"]
    return digests


@pytest.mark.parametrize("name", _NAMES)
def test_no_bit_is_that_of_another_library(name: str, bits_elsewhere: dict[str, str]) -> None:
    assert bits_elsewhere[name] == _GOLDEN[name]
