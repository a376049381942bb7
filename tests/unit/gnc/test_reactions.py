"""Reactions to the health of the navigation: continue, coast, hold, retreat, abort, and the way back."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest

from hil.config.scenario import Scenario
from hil.core.gnc_records import GncHealth
from hil.core.messages import COMMAND, IMU, MAX_POSES, NAVIGATION, POSE, REFERENCE, SUPERVISION, new
from hil.gnc import guidance, step
from hil.gnc.approach_monitor import CORRIDOR, FIRST_HEALTH_CAUSE, HELD_TOO_LONG, NOT_ABORTED, UNPROTECTED
from hil.gnc.estimation.step_memory import new_memory
from hil.gnc.reactions import ABORT, COAST, CONTINUE, HOLD, RETREAT
from hil.gnc.step import APPROACH_STATE
from hil.params import gnc as gnc_params

STEP_S = 0.02
SUSPECT = int(GncHealth.VISION_SUSPECT)
LOST = int(GncHealth.VISION_LOST)


class WatchedApproach:
    """Guidance and approach monitor, with an estimate that follows the reference exactly."""

    def __init__(self, scenario: Scenario) -> None:
        self.params = gnc_params.gnc(scenario).approach
        self.state, self.supervision = new(APPROACH_STATE), new(SUPERVISION)
        self.reference, self.estimate = new(REFERENCE), new(NAVIGATION)
        self.estimate.valid, self.estimate.protection_level_m = 1, 0.02
        guidance.start(self.params.guidance, self.state.guidance)
        self.t_s = 0.0

    def run(self, duration_s: float, health: int = 0) -> WatchedApproach:
        self.estimate.health = health
        for _ in range(round(duration_s / STEP_S)):
            step.guide(self.params, self.state, self.t_s, self.supervision, self.reference)
            for name in ("r_CT_H", "v_CT_H", "q_CH"):
                self.estimate[name] = self.reference[name]
            step.watch_approach(
                self.params, self.state, self.t_s, self.estimate, self.reference, self.supervision, False
            )
            self.t_s += STEP_S
        return self

    @property
    def speed(self) -> float:
        return float(np.linalg.norm(self.reference.v_CT_H))

    @property
    def range(self) -> float:
        return float(np.linalg.norm(self.reference.r_CT_H))


@pytest.fixture(scope="module")
def moving(scheme_1: Scenario) -> WatchedApproach:
    """Return an approach after 40 s, moving; do not change it."""
    made = WatchedApproach(scheme_1).run(40.0)
    assert made.speed > 0.02
    assert made.supervision.reaction == CONTINUE
    return made


@pytest.fixture
def approach(moving: WatchedApproach) -> WatchedApproach:
    """Return an approach after 40 s, moving."""
    return deepcopy(moving)


def table(approach: WatchedApproach, condition: int, reaction: int) -> None:
    approach.params.reactions.table[condition] = reaction


def test_shipped_table_holds_for_suspect_vision_and_coasts_without_vision(approach: WatchedApproach) -> None:
    assert approach.run(5.0, LOST).supervision.reaction == CONTINUE
    approach.estimate.protection_level_m = 0.12  # beyond 0.7 of the limit across the axis
    assert approach.run(0.02, LOST).supervision.reaction == HOLD
    assert approach.supervision.aborted == NOT_ABORTED
    approach.params.monitor.alert_angle = 0.0
    approach.estimate.protection_level_rad = 0.1
    approach.run(1.1, LOST)
    assert approach.supervision.aborted == UNPROTECTED
    approach.run(1.0)  # an abort is final
    assert approach.supervision.reaction == ABORT


def test_no_more_than_two_holds_begin_in_a_minute(approach: WatchedApproach) -> None:
    begun = []
    for _ in range(300):
        before = approach.supervision.reaction
        approach.run(0.2, SUSPECT)
        if before != HOLD and approach.supervision.reaction == HOLD:
            begun.append(approach.t_s)
        approach.run(1.0)
    assert len(begun) > 2
    assert np.min(np.array(begun[2:]) - np.array(begun[:-2])) >= 60.0


@pytest.mark.parametrize("bit", range(6))
def test_each_bit_of_health_has_its_row_and_its_cause(approach: WatchedApproach, bit: int) -> None:
    approach.params.reactions.table[:] = CONTINUE
    table(approach, bit, ABORT)
    approach.params.reactions.coast_share = 0.0
    approach.run(0.02, 63 & ~(1 << bit))
    assert approach.supervision.aborted == NOT_ABORTED
    approach.run(0.02, 1 << bit)
    assert approach.supervision.aborted == FIRST_HEALTH_CAUSE + bit


def test_hold_brakes_and_the_approach_is_resumed_from_there(approach: WatchedApproach) -> None:
    at = approach.range
    approach.run(10.0, SUSPECT)
    assert approach.speed == 0.0
    assert at - 0.1 < approach.range < at
    held = approach.range
    approach.run(0.1)
    assert approach.supervision.reaction == CONTINUE
    assert approach.state.guidance.phase == 0
    approach.run(1.0)
    assert approach.range < held
    approach.run(180.0)
    assert approach.range == pytest.approx(0.4)


def test_hold_that_lasts_too_long_is_an_abort(approach: WatchedApproach) -> None:
    approach.run(approach.params.reactions.hold_max_s - 0.1, SUSPECT)
    assert approach.supervision.aborted == NOT_ABORTED
    approach.run(0.2, SUSPECT)
    assert approach.supervision.aborted == HELD_TOO_LONG
    assert approach.run(120.0).range == pytest.approx(5.0, abs=0.01)


def test_retreat_goes_out_and_comes_back(approach: WatchedApproach) -> None:
    table(approach, 1, RETREAT)
    approach.params.reactions.hold_max_s = 1000.0
    approach.run(60.0, SUSPECT)
    assert approach.supervision.reaction == RETREAT
    assert approach.range == pytest.approx(5.0, abs=0.02)
    assert approach.run(250.0).range == pytest.approx(0.4)
    assert approach.supervision.aborted == NOT_ABORTED


def test_hold_in_the_wait_ends_at_the_ready_point(approach: WatchedApproach) -> None:
    approach.run(200.0)
    assert approach.state.guidance.phase == 1
    approach.run(5.0, SUSPECT)
    approach.run(20.0)
    assert approach.state.guidance.phase == 1
    assert approach.range == pytest.approx(0.4)


def test_docking_is_no_go_while_a_reaction_lasts(approach: WatchedApproach) -> None:
    table(approach, 4, COAST)
    approach.run(200.0)
    assert approach.state.progress.docking_go == 1
    approach.run(0.06, int(GncHealth.MONITOR_DISAGREES))
    assert approach.state.progress.docking_go == 0


def test_protection_level_beyond_the_alert_limit_aborts_after_the_time_to_alert(approach: WatchedApproach) -> None:
    approach.estimate.protection_level_rad = 0.1
    approach.run(0.9)
    assert approach.supervision.aborted == NOT_ABORTED
    approach.run(0.3)
    assert approach.supervision.aborted == UNPROTECTED


def test_filters_may_converge_for_a_limited_time(scheme_1: Scenario) -> None:
    approach = WatchedApproach(scheme_1)
    approach.estimate.protection_level_m, approach.estimate.sigma_v_mps = 1.0, 0.02
    approach.estimate.sigma_r_m = 0.1
    limit_s = approach.params.reactions.acquisition_s + approach.params.reactions.time_to_alert_s
    approach.run(limit_s - 0.1)
    assert approach.supervision.aborted == NOT_ABORTED
    approach.run(0.3)
    assert approach.supervision.aborted == UNPROTECTED


def test_converged_navigation_is_permitted_no_more_than_its_sigmas(approach: WatchedApproach) -> None:
    assert approach.state.reactions.converged == 1
    approach.estimate.protection_level_m = 0.0
    approach.estimate.protection_level_m[1] = 0.15  # beyond the corridor, within an alert limit that is no part of it
    approach.params.monitor.minimum_radius = approach.params.monitor.cone = 0.03
    approach.params.monitor.alert_corridor = 2.0
    approach.run(0.2)
    assert approach.supervision.aborted == CORRIDOR


def test_coasting_chaser_fires_no_thruster(scheme_1: Scenario) -> None:
    params, state = gnc_params.gnc(scheme_1), new(step.GNC_STATE)
    guidance.start(params.approach.guidance, state.approach.guidance)
    params.approach.reactions.table[:] = COAST
    poses, samples = np.zeros(MAX_POSES, POSE).view(np.recarray), np.zeros(1, IMU).view(np.recarray)
    poses[0].z_TC_C, poses[0].q_CH = (-4.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    poses[0].covariance_position, poses[0].covariance_attitude = 1e-4 * np.eye(3), 1e-6 * np.eye(3)
    records = [new(dtype) for dtype in (NAVIGATION, REFERENCE, SUPERVISION, COMMAND)]
    memory, fired = new_memory(params.navigation.fusion), []
    for cycle in range(300):
        samples[0].force_C = samples[0].rate_C = 1e-6 * (cycle % 7)
        step.gnc_step(params, state, memory, 0.02 * cycle, samples, poses, int(cycle == 0), *records)
        fired.append(bool(records[3].on.any()))
    lost = round(scheme_1.gnc.integrity.lost_after_s / 0.02) + 1
    assert any(fired[:lost])
    assert not any(fired[lost:])
    assert records[2].reaction == COAST
