"""First violated limit of runs that end early, and the words and units of limits."""

from __future__ import annotations

from typing import Any

import pytest

from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.report.limits import sentence, stop_of_alarm, unit_of
from hil.report.summary import summarise
from hil.session import build
from hil.session.assembly import Job
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


def test_poses_are_not_missed_if_none_is_expected() -> None:
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
    ("alarm", "name", "unit"),
    [
        (table.FOLLOWING_ERROR.alarm(1.0, "rails.x", 0.06, 0.05), "following_error_of_x", "m"),
        (table.FOLLOWING_ERROR.alarm(1.0, "turntable.roll", 2.1, 2.0, rotates=True), "following_error_of_roll", "rad"),
        (table.SPEED.alarm(1.0, "turntable.yaw", 3.0, 2.0, rotates=True), "speed_of_yaw", "rad/s"),
        (table.AGE_OF_FEEDBACK.alarm(1.0, "rails", 0.21, 0.2), "age_of_the_feedback_of_rails", "s"),
        (table.POSE_AGAINST_ENCODERS.alarm(1.0, "vmu", 0.051, 0.05, "x"), "pose_against_encoders_of_vmu", "m"),
        (table.ATTITUDE_AGAINST_ENCODERS.alarm(1.0, "vmu", 0.2, 0.1, "x"), "attitude_against_encoders_of_vmu", "rad"),
        (table.LIMITED_SETPOINTS.alarm(1.0, "bench", 6.0, 5.0), "limited_setpoints_of_bench", ""),
        (table.LOST_PACKETS.alarm(1.0, "vmu", 11.0, 10.0), "lost_packets_of_vmu", ""),
    ],
    ids=lambda each: each if isinstance(each, str) else None,
)
def test_value_of_a_stop_has_its_unit(alarm: Alarm, name: str, unit: str) -> None:
    stop = stop_of_alarm(alarm, "", 1.0)
    assert (stop.name, stop.value, stop.limit) == (name, alarm.measured, alarm.allowed)
    assert unit_of(stop.name) == alarm.unit == unit


def test_alarm_that_holds_the_approach_to_the_end_is_the_cause() -> None:
    gnc = "gnc.integrity.cusum_limit_sigmas=4.0", "gnc.integrity.mean_shift_sigmas=0.02"
    found = flown(make_job(15.0, [*gnc, "requirements.propellant_factor=0.5"]))  # the propellant is judged at the end
    assert found["limits"]["propellant"]["margin"] < 0.0
    assert found["first_violated"] == "vision_suspect"
    assert f"vision_suspect {found['first_violated_s']:.2f} s" in found["alarms_before"]
    assert sentence(found).startswith("the vision suspect ends the approach, at ")
