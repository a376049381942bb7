"""Bench error: pose of the bench's camera, by the encoders, against the truth, in each cycle.

A row's truth is of ``t_s``, its feedback was sampled at ``sampled_s``, on wires most of a cycle earlier: the encoders
are interpolated to the times of the truth first.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.bench.field_of_view import camera_errors
from hil.config.bench_scale import FULL_SCALE, BenchScale
from hil.config.rig import Rig
from hil.core.messages import Array
from hil.params import bench as bench_params
from hil.params import vision as vision_params

_TIME_SLACK_S = 1e-6


def judge_bench_error(
    history: np.ndarray, rig: Rig, step_s: float, settled_s: float, shown: BenchScale = FULL_SCALE
) -> dict[str, Any]:
    """Return the pose error at the left camera, and its fraction of the navigation error.

    ``pose_error_mm`` and ``pose_error_deg``: rms and max over the run. ``share_of_navigation_error`` and
    ``share_of_attitude_error``: rms of the pose error over rms of the estimate's error, both from
    ``settled_s`` on (over all if the run ended before). None for quantities that the run does not have.
    """
    rows, distance, angle = pose_errors(history, rig, step_s, shown)
    if not len(rows):
        none = {"rms": None, "max": None}
        return {"pose_error_mm": none, "pose_error_deg": none} | _shares(None, None)
    return {
        "pose_error_mm": _rms_and_max(1e3 * distance),
        "pose_error_deg": _rms_and_max(np.degrees(angle)),
    } | _navigation_shares(rows, distance, angle, settled_s)


def pose_errors(
    history: np.ndarray, rig: Rig, step_s: float, shown: BenchScale = FULL_SCALE
) -> tuple[np.ndarray, Array, Array]:
    """Return the rows (n,) with known encoders, and the left camera's errors in them: m, rad, (n,)."""
    rows, rail_m, gimbal_rad = encoders_at_truth(history)
    distance, angle = np.empty(len(rows)), np.empty(len(rows))
    if len(rows):
        truth = rows["truth"]
        camera_errors(
            bench_params.bench(rig, step_s, shown),
            vision_params.mounting(rig),
            rail_m,
            gimbal_rad,
            np.ascontiguousarray(truth["r_CT_H"]),
            np.ascontiguousarray(truth["q_CH"]),
            distance,
            angle,
        )
    return rows, distance, angle


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


def _rms_and_max(values: Array) -> dict[str, float | None]:
    if not np.isfinite(values).all():
        return {"rms": None, "max": None}
    return {"rms": float(np.sqrt(np.mean(values**2))), "max": float(values.max())}


def _navigation_shares(rows: np.ndarray, distance: Array, angle: Array, settled_s: float) -> dict[str, float | None]:
    known = rows["navigation"]["valid"] == 1
    late = known & (rows["t_s"] >= settled_s)
    chosen = late if late.any() else known
    if not chosen.any():
        return _shares(None, None)
    truth, estimate = rows["truth"], rows["navigation"]
    offset = np.linalg.norm((truth["r_CT_H"] - estimate["r_CT_H"])[chosen], axis=1)
    cosine = np.abs(np.sum((truth["q_CH"] * estimate["q_CH"])[chosen], axis=1))
    angle_off = 2.0 * np.arccos(np.minimum(1.0, cosine))
    return _shares(_ratio(distance[chosen], offset), _ratio(angle[chosen], angle_off))


def _shares(position: float | None, attitude: float | None) -> dict[str, float | None]:
    return {"share_of_navigation_error": position, "share_of_attitude_error": attitude}


def _ratio(error: Array, whole: Array) -> float | None:
    """Return the ratio of the rms values, None if it is not finite."""
    below = float(np.sqrt(np.mean(whole**2)))
    above = float(np.sqrt(np.mean(error**2)))
    return above / below if below > 0.0 and np.isfinite(above) and np.isfinite(below) else None
