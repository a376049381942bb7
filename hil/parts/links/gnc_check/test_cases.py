"""Test cases: a chaser at rest or drifting at an offset from its reference, independent of the GNC's demands.

The thrusters have no effect, the poses have no noise and the reference is at rest, so each reply has one cause. The
truth of a case has a closed form; IMU and poses follow from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hil.core.gnc_records import GNC_INPUT, GncMode, GncOrder
from hil.core.messages import Array, new
from hil.dynamics.hill import hill_acceleration
from hil.maths import quat

POSE_PERIOD: Final = 8  # cycles
_SIGMA_M: Final = 0.005
_REFERENCE_RANGE_M: Final = 2.0
_SIGMA_RAD: Final = math.radians(0.033)
_RETREAT_MPS: Final = 0.05
Triple = tuple[float, float, float]
_ZERO: Final[Triple] = (0.0, 0.0, 0.0)
Change = Callable[[np.record], None]
"""Changes an input before it is sent, as a GNC may misread it."""


@dataclass(frozen=True)
class CheckCase:
    """One session. offset_m, drift_mps: from the reference, in H; rotation_rad, rate_radps: of c against it, in c.

    late_s: from exposure to input. blind_s: time of the last pose. hold_s: start of a hold. abort_s: start of an abort.
    """

    name: str
    duration_s: float = 8.0
    offset_m: Triple = _ZERO
    drift_mps: Triple = _ZERO
    rotation_rad: Triple = _ZERO
    rate_radps: Triple = _ZERO
    late_s: float = 0.0
    blind_s: float = math.inf
    hold_s: float = math.inf
    abort_s: float = math.inf
    before: tuple[GncMode, ...] = field(default=())
    """Modes of the inputs before the run's time starts."""

    @property
    def moves(self) -> bool:
        """Whether the chaser drifts or rotates."""
        return self.drift_mps != _ZERO or self.rate_radps != _ZERO


@dataclass(frozen=True)
class TrueMotion:
    """Motion of the chaser: r_CT_H, v_CT_H, q_CH, w_CH_C; orbit: rate of H against inertial space, in c."""

    r: Array
    v: Array
    q: Array
    w: Array
    orbit: Array


class Player:
    """Generates the inputs of cases for ``setup`` (GNC_SETUP)."""

    def __init__(self, setup: np.record) -> None:
        self._dt = float(setup.step_s)
        self._n = float(setup.mean_motion_radps)
        self._anchor = np.array(setup.start_r_CT_H_m)

    def truth(self, case: CheckCase, t_s: float) -> TrueMotion:
        """Return the truth at ``t_s`` of the case."""
        v, w = np.array(case.drift_mps), np.array(case.rate_radps)
        r = self._anchor + np.array(case.offset_m) + v * t_s
        phi = np.array(case.rotation_rad) + w * t_s  # one axis, or slow: c rotates about axes fixed in it
        q = quat.from_rotation_vector(phi)
        return TrueMotion(r, v, q, w, quat.to_matrix(q) @ np.array([0.0, -self._n, 0.0]))

    def inputs(self, case: CheckCase, change: Change | None = None) -> Iterator[np.record]:
        """Yield the inputs, each in the same record."""
        sent = new(GNC_INPUT)
        for mode in case.before:
            self._fill(sent, case, -1, mode, 0)
            yield sent
        cycles = round(case.duration_s / self._dt)
        held = min(cycles, math.ceil(case.hold_s / self._dt)) if math.isfinite(case.hold_s) else cycles
        aborts = round(case.abort_s / self._dt) if math.isfinite(case.abort_s) else -1
        for k in range(cycles):
            mode = GncMode.RUNNING if k < held else GncMode.HOLD
            self._fill(sent, case, min(k, held - 1), mode, GncOrder.ABORT if k == aborts else 0)
            if change is not None:
                change(sent)
            yield sent

    def _fill(self, sent: np.record, case: CheckCase, cycle: int, mode: GncMode, orders: int) -> None:
        t_s = max(0, cycle) * self._dt
        running = mode is GncMode.RUNNING
        sent.cycle, sent.t_s, sent.mode, sent.orders = cycle, t_s, int(mode), int(orders)
        if case.moves or cycle <= 0:
            now, free = self.truth(case, t_s), np.empty(3)
            hill_acceleration(now.r, now.v, self._n, free)
            sent.rate_radps = now.w + now.orbit
            sent.force_mps2 = quat.to_matrix(now.q) @ -free  # against the free motion
        sent.reference_r_CT_H_m = self._anchor
        if t_s >= case.abort_s:
            sent.reference_r_CT_H_m[0] += _RETREAT_MPS * (t_s - case.abort_s)
            sent.reference_v_CT_H_mps[0] = _RETREAT_MPS
        sent.reference_q_CH = (0.0, 0.0, 0.0, 1.0)
        seen_s = t_s - case.late_s
        sent.n_poses = int(running and cycle % POSE_PERIOD == 0 and seen_s >= 0.0 and t_s <= case.blind_s)
        if sent.n_poses:
            self._write_pose(sent.poses[0], self.truth(case, seen_s), seen_s)

    @staticmethod
    def _write_pose(pose: np.record, then: TrueMotion, t_s: float) -> None:
        sigma_m = _SIGMA_M * max(1.0, float(np.linalg.norm(then.r)) / _REFERENCE_RANGE_M)
        pose["t_s"] = t_s
        pose["r_TC_C_m"] = -quat.to_matrix(then.q) @ then.r
        pose["q_CH"] = then.q
        pose["covariance_position_m2"] = sigma_m**2 * np.eye(3)
        pose["covariance_attitude_rad2"] = _SIGMA_RAD**2 * np.eye(3)


def along(axis: int, size: float) -> Triple:
    """Return a vector of ``size`` along ``axis``."""
    x, y, z = (size if i == axis else 0.0 for i in range(3))
    return x, y, z


def step_at(cycle: int, offset_m: float, rate_radps: float) -> Change:
    """Return a change that steps the reference's position and the gyro from ``cycle`` on."""

    def change(sent: np.record) -> None:
        if sent.cycle == cycle:
            sent.rate_radps += rate_radps  # the record of a chaser at rest keeps it
        if sent.cycle >= cycle:
            sent.reference_r_CT_H_m += offset_m

    return change


def scalar_first(sent: np.record) -> None:
    """Write the quaternions with the scalar first."""
    for q in _quaternions(sent):
        q[:] = np.roll(q, 1)


def inverse_quaternions(sent: np.record) -> None:
    """Write the quaternions as q_HC."""
    for q in _quaternions(sent):
        q[:3] = -q[:3]


def chaser_from_target(sent: np.record) -> None:
    """Write the poses' positions with opposite sign."""
    for pose in sent.poses[: sent.n_poses]:
        pose["r_TC_C_m"] = -pose["r_TC_C_m"]


def in_h(sent: np.record) -> None:
    """Write the poses' positions as components in H."""
    for pose in sent.poses[: sent.n_poses]:
        pose["r_TC_C_m"] = quat.to_matrix(np.array(pose["q_CH"])).T @ pose["r_TC_C_m"]


def _quaternions(sent: np.record) -> list[Array]:
    return [sent.reference_q_CH, *(pose["q_CH"] for pose in sent.poses[: sent.n_poses])]
