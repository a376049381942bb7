"""A position whose attitude is a guess: fused alone, and no evidence about the attitude."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import IMU, NAVIGATION, POSE, POSITION_ONLY, UNKNOWN_ATTITUDE_RAD, new
from hil.gnc.estimation import navigation
from hil.gnc.estimation.step_memory import new_memory
from hil.maths import quat
from hil.params import gnc as gnc_params

Array = np.ndarray
TRUE_R, TRUE_Q = np.array([3.0, -0.2, 0.3]), np.array([0.0, 0.0, 0.0, 1.0])
SIGMA_M = 0.005


class Flight:
    """Chaser at rest: a cycle with a pose every 0.16 s."""

    def __init__(self) -> None:
        self.params = gnc_params.navigation(load_scenario("scheme-1").value)
        self.state, self.memory = new(navigation.NAVIGATION_STATE), new_memory(self.params.fusion)
        self.rng, self.out, self.cycle = np.random.default_rng(4), new(NAVIGATION), 0
        self.samples = np.zeros(1, IMU).view(np.recarray)
        self.samples.rate_C = self.params.fusion.akf.initial_drift - [0.0, self.params.fusion.orbit.mean_motion, 0.0]

    def pose(self, alone: bool, off_m: float = 0.0) -> np.record:
        """Return a pose; ``alone``: its attitude is 90 deg off, as a guess may be."""
        pose = new(POSE)
        pose.t_s, pose.fresh = 0.02 * self.cycle, 1
        noise = self.rng.standard_normal(6)
        pose.z_TC_C = SIGMA_M * noise[:3] - TRUE_R + [0.0, off_m, 0.0]
        turn = np.array([np.pi / 2, 0.0, 0.0]) if alone else 5e-4 * noise[3:]
        pose.q_CH = quat.multiply(quat.from_rotation_vector(turn), TRUE_Q)
        pose.covariance_position = SIGMA_M**2 * np.eye(3)
        pose.covariance_attitude = (UNKNOWN_ATTITUDE_RAD if alone else 5e-4) ** 2 * np.eye(3)
        pose.status = POSITION_ONLY if alone else 0
        return pose

    def fly(self, poses: int, alone: bool, off_m: float = 0.0) -> None:
        """Fly until ``poses`` more have come."""
        for _ in range(8 * poses):
            arrived = [self.pose(alone, off_m)] if self.cycle % 8 == 0 else []
            given = np.zeros(max(1, len(arrived)), POSE).view(np.recarray)
            for k, pose in enumerate(arrived):
                given[k] = pose
            navigation.navigate(self.params, self.state, self.memory, self.samples, given, len(arrived), self.out)
            self.cycle += 1

    @property
    def turn_rad(self) -> float:
        """Return the error of the attitude."""
        turn = np.empty(3)
        quat.rotation_between(self.out.q_CH, TRUE_Q, turn)
        return float(np.linalg.norm(turn))


def test_position_is_corrected_and_the_attitude_left_alone() -> None:
    flight = Flight()
    flight.fly(12, alone=False)
    before = flight.state.fusion.filters.akf.x[:4].copy()
    sigma_m, attitude_log = flight.out.sigma_v_mps.copy(), float(flight.state.fusion.noise.log[1])
    flight.fly(100, alone=True)
    assert flight.state.fusion.accepted == 12 - 1 + 100
    assert flight.turn_rad < 2e-3
    assert np.abs(flight.out.r_CT_H - TRUE_R).max() < 0.005
    assert (flight.out.sigma_v_mps < 0.5 * sigma_m).all()
    assert flight.state.fusion.noise.log[1] == attitude_log
    assert flight.out.health == 0
    assert not np.array_equal(before, flight.state.fusion.filters.akf.x[:4])  # the gyro has carried it on


def test_positions_alone_do_not_make_the_attitude_more_certain() -> None:
    sigma_rad = {}
    for alone in (False, True):
        flight = Flight()
        flight.fly(4, alone=False)
        before = flight.out.sigma_attitude_rad.copy()
        flight.fly(60, alone)
        sigma_rad[alone] = flight.out.sigma_attitude_rad / before
    assert (sigma_rad[True] > 0.999).all()
    assert (sigma_rad[False] < 0.99).all()


def test_filters_do_not_start_from_a_position_alone() -> None:
    flight = Flight()
    flight.fly(5, alone=True)
    assert flight.out.valid == 0
    flight.fly(1, alone=False)
    assert flight.out.valid == 1
    assert flight.turn_rad < 3e-3


@pytest.mark.parametrize("off_m", [0.3, 0.08])
def test_wrong_position_alone_is_rejected_and_opens_no_closed_gate(off_m: float) -> None:
    flight = Flight()
    flight.fly(40, alone=False)
    flight.fly(40, alone=True, off_m=off_m)
    assert flight.state.fusion.accepted == 39
    assert np.abs(flight.out.r_CT_H - TRUE_R).max() < 0.01
    assert flight.out.health != 0
