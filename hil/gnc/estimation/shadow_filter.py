"""Shadow filter: independent filters of filterpy on the same inputs, to detect a divergence of the compiled ones.

Their process models are written out from bench paper eq. (6) and (14) and integrated by matrix exponentials. They run
``lag`` steps behind, so that late poses have come by then, and are compared with the compiled filters' memory of the
same moment.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from hil.core.messages import Array
from hil.gnc.estimation.step_memory import memory_steps
from hil.gnc.estimation.target_orbit import HILL_STEP

_LAG_FRACTION: Final = 0.625  # of the compiled filters' memory


@dataclass(slots=True)
class _Inputs:
    rate_C: Array
    force_C: Array
    poses: list[np.record]


@dataclass(frozen=True, slots=True)
class Divergence:
    """Difference between shadow filter and compiled filters at a moment: position, m, and angle, rad."""

    position: float
    angle: float


class ShadowFilter:
    """filterpy's KalmanFilter and ExtendedKalmanFilter behind ``step``.

    params: FUSION_PARAMS of the compiled filters, whose noise levels and orbit are used.
    """

    def __init__(self, params: np.record) -> None:
        self._akf_params = params.akf
        self._pkf_params = params.pkf
        self._dt = float(params.pkf.dt_s)
        self.lag = int(_LAG_FRACTION * params.memory)
        """Steps behind the loop."""
        self._params = params
        self._inputs: deque[_Inputs] = deque(maxlen=self.lag + 1)
        self._mean_motion = float(params.orbit.mean_motion)
        self._on_circle = self._step_in_h(np.zeros(1, HILL_STEP)[0])
        self._position: KalmanFilter | None = None
        self._attitude: ExtendedKalmanFilter | None = None

    def step(self, cycle: int, samples: np.ndarray, poses: np.ndarray, memory: np.ndarray) -> Divergence | None:
        """Use the inputs of ``cycle``; return the divergence ``lag`` steps ago, None before the start.

        samples: of IMU since the cycle before, each of one step; the first cycle has the last one alone. poses: of
        POSE, the new ones only. memory: of ``step_memory.new_memory``, the compiled filters'.
        """
        steps = memory_steps(self._params, memory)
        last = cycle * len(samples)
        divergence = None
        for behind in reversed(range(len(samples) if cycle else 1)):
            imu = samples[-1 - behind]
            self._inputs.append(_Inputs(imu["rate_C"].copy(), imu["force_C"].copy(), []))
            if behind == 0:
                self._place(last, poses)
            if len(self._inputs) > self.lag:
                step = last - behind - self.lag
                divergence = self._advance(self._inputs[0], steps[step % len(steps)]) or divergence
        return divergence

    def _step_in_h(self, hill: np.void) -> Array:
        """Return the transition (9, 9) of [r, v, acceleration] in H over a step, ``hill`` of HILL_STEP (Van Loan)."""
        n = self._mean_motion
        whole = np.zeros((9, 9))
        whole[:3, 3:6] = whole[3:6, 6:] = np.eye(3)
        whole[3:6, :3] = np.diag([hill["along"], hill["across"] - n**2, hill["down"] + 3.0 * n**2])
        whole[3, 2], whole[5, 0] = hill["euler"], -hill["euler"]
        whole[3, 5], whole[5, 3] = 2.0 * n + hill["coriolis"], -2.0 * n - hill["coriolis"]
        return np.asarray(expm(whole * self._dt))

    def _place(self, last: int, poses: np.ndarray) -> None:
        """Put each pose into the step nearest to its exposure; ``last``: number of the newest step."""
        for pose in poses:
            behind = last - round(pose.t_s / self._dt)
            if 0 <= behind < len(self._inputs):
                inputs = self._inputs[-1 - behind]
                if all(abs(earlier.t_s - pose.t_s) > 1e-6 for earlier in inputs.poses):
                    inputs.poses.append(pose.copy())

    def _advance(self, inputs: _Inputs, compiled: np.void) -> Divergence | None:
        divergence = None
        if self._position is None or self._attitude is None:
            if inputs.poses:
                self._start(inputs.poses[0])
            return None
        self._predict(inputs, compiled["hill"])
        if compiled["is_start"] == 0:
            divergence = self._compare(compiled)
        for pose in inputs.poses:
            self._update(pose)
        return divergence

    def _start(self, pose: np.record) -> None:
        p, a = self._pkf_params, self._akf_params
        to_c = _matrix(pose.q_CH)
        self._attitude = ExtendedKalmanFilter(dim_x=7, dim_z=3)
        self._attitude.x = np.concatenate([pose.q_CH, a.initial_drift])
        xi = _xi(pose.q_CH)
        self._attitude.P = np.zeros((7, 7))
        self._attitude.P[:4, :4] = 0.25 * xi @ pose.covariance_attitude @ xi.T
        self._attitude.P[4:, 4:] = a.initial_drift_sigma**2 * np.eye(3) + to_c @ np.diag(a.rate_sigma**2) @ to_c.T
        self._position = KalmanFilter(dim_x=9, dim_z=3, dim_u=3)
        self._position.x = np.concatenate([-to_c.T @ pose.z_TC_C, np.zeros(3), p.initial_bias])
        spread = _cross(pose.z_TC_C) @ pose.covariance_attitude @ _cross(pose.z_TC_C).T
        self._position.P = np.zeros((9, 9))
        self._position.P[:3, :3] = to_c.T @ (pose.covariance_position + spread) @ to_c
        self._position.P[3:6, 3:6] = p.initial_velocity_sigma**2 * np.eye(3)
        self._position.P[6:, 6:] = p.initial_bias_sigma**2 * np.eye(3)

    def _predict(self, inputs: _Inputs, hill: np.void) -> None:
        assert self._attitude is not None
        assert self._position is not None
        ekf, kf, dt = self._attitude, self._position, self._dt
        of_hill = np.array([0.0, -hill["turn"], hill["rotation"][2] if hill["swings"] else 0.0]) / dt
        attitude = ekf.x[:4].copy()
        # eq. (3): dQ/dt = Omega(w) Q / 2, the rate of H on the other side
        rate = inputs.rate_C - ekf.x[4:]
        process = np.zeros((7, 7))
        process[:4, :4] = 0.5 * (_omega(rate) + _HANDED * _omega(of_hill))
        process[:4, 4:] = -0.5 * _xi(attitude)
        transition = _exponential(process * dt)
        q = _exponential(process[:4, :4] * dt) @ attitude
        q /= np.linalg.norm(q)
        spread = 0.5 * dt * _xi(q)
        noise = np.zeros((7, 7))
        noise[:4, :4] = self._akf_params.sigma_gyro**2 * spread @ spread.T
        a, to_c = self._akf_params, _matrix(q)
        noise[4:, 4:] = dt**2 * (a.sigma_drift**2 * np.eye(3) + to_c @ np.diag(a.rate_noise**2) @ to_c.T)
        ekf.x = np.concatenate([q, ekf.x[4:]])
        ekf.P = transition @ ekf.P @ transition.T + noise
        middle = attitude + q
        to_h = _matrix(middle / np.linalg.norm(middle)).T
        # eq. (14): a force in c, and minus a bias in c, act through the response to an acceleration in H
        step_in_h = self._step_in_h(hill) if hill["is_elliptic"] else self._on_circle
        response = step_in_h[:6, 6:] @ to_h
        kf.F, kf.B = np.eye(9), np.zeros((9, 3))
        kf.F[:6, :6], kf.F[:6, 6:], kf.B[:6] = step_in_h[:6, :6], -response, response
        kf.Q = self._pkf_params.sigma_accelerometer**2 * kf.B @ kf.B.T
        kf.Q[6:, 6:] += (dt * self._pkf_params.sigma_bias) ** 2 * np.eye(3)
        kf.predict(u=inputs.force_C)

    def _update(self, pose: np.record) -> None:
        assert self._attitude is not None
        assert self._position is not None
        measured = _angles(pose.q_CH)
        e = _angle_jacobian(pose.q_CH) @ (0.5 * _xi(pose.q_CH))
        self._attitude.update(
            measured,
            lambda x: np.hstack([_angle_jacobian(x[:4]), np.zeros((3, 3))]),
            lambda x: _angles(x[:4]),
            R=e @ pose.covariance_attitude @ e.T,
            residual=lambda a, b: (a - b + np.pi) % (2.0 * np.pi) - np.pi,
        )
        self._attitude.x[:4] /= np.linalg.norm(self._attitude.x[:4])
        q = self._attitude.x[:4]
        to_c = _matrix(q)
        rotation_covariance = 2.0 * _xi(q).T @ self._attitude.P[:4, :4] @ (2.0 * _xi(q))
        arm = _cross(to_c @ self._position.x[:3])
        h = np.hstack([-to_c, np.zeros((3, 6))])
        self._position.update(pose.z_TC_C, R=pose.covariance_position + arm @ rotation_covariance @ arm.T, H=h)

    def _compare(self, compiled: np.void) -> Divergence:
        assert self._attitude is not None
        assert self._position is not None
        position = np.linalg.norm(self._position.x[:3] - compiled["pkf"]["x"][:3])
        mine, theirs = Rotation.from_quat(self._attitude.x[:4]), Rotation.from_quat(compiled["akf"]["x"][:4])
        return Divergence(float(position), float((mine.inv() * theirs).magnitude()))


_HANDED = np.outer([1.0, 1.0, 1.0, -1.0], [1.0, 1.0, 1.0, -1.0])
"""Signs that make ``_omega(w) q``, ``q`` times w, minus w times ``q``."""


def _exponential(m: Array) -> Array:
    """Return exp(m) of a small ``m`` by its series: a step of the filters is far below its next term."""
    square = m @ m
    return np.asarray(np.eye(len(m)) + m + square / 2.0 + square @ m / 6.0 + square @ square / 24.0)


def _matrix(q: Array) -> Array:
    """Return A(q), the transpose of scipy's matrix."""
    return np.asarray(Rotation.from_quat(q).as_matrix().T)


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _omega(w: Array) -> Array:
    return np.array(
        [[0.0, w[2], -w[1], w[0]], [-w[2], 0.0, w[0], w[1]], [w[1], -w[0], 0.0, w[2]], [-w[0], -w[1], -w[2], 0.0]]
    )


def _xi(q: Array) -> Array:
    return np.array([[q[3], -q[2], q[1]], [q[2], q[3], -q[0]], [-q[1], q[0], q[3]], [-q[0], -q[1], -q[2]]])


def _angles(q: Array) -> Array:
    return np.asarray(Rotation.from_quat(q).as_euler("ZYX")[::-1])


def _angle_jacobian(q: Array) -> Array:
    """Return d(theta)/d(q), (3, 4), by central differences."""
    columns = []
    for i in range(4):
        step = np.zeros(4)
        step[i] = 1e-6
        columns.append((_angles(q + step) - _angles(q - step)) / 2e-6)
    return np.array(columns).T
