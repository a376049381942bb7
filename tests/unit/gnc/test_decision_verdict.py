"""Decision verdict: what makes a go an error, an estimate wrong about itself, and an accusation a false one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.gnc_records import GncHealth
from hil.core.messages import CYCLE
from hil.loop.compiled.run_stats import counted
from hil.report.integrity import decision_part

STEP_S = 0.02
GO_AT = 250
"""Cycle in which the estimate has been ready for the dwell time of 5 s."""


def rows(seconds: float = 30.0) -> np.ndarray:
    """Return the rows of a chaser at the ready point, ready from the start, with a perfect estimate."""
    made = np.zeros(round(seconds / STEP_S), CYCLE)
    made["t_s"] = STEP_S * np.arange(len(made))
    made["truth"]["r_CT_H"] = made["navigation"]["r_CT_H"] = (0.4, 0.0, 0.0)
    made["truth"]["q_CH"] = made["navigation"]["q_CH"] = (0.0, 0.0, 0.0, 1.0)
    made["navigation"]["valid"] = 1
    made["navigation"]["protection_level_m"] = 0.01
    made["navigation"]["protection_level_rad"] = 0.001
    made["reference"]["from_H"], made["reference"]["to_H"] = (5.0, 0.0, 0.0), (0.4, 0.0, 0.0)
    made["nees_position"] = made["nees_attitude"] = np.nan
    return made


def judged(history: np.ndarray, *settings: str) -> tuple[np.record, Any]:
    scenario = load_scenario("scheme-1", settings).value
    state = counted(history, scenario).integrity
    return state.decision, decision_part(state, scenario)


def test_go_at_the_ready_point_is_right() -> None:
    _, part = judged(rows())
    assert part.passed
    assert part.go_s == pytest.approx(GO_AT * STEP_S)
    assert (part.error, part.beyond_level_cycles, part.nees_ok) == (False, 0, None)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("r_CT_H", (0.451, 0.0, 0.0)),
        ("r_CT_H", (0.4, 0.0, -0.0201)),
        ("v_CT_H", (0.0, 0.0201, 0.0)),
        ("q_CH", (0.0, 0.0, np.sin(np.radians(0.51)), np.cos(np.radians(0.51)))),
        ("w_CI_C", (0.0, 0.0, np.radians(0.6))),
    ],
)
def test_go_with_the_truth_outside_the_requirement_is_an_error(field: str, value: tuple[float, ...]) -> None:
    history = rows()
    history["truth"][field][:GO_AT] = value  # no decision relies on it before the go
    assert not judged(history)[1].error
    history["truth"][field][GO_AT] = value
    part = judged(history)[1]
    assert part.error
    assert not part.passed


@pytest.mark.parametrize(
    ("table", "field", "value", "error"),
    [
        ("navigation", "health", 0, True),
        ("navigation", "health", int(GncHealth.VISION_SUSPECT), False),
        ("supervision", "reaction", 1, False),
        ("supervision", "aborted", 1, False),
    ],
)
def test_go_is_relied_on_until_an_alarm_or_its_time_is_over(table: str, field: str, value: int, error: bool) -> None:
    required_s = load_scenario("scheme-1").value.requirements.required_ready_s
    history, last = rows(60.0), GO_AT + round(required_s / STEP_S)
    history["supervision"]["ready_since_s"][GO_AT + 1 :] = np.nan  # the go is withdrawn
    history[table][field][GO_AT + 1 :] = value
    history["truth"]["r_CT_H"][last + 2 :] = (0.5, 0.0, 0.0)
    history["navigation"]["r_CT_H"][last + 2 :] = (0.5, 0.0, 0.0)
    assert not judged(history)[1].error
    history["truth"]["r_CT_H"][last - 1] = (0.5, 0.0, 0.0)
    assert judged(history)[1].error == error


@pytest.mark.parametrize("what", ["position", "attitude"])
def test_error_beyond_the_level_counts_unless_an_alarm_follows_within_two_seconds(what: str) -> None:
    history, half_rad = rows(), 0.5 * 1.01 * np.sqrt(3.0) * 0.001
    history["supervision"]["ready_since_s"] = np.nan
    if what == "position":
        history["navigation"]["r_CT_H"][400:450, 2] = 0.0101
    else:
        history["navigation"]["q_CH"][400:450, 2:] = np.sin(half_rad), np.cos(half_rad)
    part = judged(history)[1]
    assert part.beyond_level_cycles == 50
    assert not part.passed
    for alarm, expected in ((499, 0), (502, 50)):  # 1.98 s and 2.04 s after it began
        followed = history.copy()
        followed["navigation"]["health"][alarm:] = GncHealth.VISION_SUSPECT
        assert judged(followed)[1].beyond_level_cycles == expected


def test_error_beyond_the_level_at_the_end_of_a_run_counts() -> None:
    history = rows()
    history["navigation"]["r_CT_H"][-7:, 2] = 0.0101
    assert judged(history)[1].beyond_level_cycles == 7


def test_error_that_exceeds_no_level_does_not_count() -> None:
    history = rows()
    history["navigation"]["r_CT_H"][:, 2] = 0.0099
    history["navigation"]["protection_level_rad"] = np.nan  # it reports none
    history["navigation"]["q_CH"][:, 2:] = np.sin(0.002), np.cos(0.002)
    assert judged(history)[1].passed


def test_accusations_before_the_first_fault_are_false() -> None:
    history = rows()
    for first, health in ((100, GncHealth.IMU_SUSPECT), (200, GncHealth.THRUSTER_FAULT), (1000, 15)):
        history["navigation"]["health"][first : first + 50] = health
    history["navigation"]["health"][320:340] = GncHealth.VISION_LOST  # one, as the next bit comes on its own
    history["navigation"]["health"][340:350] = GncHealth.VISION_LOST | GncHealth.VISION_SUSPECT
    counted = {}
    for settings in ((), ('faults=[{device = "vmu", kind = "no_pose", at_s = 15}]',)):
        found, _ = judged(history, *settings)
        counted[settings] = tuple(int(n) for n in found.false[:3])
    assert list(counted.values()) == [(3, 2, 2), (2, 1, 1)]


@pytest.mark.parametrize(("position", "attitude", "ok"), [(9.0, 6.0, True), (40.0, 6.0, False), (9.0, 30.0, False)])
def test_mean_nees_beyond_a_consistent_filters_is_not_passed(position: float, attitude: float, ok: bool) -> None:
    history = rows(120.0)
    history["nees_position"][::8], history["nees_attitude"][::8] = position, attitude
    history["nees_position"][:4999:8] = 1000.0  # while the filters converge
    part = judged(history)[1]
    assert (part.nees_ok, part.passed) == (ok, ok)
