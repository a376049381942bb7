"""Description files of drives that are not shipped, as drives of the emulated rig in lock-step.

    HIL_DRIVE_FILES=FOLDER pytest -m slow -rP tests/system/test_drive_files.py

Each file of the folder flies scheme 1 for 60 s (HIL_DRIVE_SECONDS), or is refused by lines that name its objects.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.drivers.turntable.cia402.eds import Eds
from hil.errors import BadInput

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]
FOLDER = os.environ.get("HIL_DRIVE_FILES")
SECONDS = float(os.environ.get("HIL_DRIVE_SECONDS", "60"))
FILES = sorted(path for path in Path(FOLDER).iterdir() if path.is_file()) if FOLDER else []


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_described_drive_flies_or_is_refused_by_true_lines(path: Path) -> None:
    settings = {"rig.host.time": "lock_step", "rig.turntable.cia402.eds_file": str(path)}
    try:
        mode = Eds(path).streams[0]
        run = hil.run("scheme-1", "emulated", 0, SECONDS, settings)
    except BadInput as caught:
        refused = caught.problems
    else:
        error_deg = np.degrees(run.history["setpoint"]["gimbal_rad"] - run.history["feedback"]["gimbal_rad"])
        largest_deg = np.abs(error_deg).max(initial=0.0)
        sys.stdout.write(f"{path.name}: mode {mode}, {run.stop}, largest following error {largest_deg:.3f} deg\n")
        assert run.stop == "completed"
        return
    sys.stdout.writelines(f"refused: {problem}\n" for problem in refused)
    assert all(re.match(r"0x[0-9A-F]{4}|\[", each.key) for each in refused)
