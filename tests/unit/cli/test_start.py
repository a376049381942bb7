"""Start of a command: a run on the mock rig imports only what it needs, so that its verdict comes at once."""

from __future__ import annotations

import subprocess
import sys

import pytest

SLOW_TO_IMPORT = {
    "asyncio",
    "can",
    "canopen",
    "cv2",
    "fastapi",
    "filterpy",
    "matplotlib",
    "mcap",
    "multiprocessing",
    "pyarrow",
    "pymodbus",
    "scipy.optimize",
    "scipy.spatial",
    "scipy.special",
    "scipy.stats",
    "serial.tools",
    "hil.parts.monitor.camera",
    "hil.parts.monitor.monitor",
}


@pytest.fixture(scope="module")
def imported() -> set[str]:
    """Return the modules that a run on the mock rig has imported when its verdict is printed."""
    run = ["run", "scheme-1", "--duration", "0.1"]
    no_coverage = "sys.modules['coverage'] = None"  # numba imports it where it is installed
    script = f"import sys; {no_coverage}; from hil.cli.main import execute; execute({run}); print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(found.stdout.splitlines()[-1].split())


def test_run_on_the_mock_rig_imports_nothing_slow_that_it_does_not_use(imported: set[str]) -> None:
    assert "hil.report.summary" in imported
    assert not imported & SLOW_TO_IMPORT


def test_computer_without_opencv_compiles_and_flies_all_that_needs_none() -> None:
    """The extra "vision" has OpenCV; a docking monitor as a model needs no image."""
    script = """
import sys
sys.modules["cv2"] = None
from hil.cli.main import execute
from hil.core.part import without_opencv
from hil.cli.precompile import groups
for group in groups().keys() - set(without_opencv()):
    groups()[group]()
execute(["run", "scheme-1", "--duration", "0.1", "--set", "monitor.source=model"])
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "Timing      6 cycles" in run.stdout, run.stderr
