"""Integrity verdict: error, protection level and alert limit of a cycle, and what is counted over a run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import CYCLE
from hil.gnc.limits import ERROR
from hil.loop.compiled.run_stats import counted
from hil.params import integrity as integrity_params
from hil.report.integrity import SafeStop, detection, integrity_part

STEP_S = 0.02
SCENARIO = load_scenario("scheme-1").value


def rows(seconds: float, range_m: float = 1.0, level_m: float = 0.01) -> np.ndarray:
    """Return the rows of a chaser that stands still, with a perfect estimate."""
    made = np.zeros(round(seconds / STEP_S), CYCLE)
    made["t_s"] = STEP_S * np.arange(len(made))
    made["truth"]["r_CT_H"] = made["navigation"]["r_CT_H"] = (range_m, 0.0, 0.0)
    made["truth"]["q_CH"] = made["navigation"]["q_CH"] = (0.0, 0.0, 0.0, 1.0)
    made["navigation"]["valid"] = 1
    made["navigation"]["protection_level_m"] = level_m
    made["navigation"]["protection_level_rad"] = 0.001
    made["reference"]["from_H"], made["reference"]["to_H"] = (5.0, 0.0, 0.0), (0.4, 0.0, 0.0)
    return made


def judged(history: np.ndarray, *settings: str) -> tuple[np.record, Any]:
    scenario = load_scenario("scheme-1", settings).value
    state: np.record = counted(history, scenario).integrity
    return state, integrity_part(state, scenario)


@pytest.mark.parametrize(
    ("range_m", "error_m", "axis", "limit_m"),
    [(1.0, 0.2, 0, 0.16), (3.0, 0.5, 0, 0.36), (0.4, 0.11, 0, 0.10), (0.3, 0.06, 0, 0.05), (0.4, 0.06, 1, 0.05)],
)
def test_error_beyond_its_alert_limit_misleads_after_the_time_to_alert(
    range_m: float, error_m: float, axis: int, limit_m: float
) -> None:
    history = rows(10.0, range_m)
    history["navigation"]["r_CT_H"][100:300, axis] += error_m
    state, part = judged(history)
    assert state.limits.broken_s[ERROR + axis] == history["t_s"][151]
    assert part.hmi_cycles == part.hmi_by_line1_only == 200 - 51  # of 4 s, less 1.0 s
    assert part.time_to_alert_s == pytest.approx(199 * STEP_S)
    assert part.worst_error_m == pytest.approx(error_m)
    assert part.alert_limit_m == pytest.approx(limit_m, abs=1e-9)
    assert part.protection_level_m == pytest.approx([0.01] * 3)
    assert not part.passed
    below = rows(10.0, range_m)
    below["navigation"]["r_CT_H"][100:300, axis] += limit_m - 1e-6
    assert judged(below)[1].hmi_cycles == 0


def test_rotation_beyond_a_degree_misleads() -> None:
    history = rows(10.0)
    angle = math.radians(1.1)
    history["navigation"]["q_CH"][:, [2, 3]] = math.sin(angle / 2.0), math.cos(angle / 2.0)
    assert judged(history)[1].hmi_cycles == 500 - 51


@pytest.mark.parametrize(
    ("table", "field", "value"),
    [
        ("navigation", "protection_level_m", 0.3),
        ("navigation", "health", 2),
        ("supervision", "reaction", 1),
        ("supervision", "aborted", 1),
    ],
)
def test_reported_error_does_not_mislead(table: str, field: str, value: float) -> None:
    history = rows(10.0)
    history["navigation"]["r_CT_H"][:, 0] += 0.2
    history[table][field] = value
    assert judged(history)[1].hmi_cycles == 0


def test_alarm_of_the_second_sensor_alone_is_none_of_the_first_line() -> None:
    history = rows(10.0)
    history["navigation"]["r_CT_H"][:, 0] += 0.2
    history["navigation"]["health"] = 16
    part = judged(history)[1]
    assert (part.hmi_cycles, part.hmi_by_line1_only) == (0, 500 - 51)


def test_error_of_less_than_the_time_to_alert_does_not_count() -> None:
    history = rows(10.0)
    for first in range(0, 500, 100):
        history["navigation"]["r_CT_H"][first : first + 50, 0] += 0.2
    assert judged(history)[1].hmi_cycles == 0


def test_gnc_without_protection_levels_is_judged_by_the_keep_out() -> None:
    history = rows(10.0, 0.26, math.nan)
    history["navigation"]["protection_level_rad"] = math.nan
    history["navigation"]["r_CT_H"][:, 0] += 1.0
    part = judged(history)[1]
    assert part.passed
    assert part.hmi_cycles is part.hmi_by_line1_only is part.availability is None
    assert part.protection_level_m == [None] * 3
    history["truth"]["r_CT_H"][250] = (0.24, 0.0, 0.0)
    part = judged(history)[1]
    assert not part.passed
    assert part.nearest_m == pytest.approx(0.24)
    assert judged(history, "keep_out.radius_m=0")[1].passed


def test_availability_is_the_fraction_of_faultless_cycles_with_levels_below_their_limits() -> None:
    history = rows(10.0)
    history["navigation"]["protection_level_m"][:50, 1] = 0.06
    history["navigation"]["protection_level_m"][400:] = 1.0
    history["supervision"]["aborted"][450:] = 1
    assert judged(history)[1].availability == pytest.approx(1.0 - 100 / 450)
    fault = 'faults=[{device = "vmu", kind = "no_pose", at_s = 7.99}]'
    assert judged(history, fault)[1].availability == pytest.approx(1.0 - 50 / 400)


@pytest.mark.parametrize(
    ("field", "value", "expected"), [("reaction", 2, 1), ("reaction", 1, 0), ("aborted", 1, 1), ("aborted", 3, 0)]
)
def test_reaction_without_a_cause_is_a_false_alert(field: str, value: int, expected: int) -> None:
    history = rows(10.0)
    history["supervision"][field][200:] = value
    assert judged(history)[1].false_alerts == expected
    for table, name, wrong in (
        ("truth", "v_CT_H", (-0.3, 0.0, 0.0)),
        ("truth", "r_CT_H", (1.0, 0.3, 0.0)),
        ("navigation", "r_CT_H", (1.2, 0.0, 0.0)),
        ("supervision", "corridor_margin_m", -0.01),
        ("supervision", "closing_margin_mps", -0.01),
    ):
        caused = history.copy()
        caused[table][name] = wrong
        assert judged(caused)[1].false_alerts == 0
    assert judged(history, 'faults=[{device = "vmu", kind = "no_pose", at_s = 3.0}]')[1].false_alerts == 0


def test_faults_are_detected_by_what_follows_their_onset() -> None:
    first, second = (
        f'{{device = "vmu", kind = "{kind}", at_s = {at}}}' for kind, at in (("no_pose", 2), ("frozen", 6))
    )
    settings = f"faults=[{first}, {second}]"
    faults = load_scenario("scheme-1", (settings,)).value.faults
    history = rows(10.0)
    history["navigation"]["health"][50:80] = 4  # before both
    history["navigation"]["health"][150:] = 1
    history["supervision"]["reaction"][175:] = 2
    history["navigation"]["health"][350:] = 17
    state, _ = judged(history, settings)
    assert detection(state, 0, faults[0], None) == {
        "detected_s": pytest.approx(3.0), "detected_by": "navigation", "reaction": "hold", "reaction_s": 3.5,
    }  # fmt: skip
    stop = SafeStop(9.0, "guard")
    assert detection(state, 1, faults[1], stop) == {
        "detected_s": pytest.approx(7.0), "detected_by": "monitor", "reaction": "safe stop", "reaction_s": 9.0,
    }  # fmt: skip
    assert detection(state, 1, faults[1], SafeStop(6.5, "guard"))["detected_by"] == "guard"
    assert detection(state, 0, faults[0], SafeStop(1.0, "device"))["detected_s"] == pytest.approx(3.0)


def test_second_sensor_alone_detects_as_monitor() -> None:
    settings = 'faults=[{device = "vmu", kind = "offset", at_s = 2, value = [0.3, 0, 0]}]'
    history = rows(10.0)
    history["navigation"]["health"][150:] = 16
    state, _ = judged(history, settings)
    assert detection(state, 0, load_scenario("scheme-1", (settings,)).value.faults[0], None)["detected_by"] == "monitor"


def test_along_the_axis_what_is_left_to_the_keep_out_is_the_limit() -> None:
    params = integrity_params.integrity(SCENARIO).approach
    assert (params.keep_out, params.alert_distance, params.alert_slope) == (0.25, 0.06, 0.1)
    history = rows(10.0, 0.4)
    history["truth"]["v_CT_H"] = (-0.06, 0.0, 0.0)
    history["navigation"]["r_CT_H"][:, 0] += 0.06
    part = judged(history)[1]
    assert part.alert_limit_m == pytest.approx(0.4 - 0.25 - 0.06**2 / (2.0 * 0.018))
