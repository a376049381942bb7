"""Hypotheses for inconsistent innovations: the vision unit is named only if nothing else explains them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.core.gnc_records import GncHealth
from hil.core.messages import new
from hil.gnc.estimation import hypotheses, thrust_model
from hil.gnc.estimation.fusion import FUSION_STATE
from hil.gnc.estimation.hypotheses import ATTITUDE, CORRELATED, DISTURBANCE, NAMED, SCALE, SWING
from hil.gnc.estimation.integrity import INTEGRITY_PARAMS, INTEGRITY_STATE

DT = 0.02
SUSPECT, UNKNOWN = GncHealth.VISION_SUSPECT.value, GncHealth.CAUSE_UNKNOWN.value


class Inconsistent:
    """An inconsistency of the position's innovations at 200 s."""

    def __init__(self) -> None:
        self.state, self.fusion = new(INTEGRITY_STATE), new(FUSION_STATE)
        self.fusion.cycle, self.state.biased, self.state.high[0] = 10_000, 1, 40.0
        self.params, self.fraction = new(INTEGRITY_PARAMS), 0.0
        self.params.suspect_after = 5

    def health(self, bits: int = SUSPECT) -> int:
        return int(hypotheses.name_cause(self.params, self.state, self.fusion, self.fraction, DT, bits))


def test_vision_is_named_if_nothing_else_explains_the_innovations() -> None:
    case = Inconsistent()
    assert case.health() == SUSPECT
    assert case.state.cause == NAMED


@pytest.mark.parametrize(
    ("field", "value", "cause"),
    [
        ("thrust.swing.until", 9_000, SWING), ("thrust.jumped", 9_000, DISTURBANCE),
        ("thrust.excess_C", (0.002, 0.0, 0.0), SCALE),
    ],
)  # fmt: skip
def test_what_the_imu_has_shown_by_itself_keeps_the_name_back(
    field: str, value: int | tuple[float, ...], cause: int
) -> None:
    case = Inconsistent()
    case.fusion.corrected[0] = -0.002
    record, *path = (case.fusion, *field.split("."))
    for name in path[:-1]:
        record = record[name]
    record[path[-1]] = value
    assert case.health(SUSPECT | GncHealth.THRUSTER_FAULT.value) == UNKNOWN | GncHealth.THRUSTER_FAULT.value
    assert case.state.cause == cause


def test_old_swing_explains_only_its_own_axis_and_a_mean_of_the_attitude_alone_names_no_device() -> None:
    old = Inconsistent()
    old.fusion.thrust.swing.until = 5_000
    assert old.health() == SUSPECT
    along, across = Inconsistent(), Inconsistent()
    along.fusion.thrust.swing.halves[0] = across.fusion.thrust.swing.halves[1] = 1
    assert along.health() == UNKNOWN
    assert across.health() == SUSPECT
    turned = Inconsistent()
    turned.state.high[0], turned.state.low[4] = 10.0, 40.0
    assert turned.health() == UNKNOWN
    assert turned.state.cause == ATTITUDE


def test_noise_that_is_more_correlated_than_the_budget_explains_a_mean_up_to_a_size() -> None:
    case = Inconsistent()
    case.fraction, case.state.peak = 0.15, 1.1
    assert case.health() == UNKNOWN
    assert case.state.cause == CORRELATED
    case.state.peak = 2.1
    assert case.health() == SUSPECT
    rejected = Inconsistent()
    rejected.fraction, rejected.state.peak, rejected.fusion.rejected_in_a_row = 0.15, 1.1, 5
    assert rejected.health() == SUSPECT


def test_cause_is_that_of_the_first_cycle_until_the_innovations_are_consistent_again() -> None:
    case = Inconsistent()
    case.fusion.thrust.jumped = 9_999
    assert case.health() == UNKNOWN
    case.fusion.thrust.jumped = 0
    assert case.health() == UNKNOWN
    assert case.health(0) == 0
    assert case.health() == SUSPECT


def test_readings_that_go_to_the_other_side_and_back_swing_and_a_leak_does_not() -> None:
    swings, leak = (new(thrust_model.THRUST_STATE).swing for _ in range(2))
    for step in range(1, 2000):
        mean = math.sin(2.0 * math.pi * 0.25 * step * DT)
        if abs(mean) > 0.5:
            thrust_model._note_swing(swings, 1, int(np.sign(mean)), step, DT)
        thrust_model._note_swing(leak, 1, 1, step, DT)
    assert swings.half_s == pytest.approx(2.0, abs=0.03)
    assert swings.until > 2000
    assert leak.until == 0
