"""First violated limit of runs that end early, and the words and units of limits."""

from __future__ import annotations

from typing import Any

import pytest

from hil.core.alarm_table import alarm_of_json
from hil.core.alarms import Alarm
from hil.report.limits import sentence, shown, stop_of_alarm, unit_of
from hil.report.summary import summarise
from hil.session import build
from hil.setup.assembly import Job
from tests.support.run_settings import make_job


def flown(job: Job) -> dict[str, Any]:
    """Return the numbers of a run of ``job`` in memory."""
    with build.runner(job) as runner:
        return summarise(runner.run(), job.scenario.value, job.rig.value, "mock", 0, 50.0)[0]


def test_stop_is_the_cause_and_not_the_way_to_the_ready_point_that_was_left() -> None:
    found = flown(make_job(10.0, ["faults=[{device='rails.x',kind='stuck',at_s=5.0}]"]))
    assert found["stop"].startswith("rails.x: distance from the demand")
    assert found["first_violated"] == "distance_from_the_demand_of_x"
    assert sentence(found).startswith("the distance from the demand of x is 3.")


def test_lost_vision_is_the_cause_of_a_hold_that_lasts_to_the_end() -> None:
    found = flown(make_job(20.0, ["faults=[{device='vmu',kind='no_pose',at_s=10.0}]"]))
    assert found["first_violated"] == "pose_age"
    assert found["first_violated_value"] == pytest.approx(found["first_violated_limit"], abs=0.03)
    assert found["first_violated_s"] == pytest.approx(12.0, abs=0.2)
    assert found["limits"]["pose_age"]["margin"] < -5.0


def test_poses_are_not_missed_where_none_is_expected() -> None:
    found = flown(make_job(5.0, scenario="far-approach"))
    assert found["limits"]["pose_age"]["margin"] == 2.0


def test_least_value_is_required_and_a_largest_one_allowed() -> None:
    row: dict[str, Any] = {"first_violated_value": 8.94, "first_violated_limit": 20.0, "first_violated_s": None}
    row |= {"first_violated_phase": "", "first_violated_term": ""}
    assert sentence(row | {"first_violated": "ready_time"}) == (
        "the duration of the ready phase is 8.94 s, required 20 s"
    )
    assert sentence(row | {"first_violated": "hold_time"}).endswith("8.94 s, allowed 20 s")


@pytest.mark.parametrize(
    ("device", "quantity", "value", "unit"),
    [
        ("rails.x", "following error", "0.0600 m", "m"),
        ("turntable.roll", "following error", "2.100 deg", "rad"),
        ("turntable.yaw", "speed", "3.0 deg/s", "rad/s"),
        ("rails", "age of the feedback", "0.210 s", "s"),
        ("vmu", "pose against encoders, x", "0.0510 m", "m"),
        ("vmu", "pose against encoders, about x", "2.000 deg", "rad"),
        ("bench", "limited setpoints", "6 in a row", ""),
        ("vmu", "lost packets", "11.0", ""),
    ],
)
def test_value_of_a_stop_has_its_unit(device: str, quantity: str, value: str, unit: str) -> None:
    stop = stop_of_alarm(alarm_of_json(Alarm(1.0, device, quantity, value, value).as_json()), "", 1.0)
    assert unit_of(stop.name) == unit
    number, _, given = value.partition(" ")
    assert stop.value is not None
    assert shown(stop.value, unit).split()[0] == shown(float(number), given if unit == "m" else "").split()[0]


def test_alarm_that_holds_the_approach_to_the_end_is_the_cause() -> None:
    found = flown(make_job(15.0, ["gnc.integrity.cusum_limit_sigmas=4.0", "gnc.integrity.mean_shift_sigmas=0.02"]))
    assert found["first_violated"] == "vision_suspect"
    assert f"vision_suspect {found['first_violated_s']:.2f} s" in found["alarms_before"]
    assert sentence(found).startswith("the vision suspect ends the approach, at ")
