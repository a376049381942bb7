"""Poses that come late, twice, out of order or wrong: each is fused at its own time, counted, or kept out."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.config.scenario import Scenario
from hil.core.messages import IMU, POSE, new
from hil.dynamics.hill import input_response, transition
from hil.gnc.estimation import fusion
from hil.gnc.estimation.step_memory import new_memory
from hil.maths import quat
from hil.params import gnc as gnc_params

SIGMA_M, SIGMA_RAD = 0.005, math.radians(0.033)
FRAME = 8  # steps from one exposure to the next


@pytest.fixture
def params(plain_filters_2: Scenario) -> np.record:
    """Return the shipped parameters."""
    return gnc_params.navigation(plain_filters_2).fusion


class Flight:
    """A turning, accelerating approach from 10 m: IMU samples of every step, poses of any moment."""

    def __init__(self, params: np.record, steps: int, rng: np.random.Generator, velocity: float = 0.02) -> None:
        self._params, self._rng = params, rng
        own, dt = params.pkf, params.pkf.dt_s
        self._w, force_H = np.array([0.02, -0.03, 0.015]), np.array([0.004, -0.002, 0.003])
        hill = quat.from_rotation_vector(np.array([0.0, params.orbit.mean_motion * dt, 0.0]))
        turn = quat.from_rotation_vector(self._w * dt)
        self.x = [np.array([10.0, -0.5, 0.5, velocity, -velocity, velocity])]
        self.q, self.imu = [quat.from_rotation_vector(np.array([0.1, -0.05, 0.08]))], [new(IMU)]
        for _ in range(steps):
            self.x.append(own.hill_transition @ self.x[-1] + own.hill_response @ force_H)
            self.q.append(quat.multiply(turn, quat.multiply(self.q[-1], hill)))
            middle, sample = self.q[-1] + self.q[-2], new(IMU)
            quat.normalise(middle)
            sample.rate_C = self._w + params.akf.sigma_gyro * rng.standard_normal(3)
            sample.force_C = quat.transform(middle, force_H) + own.sigma_accelerometer * rng.standard_normal(3)
            self.imu.append(sample)

    def pose(self, step: int, part: float = 0.0, off_m: float = 0.0, off_rad: float = 0.0) -> np.record:
        """Return the pose of ``part`` of a step after ``step``, noisy, and wrong by ``off_m`` and ``off_rad``."""
        dt, pose = self._params.pkf.dt_s, new(POSE)
        q = quat.multiply(quat.from_rotation_vector(self._w * part * dt), self.q[step])
        r = self.x[step][:3] + part * dt * self.x[step][3:]
        noise = self._rng.standard_normal(6)
        pose.t_s, pose.fresh = (step + part) * dt, 1
        pose.q_CH = quat.multiply(quat.from_rotation_vector(SIGMA_RAD * noise[:3] + np.array([off_rad, 0, 0])), q)
        pose.z_TC_C = SIGMA_M * noise[3:] - quat.transform(q, r) + np.array([off_m, 0.0, 0.0])
        pose.covariance_position, pose.covariance_attitude = SIGMA_M**2 * np.eye(3), SIGMA_RAD**2 * np.eye(3)
        return pose


class Run:
    """The filters on a flight's IMU samples, step by step."""

    def __init__(self, params: np.record, flight: Flight) -> None:
        self._params, self._flight = params, flight
        self.state, self._memory = new(fusion.FUSION_STATE), new_memory(params)

    def step(self, *poses: np.record) -> None:
        fusion.advance(self._params, self.state, self._memory, self._flight.imu[self.state.cycle])
        for pose in poses:
            fusion.fuse(self._params, self.state, self._memory, pose)
        self.state.cycle += 1

    def steps(self, count: int) -> None:
        for _ in range(count):
            self.step()

    def known(self) -> np.ndarray:
        """Return all that the filters hold of the past, bit for bit."""
        f = self.state.filters
        return np.concatenate([np.ravel(part) for part in (f.akf.x, f.akf.w_CH_C, f.pkf.x, f.p)])

    def counts(self) -> tuple[int, ...]:
        names = ("accepted", "rejected_position", "rejected_attitude", "duplicates", "too_late")
        return tuple(int(self.state[name]) for name in names)


def arrive(params: np.record, flight: Flight, poses: dict[int, np.record], delay: Callable[[int], int]) -> Run:
    """Fly to the flight's end; the pose of each step comes ``delay`` steps later."""
    run, come = Run(params, flight), {}
    for step, pose in poses.items():
        come.setdefault(step + delay(step), []).append(pose)
    for k in range(len(flight.imu)):
        run.step(*come.get(k, []))
    return run


def test_constant_lateness_costs_nothing_once_the_pose_is_in(params: np.record, rng: np.random.Generator) -> None:
    """Bit for bit, for 0 to 25 steps, the first pose late as well."""
    flight = Flight(params, 130, rng)
    poses = {k: flight.pose(k, rng.uniform(-0.4, 0.4) if k else 0.0) for k in range(0, 100, FRAME)}
    in_time = arrive(params, flight, poses, lambda k: 0)
    assert in_time.counts() == (12, 0, 0, 0, 0)
    for late in range(1, 26):
        run = arrive(params, flight, poses, lambda k, late=late: late)
        np.testing.assert_array_equal(run.known(), in_time.known())
        assert run.counts() == in_time.counts()
        assert run.state.start_cycle == 0


def test_late_pose_gives_at_once_what_the_pose_in_time_has_led_to(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, 60, rng)
    poses, in_time, late = [flight.pose(0), flight.pose(8, 0.3)], Run(params, flight), Run(params, flight)
    for k in range(30):
        in_time.step(*[pose for pose in poses if round(pose.t_s / 0.02) == k])
        late.step(*{3: [poses[0]], 21: [poses[1]]}.get(k, []))
        if 3 <= k < 8 or k >= 21:
            np.testing.assert_array_equal(late.known(), in_time.known())
        else:
            assert not np.array_equal(late.known(), in_time.known())
        if k == 21:  # its innovation is that of its own time, and shown when it comes
            assert 0.0 < late.state.nis_position < params.pkf.gate


def test_random_lateness_and_order_cost_nothing_once_all_poses_are_in(
    params: np.record, rng: np.random.Generator
) -> None:
    flight = Flight(params, 300, rng)
    poses = {k: flight.pose(k, rng.uniform(-0.45, 0.45)) for k in range(0, 240, FRAME)}
    in_time = arrive(params, flight, poses, lambda k: 0)
    for _ in range(10):
        delays = {k: int(rng.integers(0, 60)) if k else 0 for k in poses}
        come = [k + delays[k] for k in poses]
        assert come != sorted(come)
        run = arrive(params, flight, poses, delays.__getitem__)
        np.testing.assert_array_equal(run.known(), in_time.known())
        assert run.counts() == in_time.counts()


def test_order_of_two_poses_of_one_step_hardly_matters(params: np.record, rng: np.random.Generator) -> None:
    """To the position below a sigma: it is not corrected by a later attitude. To the attitude nothing."""
    flight = Flight(params, 40, rng)
    start, first, second, third = flight.pose(0), *(flight.pose(16, part) for part in (-0.3, 0.2, 0.4))
    runs = [Run(params, flight) for _ in range(2)]
    for run, order in zip(runs, ((first, second), (second, first)), strict=True):
        run.step(start)
        run.steps(16)
        for pose in order:
            run.step(pose)
        run.step(third)
        assert run.counts() == (2, 0, 0, 0, 1)  # capacity for two
    a, b = (run.state.filters for run in runs)
    np.testing.assert_allclose(b.akf.x, a.akf.x, atol=1e-3 * math.sqrt(a.p[9, 9]))
    np.testing.assert_allclose(b.p[9:15, 9:15], a.p[9:15, 9:15], rtol=1e-6, atol=1e-20)
    assert np.abs((b.pkf.x - a.pkf.x) / np.sqrt(np.diag(a.p)[:9])).max() < 1.0
    np.testing.assert_allclose(np.diag(b.p)[:9], np.diag(a.p)[:9], rtol=0.01)


def alongside(params: np.record, flight: Flight, poses: dict[int, list], extra: dict[int, list]) -> tuple[int, ...]:
    """Return the counts of a run that got ``extra`` as well and has exactly the estimate of the run without them."""
    without, run = Run(params, flight), Run(params, flight)
    for k in range(len(flight.imu)):
        without.step(*poses.get(k, []))
        run.step(*poses.get(k, []), *extra.get(k, []))
        np.testing.assert_array_equal(run.known(), without.known())
        np.testing.assert_array_equal(run.state.nis_position, without.state.nis_position)
    assert without.counts()[1:] == (0, 0, 0, 0)
    return run.counts()


def test_noise_scale_is_that_of_the_reported_standard_deviations(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, 130, rng)
    poses, doubled = {k: flight.pose(k) for k in range(0, 100, FRAME)}, {}
    for k, pose in poses.items():
        doubled[k] = pose.copy()
        doubled[k].covariance_position *= 4.0
        doubled[k].covariance_attitude *= 4.0
    reported = arrive(params, flight, doubled, lambda k: 0)
    scaled = params.copy()
    scaled.noise_scale = 2.0
    by_key = arrive(scaled, flight, poses, lambda k: 0)
    assert by_key.counts() == reported.counts() == (12, 0, 0, 0, 0)
    np.testing.assert_array_equal(by_key.known(), reported.known())


def test_duplicate_changes_nothing_and_is_counted(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, 90, rng)
    start, one, other = flight.pose(0), flight.pose(8, 0.3), flight.pose(8, -0.2)
    poses = {0: [start], 8: [one], 11: [other], 24: [flight.pose(24)]}
    extra = {0: [start], 8: [one, start], 20: [other, one], 50: [start, one, other]}
    assert alongside(params, flight, poses, extra) == (3, 0, 0, 8, 0)


def test_pose_older_than_the_memory_changes_nothing_and_is_counted(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, 110, rng)
    poses = {0: [flight.pose(0)], 96: [flight.pose(96)]}
    extra = {k: [flight.pose(k - params.memory)] for k in (64, 99, 105)}
    assert alongside(params, flight, poses, extra) == (1, 0, 0, 0, 3)
    poses[105] = [flight.pose(105 - params.memory + 1)]
    assert alongside(params, flight, poses, {}) == (2, 0, 0, 0, 0)


def test_pose_of_before_the_start_changes_nothing_and_is_counted(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, 40, rng)
    early = flight.pose(0)
    early.t_s = -0.16
    poses, extra = {20: [flight.pose(16)], 30: [flight.pose(24)]}, {21: [flight.pose(8)], 33: [flight.pose(15), early]}
    assert alongside(params, flight, poses, extra) == (1, 0, 0, 0, 3)


@pytest.mark.parametrize("part", [-0.5, -0.25, 0.25, 0.5])
def test_exposure_between_two_steps_is_fused_at_its_own_time(
    params: np.record, plain_filters_2: Scenario, part: float
) -> None:
    """As by the same filters with steps a quarter as long, to 1 % of what taking it for the step's own would cost."""
    fine, w0, quarter = params.copy(), params.orbit.mean_motion, params.pkf.dt_s / 4
    for own in (fine.akf, fine.pkf):
        own.dt_s = quarter
    fine.pkf.hill_transition, fine.pkf.hill_response = transition(w0, quarter), input_response(w0, quarter)
    for own, name in ((fine.akf, "sigma_gyro"), (fine.akf, "sigma_drift"), (fine.pkf, "sigma_accelerometer")):
        own[name] *= 2.0
    fine.pkf.sigma_bias *= 2.0
    for each in (params, fine):
        each.pkf.initial_velocity_sigma = 1.0
    coarse_flight, found = Flight(params, 80, np.random.default_rng(5), velocity=-0.5), []
    poses = {0: coarse_flight.pose(0)} | {k: coarse_flight.pose(k, part) for k in range(FRAME, 80, FRAME)}
    fine_flight = Flight(fine, 0, np.random.default_rng(5))
    fine_flight.imu = [sample for sample in coarse_flight.imu for _ in range(4)][3:]
    moved = {k: pose.copy() for k, pose in poses.items()}
    for k, pose in moved.items():
        pose.t_s = k * 0.02
    for own, flight, given, scale in (
        (params, coarse_flight, poses, 1),
        (fine, fine_flight, {round(pose.t_s / quarter): pose for pose in poses.values()}, 4),
        (params, coarse_flight, moved, 1),
    ):
        filters = arrive(own, flight, given, lambda k, scale=scale: scale).state.filters
        found.append(np.concatenate([filters.pkf.x[:6], quat.to_matrix(filters.akf.x[:4]).ravel()]))
    exact, ignored = np.abs(found[0] - found[1]), np.abs(found[2] - found[1])
    for group in (slice(0, 3), slice(6, 15)):
        assert exact[group].max() < 0.01 * ignored[group].max()
    assert ignored[:3].max() > abs(part) * 0.02 * 0.4


def test_wild_attitude_is_kept_out_whole_and_wild_position_out_of_the_position(
    params: np.record, rng: np.random.Generator
) -> None:
    flight = Flight(params, 40, rng)
    poses = {0: [flight.pose(0)], 8: [flight.pose(8)], 24: [flight.pose(24)]}
    wild = {13: [flight.pose(13, off_rad=0.02)], 20: [flight.pose(15, off_rad=-0.02, off_m=0.3)]}
    run, without = Run(params, flight), Run(params, flight)
    for k in range(30):
        without.step(*poses.get(k, []))
        run.step(*poses.get(k, []), *wild.get(k, []))
        np.testing.assert_array_equal(run.known(), without.known())
        if k in wild:
            assert run.state.nis_attitude > params.akf.gate
            assert math.isnan(run.state.nis_position)
    assert run.counts() == (2, 0, 2, 0, 0)
    run.step(flight.pose(30, off_m=0.3))
    without.step()
    assert run.counts() == (2, 1, 2, 0, 0)
    assert run.state.nis_position > params.pkf.gate
    a, b = run.state.filters, without.state.filters
    np.testing.assert_array_equal(a.pkf.x, b.pkf.x)
    np.testing.assert_array_equal(a.p[:9, :9], b.p[:9, :9])
    assert np.trace(a.p[9:12, 9:12]) < np.trace(b.p[9:12, 9:12])


def advance(run: Run, flight: Flight, frames: range, **wrong: float) -> None:
    """Continue to each frame in turn with its pose, wrong by ``wrong``."""
    for n in frames:
        run.steps(FRAME * n - run.state.cycle)
        run.step(flight.pose(FRAME * n, **wrong))


@pytest.mark.parametrize("wrong", [{"off_m": 0.5}, {"off_rad": 0.05}, {"off_m": 0.5, "off_rad": 0.05}])
def test_start_that_no_pose_confirms_is_replaced_by_poses_that_agree(
    params: np.record, rng: np.random.Generator, wrong: dict[str, float]
) -> None:
    flight = Flight(params, 200, rng)
    run = Run(params, flight)
    run.step(flight.pose(0, **wrong))  # the start is wrong, and what follows is right
    advance(run, flight, range(1, 2))
    assert (run.state.accepted, run.state.rejected_in_a_row, run.state.unconfirmed) == (0, 1, 1)
    advance(run, flight, range(2, 3))
    assert (run.state.accepted, run.state.rejected_in_a_row, run.state.unconfirmed) == (1, 0, 0)
    assert np.abs(flight.x[FRAME * 2][:3] - run.state.filters.pkf.x[:3]).max() < 0.05
    assert run.state.filters.p[0, 0] > 0.5 * SIGMA_M**2


def test_restart_stays_when_an_older_pose_comes(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, 200, rng)
    run, older = Run(params, flight), flight.pose(FRAME * 8 + 4)
    run.step(flight.pose(0, off_m=0.5))
    advance(run, flight, range(1, 10))
    run.step(older)
    off = flight.x[FRAME * 9 + 1][:3] - run.state.filters.pkf.x[:3]
    assert np.abs(off).max() < 0.05


def test_poses_that_agree_with_each_other_alone_are_kept_out(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, 1200, rng)
    run = Run(params, flight)
    advance(run, flight, range(30))
    accepted = run.state.accepted
    advance(run, flight, range(30, 100), off_m=0.3)
    assert run.state.accepted == accepted
    assert run.state.rejected_in_a_row == 70
    assert run.state.mutual > params.reopen_after
    assert np.abs(flight.x[FRAME * 99][:3] - run.state.filters.pkf.x[:3]).max() < 0.1


def test_closed_gate_opens_for_as_many_poses_as_agree_with_the_carry_over(
    params: np.record, rng: np.random.Generator
) -> None:
    flight = Flight(params, 1200, rng)
    run = Run(params, flight)
    advance(run, flight, range(30))
    accepted = run.state.accepted
    advance(run, flight, range(30, 40), off_m=0.3)
    advance(run, flight, range(40, 40 + params.reopen_after))  # the first one is the jump back
    assert run.state.accepted == accepted
    position = run.state.filters.p[0, 0]
    run.steps(FRAME - 1)
    run.step(flight.pose(FRAME * (40 + params.reopen_after), off_m=0.02))
    assert (run.state.accepted, run.state.rejected_in_a_row) == (accepted + 1, 0)
    assert run.state.jump_m.max() > 0.005  # of the last pose, a possible error from now on
    assert run.state.filters.p[0, 0] < position + run.state.jump_m[0] ** 2


def test_pose_whose_covariance_makes_the_innovation_s_no_covariance_is_kept_out(
    params: np.record, rng: np.random.Generator
) -> None:
    flight = Flight(params, 60, rng)
    run = Run(params, flight)
    run.step(flight.pose(0))
    for n, part in enumerate(("covariance_attitude", "covariance_position"), start=1):
        run.steps(FRAME * n - run.state.cycle)
        pose = flight.pose(FRAME * n)
        pose[part] = -np.eye(3)
        run.step(pose)
    assert run.state.accepted == 0
    assert run.state.rejected_in_a_row == 2
    assert np.isfinite(run.known()).all()


def test_accepted_pose_restarts_the_count_of_rejections(params: np.record, rng: np.random.Generator) -> None:
    flight = Flight(params, 200, rng)
    run = Run(params, flight)
    run.step(flight.pose(0))
    for n in range(1, 21):
        run.steps(FRAME - 1)
        run.step(flight.pose(FRAME * n, off_m=0.0 if n == 1 or n % 7 == 0 else 0.5))
    assert run.counts() == (3, 17, 0, 0, 0)
