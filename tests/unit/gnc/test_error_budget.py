"""Filters with an error budget: against a dense filter whose derivatives are taken from the error models themselves."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from hil.checks.compatibility import check_budget
from hil.config.load import load_rig, load_scenario
from hil.core.messages import IMU, POSE, Array, new
from hil.errors import BadInput
from hil.gnc.estimation import fusion
from hil.gnc.estimation.error_state import FILTER_ERRORS
from hil.gnc.estimation.step_memory import STEP, memory_steps, new_memory
from hil.gnc.estimation.thrust_model import MEASURED, QUIET
from hil.maths import quat
from hil.params import gnc as gnc_params
from hil.sensors.mounting import camera_pose, chaser_pose
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.errors import VISION_ERRORS, distort
from tests.support.plain_filters import PLAIN, THRUST_OFF, WITHOUT_BUDGET
from tests.support.run_settings import make_job

KEY = "gnc.navigation.budget"
ALL = (
    "vision_bias_sigma_m=[0.002, 0.0005, 0.001]",
    "vision_misalignment_sigma_deg=0.05",
    "vision_scale_sigma=0.002",
    "vision_correlated_fraction=0.3",
    "vision_correlation_time_s=4.0",
    "bench_sigma_m=0.0005",
    "bench_sigma_deg=0.002",
    "gyro_scale_sigma=0.01",
    "gyro_misalignment_sigma_deg=0.5",
    "gyro_instability_degps=1e-4",
    "gyro_instability_time_s=20.0",
    "accelerometer_scale_sigma=0.02",
    "accelerometer_misalignment_sigma_deg=1.0",
    "accelerometer_instability_mps2=2e-4",
    "accelerometer_instability_time_s=30.0",
)
STATES = {"r": 3, "v": 3, "bias": 3, "turn": 3, "drift": 3}
PARAMETERS = {
    "misalignment": 3, "vision_bias": 3, "scale": 1, "correlated": 6, "gyro_scale": 3, "gyro_misalignment": 3,
    "gyro_instability": 3, "accelerometer_scale": 3, "accelerometer_misalignment": 3, "accelerometer_instability": 3,
}  # fmt: skip
SIZES = STATES | PARAMETERS
EDGES = np.cumsum([0, *SIZES.values()])
AT = {name: slice(first, last) for name, (first, last) in zip(SIZES, pairwise(EDGES), strict=True)}
N = int(EDGES[-1])
MOVING = ("correlated", "gyro_instability", "accelerometer_instability")
ESTIMATED = ("misalignment", "vision_bias", "scale", *MOVING)


def fusion_params(*settings: str) -> np.record:
    """Return FUSION_PARAMS of scheme 1 with a budget, without commanded thrust."""
    given = (*PLAIN, *(f"{KEY}.{text}" for text in settings))
    return gnc_params.navigation(load_scenario("scheme-1", given).value).fusion


def rotation(q: Array) -> Rotation:
    """Return the rotation of vectors that A(q) is."""
    return Rotation.from_matrix(quat.to_matrix(q))


def gain_of(scale: Array, misalignment: Array) -> Array:
    """Return a sensor's scaled and misaligned axes against c, less the unit matrix, as in the error model."""
    axes = quat.to_matrix(quat.from_rotation_vector(misalignment))
    return np.diag(1.0 + scale) @ axes - np.eye(3)


class Reference:
    """Dense filter of all errors: numerical derivatives, Joseph's form, gains of the rows that are corrected."""

    def __init__(self, params: np.record, sigmas: dict[str, Array], times_s: dict[str, float]) -> None:
        self.params, self.budget, self.dt = params, params.errors, float(params.pkf.dt_s)
        self.mounting = vmu_params.mounting(load_rig("mock").value)
        self.sigma = np.concatenate([sigmas[name] for name in PARAMETERS])
        self.kept = np.ones(N)
        for name in MOVING:
            self.kept[AT[name]] = math.exp(-self.dt / times_s[name])

    def reading(self, q: Array, r: Array, e: Array) -> tuple[Array, Array]:
        """Return measured ``z`` and attitude of a pose at ``r`` and ``q`` with systematic errors ``e`` (N,)."""
        errors, pose, t_v, q_vt = new(VISION_ERRORS), new(POSE), np.empty(3), np.empty(4)
        to_v = quat.to_matrix(self.mounting.q_vc)
        errors.q_misaligned = quat.from_rotation_vector(-to_v @ e[AT["misalignment"]])
        errors.bias, errors.scale_error = to_v @ e[AT["vision_bias"]], e[AT["scale"]][0]
        camera_pose(self.mounting, r, q, t_v, q_vt)
        distort(errors, 0, t_v, q_vt)
        chaser_pose(self.mounting, t_v, q_vt, np.zeros((6, 6)), pose)
        return pose.z_TC_C.copy(), pose.q_CH.copy()

    def innovation(
        self, e: Array, q: Array, r: Array, roots: tuple[Array, Array], frozen: tuple[Array, Array]
    ) -> Array:
        """Return rotation and position (6,) by which a reading with errors ``e`` is off that of the estimate ``q, r``.

        frozen: estimate of ``q`` and ``r`` against which the rotation is measured.
        """
        true_q = quat.multiply(quat.from_rotation_vector(e[AT["turn"]]), q)
        z, measured = self.reading(true_q, r + e[AT["r"]], e)
        turned, g = np.empty(3), e[AT["correlated"]]
        quat.rotation_between(measured, frozen[0], turned)
        return np.concatenate([turned + roots[1] @ g[3:], z + quat.to_matrix(q) @ frozen[1] + roots[0] @ g[:3]])

    def roots(self, pose: np.record) -> tuple[Array, Array]:
        """Return roots of the correlated parts of a pose's covariances."""
        f, bench = float(self.budget.fraction), self.budget.bench_variance
        given = (pose.covariance_position, pose.covariance_attitude)
        return tuple(
            np.linalg.cholesky(f * (c - b * np.eye(3)) + b * np.eye(3)) for c, b in zip(given, bench, strict=True)
        )

    def white(self, pose: np.record) -> tuple[Array, Array]:
        """Return the white parts of a pose's covariances."""
        f, bench = float(self.budget.fraction), self.budget.bench_variance
        given = (pose.covariance_position, pose.covariance_attitude)
        return tuple((1.0 - f) * (c - b * np.eye(3)) for c, b in zip(given, bench, strict=True))

    def sensitivity(self, pose: np.record) -> Array:
        """Return the derivative (6, N) of ``innovation`` by central differences."""
        here = (self.q, self.x[AT["r"]])
        steps = np.concatenate([np.full(FILTER_ERRORS, 1e-5), np.full(N - FILTER_ERRORS, 1e-5)])
        columns = []
        for step in np.diag(steps):
            up, down = (self.innovation(sign * step, *here, self.roots(pose), here) for sign in (1.0, -1.0))
            columns.append((up - down) / (2.0 * step.max()))
        return np.array(columns).T

    def start(self, pose: np.record) -> None:
        """Start from a pose: its errors and those of the parameters are the start's."""
        self.q, self.x = pose.q_CH.copy(), np.zeros(N)
        self.x[AT["r"]] = -quat.to_matrix(pose.q_CH).T @ pose.z_TC_C
        self.x[AT["bias"]], self.x[AT["drift"]] = self.params.pkf.initial_bias, self.params.akf.initial_drift
        h = self.sensitivity(pose)
        states = np.r_[AT["turn"], AT["r"]]
        white_z, white_a = self.white(pose)
        noise = np.hstack([h[:, FILTER_ERRORS:], np.eye(6)])
        response = np.zeros((N, N - FILTER_ERRORS + 6))
        # innovation of the start is 0: h_states states + noise = 0
        response[states] = -np.linalg.solve(h[:, states], noise)
        response[FILTER_ERRORS:, : N - FILTER_ERRORS] = np.eye(N - FILTER_ERRORS)
        for total, part in (("bias", "accelerometer_instability"), ("drift", "gyro_instability")):
            for i in range(3):
                response[AT[total].start + i, AT[part].start - FILTER_ERRORS + i] = 1.0
        self.p = response @ block_diag(np.diag(self.sigma**2), white_a, white_z) @ response.T
        own = np.zeros(N)
        own[AT["v"]] = self.params.pkf.initial_velocity_sigma**2
        own[AT["bias"]] = self.params.pkf.initial_bias_sigma**2
        own[AT["drift"]] = self.params.akf.initial_drift_sigma**2
        self.p += np.diag(own)
        self.p[AT["drift"], AT["drift"]] += self.in_c(self.params.akf.rate_sigma)

    def in_c(self, sigma: Array) -> Array:
        """Return the covariance (3, 3) in c of errors with standard deviations ``sigma`` (3,) in H."""
        a = quat.to_matrix(self.q)
        return a @ np.diag(sigma**2) @ a.T

    def moved(self, imu: np.record, e: Array) -> tuple[Array, Array]:
        """Return true attitude and states (N,) after a step, if the errors before it are ``e``."""
        x = self.x + e
        w = imu.rate_C - x[AT["drift"]]
        w -= gain_of(x[AT["gyro_scale"]], x[AT["gyro_misalignment"]]) @ w
        f = imu.force_C - x[AT["bias"]]
        f -= gain_of(x[AT["accelerometer_scale"]], x[AT["accelerometer_misalignment"]]) @ f
        hill = quat.from_rotation_vector(np.array([0.0, self.params.orbit.mean_motion * self.dt, 0.0]))
        before = quat.multiply(quat.from_rotation_vector(e[AT["turn"]]), self.q)
        after = quat.multiply(quat.from_rotation_vector(w * self.dt), quat.multiply(before, hill))
        still = quat.multiply(
            quat.from_rotation_vector((imu.rate_C - self.x[AT["drift"]]) * self.dt), quat.multiply(self.q, hill)
        )
        middle = self.q + still
        middle = quat.multiply(quat.from_rotation_vector(e[AT["turn"]]), middle / np.linalg.norm(middle))
        out = self.kept * x
        motion = self.params.pkf
        out[:6] = motion.hill_transition @ x[:6] + motion.hill_response @ quat.to_matrix(middle).T @ f
        for total, part in (("bias", "accelerometer_instability"), ("drift", "gyro_instability")):
            out[AT[total]] += (self.kept[AT[part]] - 1.0) * x[AT[part]]
        return after, out

    def predict(self, imu: np.record) -> None:
        """Carry estimate and covariance over a step."""
        q, x = self.moved(imu, np.zeros(N))
        columns = []
        for step in 1e-5 * np.eye(N):
            ends = []
            for sign in (1.0, -1.0):
                after, out = self.moved(imu, sign * step)
                out[AT["turn"]] = (rotation(after) * rotation(q).inv()).inv().as_rotvec()
                ends.append(out)
            columns.append((ends[0] - ends[1]) / 2e-5)
        phi = np.array(columns).T
        noise = np.zeros((N, N))
        g = np.vstack([self.params.pkf.hill_response, np.zeros((N - 6, 3))])
        noise += self.params.pkf.sigma_accelerometer**2 * g @ g.T
        fresh = np.concatenate([np.zeros(FILTER_ERRORS), self.sigma**2]) * (1.0 - self.kept**2)
        into = np.eye(N)
        for total, part in (("bias", "accelerometer_instability"), ("drift", "gyro_instability")):
            for i in range(3):
                into[AT[total].start + i, AT[part].start + i] = 1.0
        noise += into @ np.diag(fresh) @ into.T
        akf, pkf = self.params.akf, self.params.pkf
        for name, sigma in (("turn", akf.sigma_gyro), ("drift", akf.sigma_drift), ("bias", pkf.sigma_bias)):
            noise[AT[name], AT[name]] += (self.dt * sigma) ** 2 * np.eye(3)
        self.q, self.x = q, x
        noise[AT["drift"], AT["drift"]] += self.dt**2 * self.in_c(akf.rate_noise)
        self.p = phi @ self.p @ phi.T + noise

    def update(self, pose: np.record) -> tuple[float, float]:
        """Fuse a pose, attitude first; return the NIS of position and attitude."""
        white_z, white_a = self.white(pose)
        attitude = self._update(pose, slice(0, 3), white_a, ("turn", "drift"))
        return self._update(pose, slice(3, 6), white_z, ("r", "v", "bias")), attitude

    def _update(self, pose: np.record, part: slice, white: Array, corrected: tuple[str, ...]) -> float:
        h = self.sensitivity(pose)[part]
        rows = np.concatenate([np.arange(N)[AT[name]] for name in (*corrected, *ESTIMATED)])
        turned = np.empty(3)
        quat.rotation_between(pose.q_CH, self.q, turned)
        measured = np.concatenate([turned, pose.z_TC_C + quat.to_matrix(self.q) @ self.x[AT["r"]]])
        innovation = measured[part] - h[:, FILTER_ERRORS:] @ self.x[FILTER_ERRORS:]
        s = h @ self.p @ h.T + white
        k = np.zeros((N, 3))
        k[rows] = (self.p @ h.T @ np.linalg.inv(s))[rows]
        keep = np.eye(N) - k @ h
        self.p = keep @ self.p @ keep.T + k @ white @ k.T
        dx = k @ innovation
        self.q = quat.multiply(quat.from_rotation_vector(dx[AT["turn"]]), self.q)
        self.x += dx
        self.x[AT["turn"]] = 0.0
        return float(innovation @ np.linalg.solve(s, innovation))


def own_errors(params: np.record) -> tuple[dict[str, Array], dict[str, float]]:
    """Return the sigmas of ``ALL`` by parameter, and the correlation times, by hand."""
    deg, one = math.radians, np.ones(3)
    return {
        "misalignment": deg(0.05) * one,
        "vision_bias": np.array([0.002, 0.0005, 0.001]),
        "scale": np.array([0.002]),
        "correlated": np.ones(6),
        "gyro_scale": 0.01 * one,
        "gyro_misalignment": deg(0.5) * one,
        "gyro_instability": deg(1e-4) * one,
        "accelerometer_scale": 0.02 * one,
        "accelerometer_misalignment": deg(1.0) * one,
        "accelerometer_instability": 2e-4 * one,
    }, {"correlated": 4.0, "gyro_instability": 20.0, "accelerometer_instability": 30.0}


def noisy_pose(q: Array, r: Array, t_s: float, rng: np.random.Generator) -> np.record:
    pose = new(POSE)
    pose.t_s, pose.fresh = t_s, 1
    pose.q_CH = quat.multiply(quat.from_rotation_vector(5e-4 * rng.standard_normal(3)), q)
    pose.z_TC_C = 0.005 * rng.standard_normal(3) - quat.transform(q, r)
    root = np.array([[1.0, 0.0, 0.0], [0.3, 0.8, 0.0], [-0.2, 0.1, 1.2]])
    pose.covariance_position = 0.005**2 * root @ root.T
    pose.covariance_attitude = 5e-4**2 * root.T @ root
    return pose


def test_filters_stay_equal_to_a_dense_filter_with_the_derivatives_of_the_error_models(
    rng: np.random.Generator,
) -> None:
    params = fusion_params(*ALL)
    reference = Reference(params, *own_errors(params))
    assert params.errors.n == N
    state, memory, imu = new(fusion.FUSION_STATE), new_memory(params), new(IMU)
    q, r = quat.from_rotation_vector(np.array([0.1, -0.05, 0.08])), np.array([3.0, -0.2, 0.3])
    for cycle in range(41):
        imu.rate_C, imu.force_C = 0.05 * rng.standard_normal(3), 0.02 * rng.standard_normal(3)
        fusion.advance(params, state, memory, imu)
        if cycle:
            reference.predict(imu)
        if cycle % 8 == 0:
            pose = noisy_pose(q if cycle == 0 else reference.q, r if cycle == 0 else reference.x[:3], 0.02 * cycle, rng)
            fusion.fuse(params, state, memory, pose)
            if cycle == 0:
                reference.start(pose)
            else:
                nis = reference.update(pose)
                assert (state.nis_position, state.nis_attitude) == pytest.approx(nis, rel=1e-5)
        state.cycle += 1
        scale = np.sqrt(np.diag(reference.p))
        error = (state.filters.p[:N, :N] - reference.p) / np.outer(scale, scale)
        assert np.abs(error).max() < 1e-5
        states = np.concatenate([state.filters.pkf.x, state.filters.parameters[FILTER_ERRORS:N]])
        known = np.concatenate([reference.x[:9], reference.x[FILTER_ERRORS:]])
        of = np.concatenate([scale[:9], scale[FILTER_ERRORS:]])
        assert np.abs((states - known) / of).max() < 1e-5
        off = (rotation(state.filters.akf.x[:4].copy()) * rotation(reference.q).inv()).magnitude()
        assert off < 1e-5 * scale[AT["turn"]].min()
    assert state.accepted == 5
    np.testing.assert_array_equal(state.filters.p[:N, :N], state.filters.p[:N, :N].T)
    assert not np.any(state.filters.p[:, N:])


class Flight:
    """Chaser at rest without force or rate: the same samples in each step, poses with noise of a given size."""

    def __init__(self, params: np.record) -> None:
        self.params, self.state, self.memory = params, new(fusion.FUSION_STATE), new_memory(params)
        self.q, self.r = np.array([0.0, 0.0, 0.0, 1.0]), np.array([3.0, -0.2, 0.3])
        self.imu = new(IMU)
        self.imu.rate_C = self.params.akf.initial_drift - np.array([0.0, params.orbit.mean_motion, 0.0])

    def pose(self, cycle: int, rng: np.random.Generator, factor: float = 1.0) -> np.record:
        """Return the pose of ``cycle`` with ``factor`` times the reported noise."""
        pose, noise = new(POSE), rng.standard_normal(6)
        pose.t_s, pose.fresh = 0.02 * cycle, 1
        pose.q_CH = quat.multiply(quat.from_rotation_vector(factor * 5e-4 * noise[:3]), self.q)
        pose.z_TC_C = factor * 0.005 * noise[3:] - quat.transform(self.q, self.r)
        pose.covariance_position, pose.covariance_attitude = 0.005**2 * np.eye(3), 5e-4**2 * np.eye(3)
        return pose

    def step(self, *poses: np.record) -> None:
        fusion.advance(self.params, self.state, self.memory, self.imu)
        for pose in poses:
            fusion.fuse(self.params, self.state, self.memory, pose)
        self.state.cycle += 1


def test_late_pose_gives_what_the_pose_in_time_has_led_to(rng: np.random.Generator) -> None:
    params = fusion_params(*ALL)
    in_time, late = Flight(params), Flight(params)
    poses = {cycle: in_time.pose(cycle, rng) for cycle in range(0, 48, 8)}
    for cycle in range(48):
        in_time.step(*[pose for exposure, pose in poses.items() if exposure == cycle])
        late.step(*[pose for exposure, pose in poses.items() if exposure + (5 if exposure else 0) == cycle])
    assert late.state.accepted == in_time.state.accepted == 5
    np.testing.assert_array_equal(late.state.filters.p, in_time.state.filters.p)
    np.testing.assert_array_equal(late.state.filters.pkf.x, in_time.state.filters.pkf.x)
    np.testing.assert_array_equal(late.state.filters.akf.x, in_time.state.filters.akf.x)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_size_of_the_noise_is_found_from_the_innovations(rng: np.random.Generator, factor: float) -> None:
    flight = Flight(fusion_params("vision_noise_scale_sigma=0.4"))
    for cycle in range(8 * 400):
        flight.step(*([flight.pose(cycle, rng, factor)] if cycle % 8 == 0 else []))
    # 3.3 standard deviations of the estimate over the window of 256 poses
    found = np.exp(0.5 * flight.state.noise.log)
    np.testing.assert_allclose(found, factor, rtol=3.3 * 0.5 * math.sqrt(2.0 / (3.0 * 256.0)) + 0.02)


def test_noise_is_never_taken_as_less_than_the_budget_leaves_possible(rng: np.random.Generator) -> None:
    """Quiet poses may follow a bench whose slow error is larger than their noise: three sigmas below, and no less."""
    flight = Flight(fusion_params("vision_noise_scale_sigma=0.2"))
    for cycle in range(8 * 100):
        flight.step(*([flight.pose(cycle, rng, 0.1)] if cycle % 8 == 0 else []))
    np.testing.assert_allclose(np.exp(0.5 * flight.state.noise.log), math.exp(-3.0 * 0.2))


def test_gain_of_the_attitude_is_of_the_noise_about_each_axis(rng: np.random.Generator) -> None:
    flight = Flight(fusion_params())
    for cycle in range(8 * 4 + 1):
        pose = flight.pose(cycle, rng, 0.01)
        pose.covariance_attitude = np.diag([5e-6, 5e-4, 5e-4]) ** 2  # roll a hundred times better than tilt
        flight.step(*([pose] if cycle % 8 == 0 else []))
    state = flight.state
    sigmas, gain = np.sqrt(np.diag(state.found_attitude.s)), state.found_attitude.gain[:, AT["turn"]]
    moved = np.sqrt((sigmas**2) @ gain**2)  # of each component, by innovations of one sigma
    assert state.gain_attitude * state.noise_rad == pytest.approx(moved.max())
    assert state.gain_attitude * state.noise_rad < 0.8 * np.abs(gain).max() * sigmas.max()


def test_memory_holds_the_errors_that_are_used_and_no_more() -> None:
    """A triangle of blocks of eight columns: of 2 blocks for 15 errors, of 6 for 46."""
    sizes = [new_memory(params).nbytes // int(params.memory) for params in (fusion_params(), fusion_params(*ALL))]
    assert sizes == [STEP.itemsize + 8 * (16 + 64 * 3), STEP.itemsize + 8 * (48 + 64 * 21)]


def test_memory_keeps_kind_thrust_and_torque_of_each_step_s_commands() -> None:
    flight = Flight(gnc_params.navigation(load_scenario("scheme-1").value).fusion)
    flight.params.thrust.minimum_on_s, flight.params.thrust.settle = 0.0, 1
    for command in ([1, 0], [0, 1], [1, 1], [0, 0], [0, 0], [0, 0]):
        flight.state.commanded[:2] = command
        flight.step()
    steps, given = memory_steps(flight.params, flight.memory)[:6], flight.params.thrust
    for name, of in (("thrust_C", given.force), ("torque_C", given.torque)):
        expected = [of[0], of[1], of[0] + of[1], np.zeros(3), np.zeros(3), np.zeros(3)]
        np.testing.assert_allclose(steps[name], expected, atol=1e-15)
        assert np.linalg.norm(of[:2], axis=1).min() > 0.0
    assert steps["kind"].tolist() == [MEASURED] * 4 + [QUIET] * 2


def test_parameters_without_a_spread_are_left_out() -> None:
    assert fusion_params().errors.n == FILTER_ERRORS
    params = fusion_params("vision_scale_sigma=0.01", "gyro_instability_degps=1e-6")
    assert (params.errors.n, params.errors.scale, params.errors.gyro_instability) == (19, 15, 16)
    assert params.errors.misalignment == params.errors.correlated == 0


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("gnc.shadow.enabled=true",), r"neither error budget nor .* gnc\.navigation\.thrust\.enabled = false"),
        ((f"{KEY}.vision_correlated_fraction=1.0",), "vision_correlated_fraction"),
        ((f"{KEY}.gyro_scale_sigma=-0.1",), "gyro_scale_sigma"),
        ((f"{KEY}.vision_bias_sigma_m=[0.1, 0.1]",), "vision_bias_sigma_m"),
        ((f"{KEY}.vision_bais_sigma_m=[0.1, 0.1, 0.1]",), "vision_bais_sigma_m"),
    ],
)
def test_budget_that_the_filters_cannot_have_is_rejected(settings: tuple[str, ...], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        load_scenario("scheme-1", (*PLAIN, f"{KEY}.vision_scale_sigma=0.01", *settings))


def test_shadow_filter_goes_with_the_plain_filters_alone() -> None:
    shadow = "gnc.shadow.enabled=true"
    plain = load_scenario("scheme-1", (*PLAIN, shadow)).value.gnc
    assert (plain.shadow.enabled, plain.navigation.budget.is_empty, plain.navigation.thrust.enabled) == (1, 1, 0)
    for settings in ((), WITHOUT_BUDGET, (THRUST_OFF,)):
        with pytest.raises(BadInput, match=r"neither error budget nor commanded thrust") as caught:
            load_scenario("scheme-1", (*settings, shadow))
        assert len(str(caught.value).splitlines()) == 1


def test_budget_for_another_camera_than_the_rig_s_is_rejected() -> None:
    settings = (f"{KEY}.vision_scale_sigma=0.01", f"{KEY}.camera_position_m=[0.5, 0.0, 0.0]")
    job = make_job(1.0, settings)
    (problem,) = check_budget(job.scenario, job.rig)
    assert problem.key == f"{KEY}.camera_position_m"
    assert "[0.6, 0.0, 0.0]" in problem.message
    right = make_job(1.0, settings[:1])
    assert check_budget(right.scenario, right.rig) == []
