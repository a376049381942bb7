"""Bench error: pose of the bench's camera, by the encoders, against the truth, in each cycle; energy added by axes.

A row's truth is of ``t_s``, its feedback was sampled at ``sampled_s``, on wires most of a cycle earlier: the encoders
are interpolated to the times of the truth first.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.bench.energy import add_work
from hil.bench.field_of_view import camera_errors
from hil.bench.kinematics import not_shown, unseen
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import AXES, Array, new
from hil.maths import elementary, linear
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params
from hil.report.results import RmsMax
from hil.report.sums import Squares
from hil.sensors.vision_unit import parameters as vmu_params

_TIME_SLACK_S = 1e-6
ENERGY_KEYS: Final = ("translation_added_j", "translation_work_j", "rotation_added_j", "rotation_work_j")


class BenchErrorSums:
    """Errors of the bench's pose, and the energy that the axes add, over the rows of a run, which are added in order.

    Thrusters are those of the scenario, without errors; the truth's fractions are how long they were open.
    """

    def __init__(self, scenario: Scenario, rig: Rig, settled_s: float) -> None:
        self._params = bench_params.bench(rig, scenario.step_s, scenario.bench)
        self._mounting = vmu_params.mounting(rig)
        self._wrenches = gnc_params.wrenches_of(scenario.chaser.thrusters)
        self._settled_s = settled_s
        self._counted_s = -math.inf
        self._distance, self._angle = Squares(), Squares()
        # of bench and estimate, before the navigation has settled and from then on
        self._shares = [[(Squares(), Squares()) for _ in ("position", "attitude")] for _ in ("before", "settled")]
        self._work = np.zeros(4)
        self._is_relative = rig.moving_target is not None
        self._unseen = np.zeros(6) if rig.hidden else None

    def add(self, history: np.ndarray) -> None:
        """Add the rows (n,) of CYCLE; the first of them is the last row that was added before, if there was any."""
        rows, rail_m, gimbal_rad = encoders_at_truth(history)
        if not len(rows):
            return
        r, q = (np.ascontiguousarray(rows["truth"][name]) for name in ("r_CT_H", "q_CH"))
        fraction = rows["truth"]["thrust_fraction"][:, : len(self._wrenches)]
        force, torque = linear.product(fraction, self._wrenches[:, :3]), linear.product(fraction, self._wrenches[:, 3:])
        add_work(self._params, force, torque, rail_m, gimbal_rad, r, q, self._work)
        self._add_unseen(rail_m, gimbal_rad, r, q)
        distance, angle = _camera_errors(self._params, self._mounting, rows, rail_m, gimbal_rad)
        new = rows["t_s"] > self._counted_s
        rows, distance, angle = rows[new], distance[new], angle[new]
        self._counted_s = max(self._counted_s, *rows["t_s"][-1:])
        self._distance.add(1e3 * distance)
        self._angle.add(np.degrees(angle))
        self._add_shares(rows, distance, angle)

    def _add_unseen(self, rail_m: Array, gimbal_rad: Array, r_CT_H: Array, q_CH: Array) -> None:
        """Add what the axes do not show; with a manipulator, which shares the pose, by the encoders."""
        if self._unseen is None:
            return
        out = np.empty((len(r_CT_H), 6))
        if self._is_relative:
            not_shown(self._params, rail_m, gimbal_rad, r_CT_H, q_CH, out)
        else:
            unseen(self._params, r_CT_H, q_CH, new(AXES), out)
        np.maximum(self._unseen, np.abs(out).max(axis=0), out=self._unseen)

    def _add_shares(self, rows: np.ndarray, distance: Array, angle: Array) -> None:
        truth, estimate = rows["truth"], rows["navigation"]
        offset = linear.lengths(truth["r_CT_H"] - estimate["r_CT_H"])
        cosine = np.abs(np.sum(truth["q_CH"] * estimate["q_CH"], axis=1))
        turned = 2.0 * elementary.each(elementary.acos, np.minimum(1.0, cosine))
        valid, settled = estimate["valid"] == 1, rows["t_s"] >= self._settled_s
        for span, sums in zip((valid & ~settled, valid & settled), self._shares, strict=True):
            for (part, whole), error, of in zip(sums, (distance, angle), (offset, turned), strict=True):
                part.add(error[span])
                whole.add(of[span])

    def rows(self) -> dict[str, Any]:
        """Return the pose error at the left camera, its fraction of the navigation error, and the energy added, J.

        ``pose_error_mm`` and ``pose_error_deg``: rms and max over the run. ``share_of_navigation_error`` and
        ``share_of_attitude_error``: rms of the pose error over rms of the estimate's error, both once the navigation
        has settled (over all if the run ended before). None for quantities that the run does not have.
        """
        before, settled = self._shares
        position, attitude = settled if settled[0][0].n else before
        return {
            "pose_error_mm": RmsMax(rms=self._distance.rms(), max=self._distance.largest()),
            "pose_error_deg": RmsMax(rms=self._angle.rms(), max=self._angle.largest()),
            "share_of_navigation_error": _ratio(*position),
            "share_of_attitude_error": _ratio(*attitude),
            "energy": dict(zip(ENERGY_KEYS, self._work.tolist(), strict=True)),
            "unseen_m": None if self._unseen is None else self._unseen[:3].tolist(),
            "unseen_deg": None if self._unseen is None else np.degrees(self._unseen[3:]).tolist(),
        }


def _ratio(part: Squares, whole: Squares) -> float | None:
    above, below = part.rms(), whole.rms()
    return above / below if above is not None and below else None


def pose_errors(history: np.ndarray, scenario: Scenario, rig: Rig) -> tuple[np.ndarray, Array, Array]:
    """Return the rows (n,) of CYCLE with known encoders, and the left camera's errors in them: m, rad, (n,)."""
    params, mounting = bench_params.bench(rig, scenario.step_s, scenario.bench), vmu_params.mounting(rig)
    rows, rail_m, gimbal_rad = encoders_at_truth(history)
    return rows, *_camera_errors(params, mounting, rows, rail_m, gimbal_rad)


def _camera_errors(
    params: np.record, mounting: np.record, rows: np.ndarray, rail_m: Array, gimbal_rad: Array
) -> tuple[Array, Array]:
    distance, angle = np.empty(len(rows)), np.empty(len(rows))
    r, q = (np.ascontiguousarray(rows["truth"][name]) for name in ("r_CT_H", "q_CH"))
    camera_errors(params, mounting, rail_m, gimbal_rad, r, q, distance, angle)
    return distance, angle


def encoders_at_truth(history: np.ndarray) -> tuple[np.ndarray, Array, Array]:
    """Return the rows (n,) with encoders known at ``t_s``, and rails, m, and gimbals, rad, (n, 3), at that time."""
    if not len(history):
        return history, np.empty((0, 3)), np.empty((0, 3))
    sampled_s, feedback = history["sampled_s"], history["feedback"]
    t_s = history["t_s"]
    first = sampled_s.min(axis=0).max() - _TIME_SLACK_S
    last = sampled_s.max(axis=0).min() + _TIME_SLACK_S
    begin, end = np.searchsorted(t_s, first, "left"), np.searchsorted(t_s, last, "right")
    rows = history[begin:end]
    rail_m = _at(rows["t_s"], sampled_s[:, 0], feedback["rail_m"])
    return rows, rail_m, _at(rows["t_s"], sampled_s[:, 1], feedback["gimbal_rad"])


def _at(t_s: Array, sampled_s: Array, values: Array) -> Array:
    """Return ``values`` (m, 3), sampled at ``sampled_s`` (m,), interpolated to ``t_s`` (n,): shape (n, 3)."""
    when, first = np.unique(sampled_s, return_index=True)
    return np.column_stack([np.interp(t_s, when, values[first, i]) for i in range(3)])
