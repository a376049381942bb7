"""Drift check before a run: views that the bench takes itself must match the calibration of its cameras."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from hil.commission.calibration_drive import plan_drive, take_views, write_views
from hil.commission.view_plan import PlanRequest
from hil.config.load import load_geometry
from hil.core.messages import Event
from hil.drivers.vmu import NAME
from hil.errors import BadInput, DeviceError, SafetyTrip
from hil.loop.runner import Runner
from hil.session.build import WiredBench
from hil.vmu.calibration import job as calibration
from hil.vmu.calibration.files import read_back
from hil.vmu.calibration.model import Setup
from hil.vmu.calibration.refine import weak_prior
from hil.vmu.calibration.report import drift_as_json
from hil.vmu.calibration.views import read_views

WHAT: Final = "drift check"
_RANGE_M: Final = 2.0  # at which its effect is stated
_LED_SIGMA_M: Final = 1e-3


def request_drift_check(bench: WiredBench, runner: Runner) -> None:
    """Let ``runner`` check the cameras of ``bench`` for drift before it opens the devices.

    Not in an attended session, in which the axes move by command only: an event of the run states that.
    """
    if runner.operator.attended:
        runner.events.append(Event(0.0, NAME, f"no {WHAT} in an attended session"))
        return
    check = CameraDriftCheck(bench, runner)
    runner.before_open = check.run
    runner.meters["drift_check"] = lambda: check.result


class CameraDriftCheck:
    """Takes the views of ``[vmu.drift_check]`` and compares them. result: keys of ``hil calibrate --check --json``."""

    def __init__(self, bench: WiredBench, runner: Runner) -> None:
        self.result: dict[str, Any] = {}
        self._bench = bench
        self._runner = runner

    def run(self) -> None:
        """Check the cameras. Raises SafetyTrip for a drift, DeviceError for views that do not show one or none."""
        try:
            checked, limits = self._checked()
        except BadInput as error:
            raise DeviceError(NAME, f"{WHAT}: {'; '.join(problem.message for problem in error.problems)}") from error
        self.result = drift_as_json(checked, limits)
        since = f"calibration {checked.known.label.id} of {checked.known.label.date}"
        found, limit = checked.refusal(limits)
        if found:
            raise SafetyTrip(NAME, f"{WHAT} against {since}:", found, limit)
        text = f"{WHAT}: {checked.drift.views} views agree with {since}, residuals {checked.drift.rms_px:.3f} px RMS"
        self._runner.events.append(Event(0.0, NAME, text))

    def _checked(self) -> tuple[calibration.DriftCheck, calibration.DriftLimits]:
        rig, chosen = self._bench.rig, self._bench.rig.vmu.drift_check
        assert rig.vmu.geometry_file is not None
        geometry = load_geometry(rig.vmu.geometry_file).value
        known = read_back(geometry, rig.vmu.geometry_file)
        setup = Setup.of(geometry, rig.bench)
        held = weak_prior(setup, (), known.axis_sigma, _LED_SIGMA_M, 0.0)
        request = PlanRequest(chosen.views, chosen.near_m, chosen.far_m, float(np.radians(chosen.turn_deg)))
        plan = plan_drive(self._bench.job, setup, held, request)
        taken = take_views(self._bench, plan, chosen.settle_s, lambda *_: None)
        with TemporaryDirectory(prefix="hil-views-") as folder:
            write_views(Path(folder), taken)
            views = read_views(Path(folder))
            checked = calibration.check(views, known, None, False, _RANGE_M, lambda *_: None)
        return checked, calibration.DriftLimits(chosen.max_rms_px, chosen.max_drift_px, chosen.alarm_probability)
