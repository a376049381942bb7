"""Drift check before a run: what it needs, its verdict, and a run that it refuses."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from hil.config.load import load_rig, load_scenario
from hil.core import alarm_table as table
from hil.core.clock import SimulatedClock
from hil.errors import BadInput
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.session_parts import SessionParts
from hil.parts.vision.drift_views import check_drift_views
from hil.session.assembly import with_cameras
from hil.session.build import in_memory
from hil.vmu.calibration.job import DriftCheck, DriftLimits
from tests.support.run_settings import make_job

VIEWS = "rig.vmu.drift_check.views=6"


def test_it_needs_cameras_of_this_host_and_their_calibration() -> None:
    rig = load_rig("emulated", [VIEWS])
    assert [str(problem) for problem in check_drift_views(load_scenario("scheme-1"), rig)] == [
        '--set: rig.vmu.drift_check.views: 6: needs the images of vmu.source = "cameras", allowed 0 without'
    ]
    rig = with_cameras(load_scenario("scheme-1", ["vmu.source=cameras"]), rig)
    (problem,) = check_drift_views(load_scenario("scheme-1"), rig)
    assert str(problem).endswith("rig.vmu.geometry_file: is missing: a file of hil calibrate, for vmu.drift_check")


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("rig.vmu.drift_check.views=1", "views 1: allowed 0 (no check), or 2 to 40"),
        ("rig.vmu.drift_check.near_m=3.0", "near_m 3: must be less than far_m 2.5"),
    ],
)
def test_views_that_cannot_be_planned_are_one_line(setting: str, text: str) -> None:
    with pytest.raises(BadInput) as raised:
        load_rig("emulated", [setting])
    assert text in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("chance", "shift_px", "rms_px", "text"),
    [
        (0.5, 0.2, 0.1, ""),
        (1e-9, 0.02, 0.1, ""),
        (1e-9, 0.2, 0.1, "left or stereo moved, 0.200 px RMS (by chance: 1.0e-09)"),
        (0.5, 0.2, 0.3, "residuals 0.300 px RMS"),
    ],
)
def test_a_drift_is_significant_and_large(chance: float, shift_px: float, rms_px: float, text: str) -> None:
    best = SimpleNamespace(part="left", shift_px=shift_px)
    drift = SimpleNamespace(chance=chance, rms_px=rms_px, explanations=(best,), alike=("left", "stereo"))
    found = DriftCheck(None, None, drift, 0.0, 0.0, 2.0, ())  # type: ignore[arg-type]
    assert found.refusal(DriftLimits(0.15, 0.03, 1e-3))[0] == text


def test_a_run_that_is_refused_opens_no_device() -> None:
    job = make_job(1.0)

    def refuse() -> None:
        raise table.DRIFT_CHECK.trip("vmu", "left moved, 0.2 px RMS", "0.03 px", "a calibration")

    def open_bench(now_s: float) -> None:
        raise AssertionError("a device was opened")

    parts = SessionParts(before_open=[refuse])
    runner = in_memory(job, SimulatedRate(SimulatedClock(), job.tick_s), parts)
    runner.loop.bench.open = open_bench  # type: ignore[method-assign]
    outcome = runner.run()
    assert outcome.stop == "vmu: drift check against a calibration: left moved, 0.2 px RMS, allowed 0.03 px"
    assert len(outcome.history) == 0
    assert [alarm.text for alarm in outcome.alarms] == [outcome.stop]
