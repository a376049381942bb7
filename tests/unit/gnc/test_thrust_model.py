"""Commanded thrust in the filters: kinds of steps, the bias, a leak, a lost IMU, and what the velocity gains."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import IMU, POSE, Array, new
from hil.gnc.estimation import fusion, thrust_model
from hil.gnc.estimation.error_state import BIAS, DRIFT
from hil.gnc.estimation.step_memory import new_memory, step_at
from hil.gnc.estimation.thrust_model import COMMANDED, MEASURED, QUIET, REGAINED
from hil.maths import quat
from hil.params import gnc as gnc_params
from tests.support.plain_filters import THRUST_OFF

SIGMA_M, SIGMA_RAD = 0.005, math.radians(0.033)
FRAME = 8  # steps from one exposure to the next
DT = 0.02
NOTHING: tuple[int, ...] = ()
FORWARD, BACK = (0, 4), (1, 5)  # thrusters along c's first axis, whose torques cancel
BIAS_OFF = np.array([3e-4, -2e-4, 4e-4])  # m/s^2, of the accelerometer's bias, from its initial estimate


def fusion_params(*settings: str, scheme: str = "scheme-2") -> np.record:
    """Return the parameters of a scheme with commanded thrust and its error budget."""
    return gnc_params.navigation(load_scenario(scheme, settings).value).fusion


@pytest.fixture
def params() -> np.record:
    """Return those that are shipped."""
    return fusion_params()


class Flight:
    """A chaser near 10 m that thrusts as commanded, with the filters on its IMU, its commands and its poses.

    leak: m/s^2, constant specific force in c. wrong: added to all that the IMU reads. force_scale, torque_scale: of the
    true forces and torques against those that the filters assume.
    """

    def __init__(self, params: np.record, rng: np.random.Generator, leak: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self.params, self._rng, self._leak = params, rng, np.array(leak)
        self.state, self.memory = new(fusion.FUSION_STATE), new_memory(params)
        self.x = np.array([10.0, -0.5, 0.5, 0.01, -0.004, 0.006])
        self.q = quat.from_rotation_vector(np.array([0.05, -0.04, 0.03]))
        self.w = quat.transform(self.q, np.array([0.0, -params.orbit.mean_motion, 0.0]))
        self.wrong, self.force_scale, self.torque_scale = 0.0, 1.0, 1.0
        self._drift, self._bias = params.akf.initial_drift, params.pkf.initial_bias
        self._sigma_gyro, self._sigma_accelerometer = params.akf.sigma_gyro, params.pkf.sigma_accelerometer
        self._force, self._torque = params.thrust.force, params.thrust.torque
        self._transition, self._response = params.pkf.hill_transition, params.pkf.hill_response
        self._hill = quat.from_rotation_vector(np.array([0.0, params.orbit.mean_motion * DT, 0.0]))

    def step(self, on: Sequence[int] = NOTHING, unseen: Sequence[int] = NOTHING, poses: bool = True) -> np.record:
        """Fly a step with the thrusters ``on``, and with uncommanded ones; return its STEP."""
        params, imu, cycle = self.params, new(IMU), int(self.state.cycle)
        force = self._leak.copy()
        self.state.commanded[:] = 0
        self.state.commanded[list(on)] = 1
        if cycle:
            torque = np.zeros(3)
            for j in (*on, *unseen):
                force += self.force_scale * self._force[j]
                torque += self.torque_scale * self._torque[j]
            self.w = self.w + DT * torque
            self._move(force)
        noise = self._rng.standard_normal(6)
        imu.rate_C = self.w + self._drift + self._sigma_gyro * noise[:3] + self.wrong
        imu.force_C = force + self._bias + BIAS_OFF + self.wrong + self._sigma_accelerometer * noise[3:]
        fusion.advance(params, self.state, self.memory, imu)
        if poses and cycle % FRAME == 0:
            fusion.fuse(params, self.state, self.memory, self._pose(cycle))
        self.state.cycle += 1
        return step_at(params, self.memory, cycle)

    def steps(self, count: int, on: Sequence[int] = NOTHING) -> None:
        """Fly ``count`` steps with poses."""
        for _ in range(count):
            self.step(on)

    def _move(self, force: Array) -> None:
        after = quat.multiply(quat.from_rotation_vector(DT * self.w), quat.multiply(self.q, self._hill))
        middle = self.q + after
        quat.normalise(middle)
        self.x = self._transition @ self.x + self._response @ quat.transform_back(middle, force)
        self.q = after

    def _pose(self, cycle: int) -> np.record:
        pose, noise = new(POSE), self._rng.standard_normal(6)
        pose.t_s, pose.fresh = DT * cycle, 1
        pose.q_CH = quat.multiply(quat.from_rotation_vector(SIGMA_RAD * noise[:3]), self.q)
        pose.z_TC_C = SIGMA_M * noise[3:] - quat.transform(self.q, self.x[:3])
        pose.covariance_position, pose.covariance_attitude = SIGMA_M**2 * np.eye(3), SIGMA_RAD**2 * np.eye(3)
        return pose

    def position_error(self) -> Array:
        """Return the error (3,) of the estimated position."""
        return np.asarray(self.state.filters.pkf.x[:3] - self.x[:3])

    def velocity_error(self) -> Array:
        """Return the error (3,) of the estimated velocity."""
        return np.asarray(self.state.filters.pkf.x[3:6] - self.x[3:])

    def turning(self) -> Array:
        """Return the true rate (3,) of c against H, in c."""
        return np.asarray(self.w - quat.transform(self.q, np.array([0.0, -self.params.orbit.mean_motion, 0.0])))

    def known(self) -> Array:
        """Return all that the filters hold of the past."""
        f = self.state.filters
        return np.concatenate([np.ravel(part) for part in (f.akf.x, f.akf.w_CH_C, f.pkf.x, f.parameters, f.p)])


def test_step_is_quiet_without_command_and_thrust_once_valves_have_settled(
    params: np.record, rng: np.random.Generator
) -> None:
    flight, settle = Flight(params, rng), int(params.thrust.settle)
    flight.steps(60)
    assert flight.step().kind == QUIET
    assert [flight.step(FORWARD).kind for _ in range(5)] == [MEASURED] * 5
    assert [flight.step().kind for _ in range(settle + 5)] == [MEASURED] * settle + [QUIET] * 5


@pytest.mark.parametrize("thruster", range(16))
def test_reading_of_an_uncommanded_thruster_is_measured(
    params: np.record, rng: np.random.Generator, thruster: int
) -> None:
    flight = Flight(params, rng)
    flight.steps(60)
    assert flight.step().kind == QUIET
    assert flight.step(unseen=(thruster,)).kind == MEASURED
    assert flight.step().kind == QUIET


def test_filters_without_commanded_thrust_measure_each_step(rng: np.random.Generator) -> None:
    flight = Flight(fusion_params(THRUST_OFF), rng)
    assert {int(flight.step().kind) for _ in range(60)} == {MEASURED}


def test_quiet_readings_give_the_bias_within_two_seconds(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, rng)
    flight.steps(101)
    error = flight.state.filters.pkf.x[6:9] - params.pkf.initial_bias - BIAS_OFF
    assert np.abs(error).max() < 5e-5
    sigma = np.sqrt(np.diag(flight.state.filters.p)[BIAS : BIAS + 3])
    assert np.abs(error / sigma).max() < 4.0


def test_constant_leak_becomes_the_disturbance(params: np.record, rng: np.random.Generator) -> None:
    flight, at, largest = Flight(params, rng, leak=(3e-4, 0.0, 0.0)), int(params.errors.disturbance), 0.0
    for k in range(3000):
        flight.step()
        if k > 250:
            largest = max(largest, float(np.abs(flight.position_error()).max()))
    found = flight.state.filters.parameters[at : at + 3]
    np.testing.assert_allclose(found, [3e-4, 0.0, 0.0], atol=5e-5)
    assert largest < 0.01
    assert flight.state.rejected_position == flight.state.rejected_attitude == 0


@pytest.mark.parametrize("leak", [4e-4, 6e-4, 1e-3])
def test_leak_near_the_noise_of_a_reading_is_measured_in_all_steps(
    params: np.record, rng: np.random.Generator, leak: float
) -> None:
    """If some of its readings counted as quiet, the leak would be lost in them, and poses would seem to drift."""
    flight = Flight(params, rng)
    flight.steps(1000)
    flight._leak[0] = leak
    kinds = [int(flight.step().kind) for _ in range(500)]
    assert kinds.count(QUIET) < 10
    flight.steps(1000)
    assert np.abs(flight.velocity_error()).max() < 5e-4


def test_lost_imu_is_replaced_from_its_first_wrong_reading_on(params: np.record) -> None:
    """Bit by bit as if the commands had been used from there on."""
    late, at_once = (Flight(params, np.random.default_rng(8)) for _ in range(2))
    for flight in (late, at_once):
        flight.steps(405)
    fusion.replace_imu(params, at_once.state, at_once.memory, 0)
    late.wrong = 1e-2
    for k in range(10):
        late.step(FORWARD if k < 5 else NOTHING, poses=False)
        at_once.step(FORWARD if k < 5 else NOTHING, poses=False)
    assert np.abs(late.velocity_error()).max() > 1e-3
    fusion.replace_imu(params, late.state, late.memory, 10)
    np.testing.assert_array_equal(late.known(), at_once.known())
    assert step_at(params, late.memory, 405).kind == step_at(params, late.memory, 414).kind == COMMANDED
    assert step_at(params, late.memory, 404).kind == QUIET
    late.steps(500)
    assert np.abs(late.velocity_error()).max() < 1e-3


def test_gyros_that_are_used_again_have_the_drift_of_before(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, rng)
    flight.steps(400)
    filters, own = flight.state.filters, slice(DRIFT, DRIFT + 3)
    fusion.replace_imu(params, flight.state, flight.memory, 0)
    before, variance = filters.akf.x[4:].copy(), np.diag(filters.p)[own].copy()
    flight.torque_scale, flight.wrong = 0.9, math.nan
    flight.steps(50, (0,))
    flight.steps(600)
    rate_error = 0.1 * 50 * DT * params.thrust.torque[0]
    np.testing.assert_allclose(filters.akf.x[4:] - before, rate_error, atol=2e-4)
    assert np.abs(rate_error).max() > 4e-4
    flight.state.thrust.without_imu, flight.wrong = REGAINED, 0.0
    step = flight.step(poses=False)
    assert (step.kind, step.regains) == (QUIET, 1)
    np.testing.assert_array_equal(filters.akf.x[4:], before)
    np.testing.assert_allclose(np.diag(filters.p)[own], variance, rtol=1e-3)
    assert np.abs(filters.akf.w_CH_C - flight.turning()).max() < 1e-6
    assert flight.step(poses=False).regains == 0


def test_velocity_is_known_far_better_with_commanded_thrust() -> None:
    rms = []
    for params in (fusion_params(), fusion_params(THRUST_OFF)):
        flight, errors = Flight(params, np.random.default_rng(11)), []
        for k in range(9000):
            flight.step({0: FORWARD, 1: BACK}.get(k % 500 // 10, NOTHING))
            if k >= 6000:  # bias and disturbance are known
                errors.append(flight.velocity_error())
        rms.append(math.sqrt(np.mean(np.square(errors))))
    assert rms[0] < 0.5 * rms[1]


@pytest.mark.parametrize("error", [-0.03, 0.04])
def test_vision_alone_learns_the_scale_of_the_thrust(error: float) -> None:
    params = fusion_params(scheme="scheme-3")
    flight = Flight(params, np.random.default_rng(3))
    flight.force_scale = 1.0 + error
    thrust_model.lose(flight.state.thrust, flight.state.filters)  # it has no IMU from the start
    flight.steps(1500)
    for _ in range(4):
        flight.steps(80, FORWARD)
        flight.steps(200)
    filters, k = flight.state.filters, int(params.errors.thrust_scale)
    sigma = math.sqrt(filters.p[k, k])
    assert sigma < 0.5 * math.sqrt(params.errors.variance[k])
    assert abs(filters.parameters[k] - error) < 3.0 * sigma


def test_scale_of_the_thrust_is_no_state_where_an_accelerometer_measures_it(params: np.record) -> None:
    assert params.errors.thrust_scale == 0


@pytest.mark.parametrize("sound", [True, False])
def test_gate_opens_again_for_poses_that_agree_for_long_if_the_imu_is_accused(
    params: np.record, rng: np.random.Generator, sound: bool
) -> None:
    """The jump stays an error that is possible; a sound IMU is a witness against such poses."""
    flight = Flight(params, rng)
    flight.steps(405)
    if not sound:
        fusion.replace_imu(params, flight.state, flight.memory, 0)
    flight.x[1] += 0.4
    accepted = int(flight.state.accepted)
    flight.steps(50 * FRAME)
    assert (flight.state.accepted == accepted) == sound
    assert flight.state.jump_m[1] == pytest.approx(0.0 if sound else 0.4, abs=0.05)
    if not sound:
        flight.steps(50 * FRAME)
        assert np.abs(flight.position_error()).max() < 0.02
