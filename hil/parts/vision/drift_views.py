"""Check of the settings with which a rig requests a check of its cameras for drift before each run."""

from __future__ import annotations

from hil.config.load import Loaded, load_geometry
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.errors import BadInput, Problem
from hil.vmu.calibration.files import read_back


def check_drift_views(_: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return the problems of the drift check that ``rig`` requests, if it does."""
    vmu = rig.value.vmu
    if not vmu.drift_check.views:
        return []
    key = "vmu.drift_check.views"
    if vmu.driver != "cameras":
        text = f'{vmu.drift_check.views}: needs the images of vmu.source = "cameras", allowed 0 without'
        return [Problem(rig.where(key), f"rig.{key}", text)]
    key = "vmu.geometry_file"
    if vmu.geometry_file is None:
        return [Problem(rig.where(key), f"rig.{key}", "is missing: a file of hil calibrate, for vmu.drift_check")]
    try:
        read_back(load_geometry(vmu.geometry_file).value, vmu.geometry_file)
    except BadInput as error:
        return list(error.problems)
    return []
