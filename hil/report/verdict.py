"""The ready phase and its verdict: bench paper Table III, judged on the truth.

The ready phase begins when every row of Table III has held for ``dwell_s`` without a break, and runs
to the end; the run passes when every row, each axis alone, holds in all of it. The moment at which
that first unbroken dwell began is kept as ``held_since_s``. (docs/decisions says why the dwell counts
as approach: by continuity, whatever entered its tolerance last stands at that tolerance when it does.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hil.config.scenario import Requirements
from hil.maths import euler
from hil.messages import Array

_YAW_PITCH_ROLL = np.array([2, 1, 0])
ROW_NAMES = ("position_m", "velocity_mps", "attitude_deg", "rate_degps")


@dataclass(frozen=True)
class Deviations:
    """Truth against the ready state at each cycle, arrays (n, 3): m, m/s, deg, deg/s; ``t_s`` (n,)."""

    t_s: Array
    position_m: Array
    velocity_mps: Array
    attitude_deg: Array
    rate_degps: Array


@dataclass(frozen=True)
class Verdict:
    """ready_time_s, held_since_s: s, None if never. worst: row name -> largest |deviation| (3,), None if never."""

    ready_time_s: float | None
    held_since_s: float | None
    passed: bool
    worst: dict[str, Array] | None


def deviations(history: np.ndarray, requirements: Requirements) -> Deviations:
    """Return the deviations of the truth in ``history`` (n,) of CYCLE."""
    truth = history["truth"]
    position = truth["r_CT_H"].copy()
    position[:, 0] -= requirements.axial_distance_m
    q = truth["q_CH"]
    attitude = np.array([euler.from_quaternion(row, _YAW_PITCH_ROLL) for row in q]).reshape(-1, 3)
    # scipy's rotation of the same four numbers takes c to H: w_CH = w_CI - A(q_CH) w_HI
    rate = truth["w_CI_C"] - Rotation.from_quat(q).apply(truth["w_HI_H"], inverse=True) if len(q) else np.empty((0, 3))
    return Deviations(history["t_s"], position, truth["v_CT_H"], np.degrees(attitude), np.degrees(rate))


def tolerances(requirements: Requirements) -> dict[str, Array]:
    """Return the allowed |deviation| of each row and axis (Table III)."""
    r = requirements
    return {
        "position_m": np.array([r.axial_tolerance_m, r.radial_distance_m, r.radial_distance_m]),
        "velocity_mps": np.array([r.axial_rate_mps, r.radial_rate_mps, r.radial_rate_mps]),
        "attitude_deg": np.full(3, r.angle_deg),
        "rate_degps": np.full(3, r.angular_rate_degps),
    }


def judge(found: Deviations, requirements: Requirements) -> Verdict:
    """Return the verdict on a run's deviations."""
    allowed = tolerances(requirements)
    within = np.ones(len(found.t_s), dtype=bool)
    for name in ROW_NAMES:
        within &= (np.abs(getattr(found, name)) <= allowed[name]).all(axis=1)
    start = _first_dwell(found.t_s, within, requirements.dwell_s)
    if start is None:
        return Verdict(None, None, False, None)
    held_since_s = float(found.t_s[start])
    ready = int(np.searchsorted(found.t_s, held_since_s + requirements.dwell_s - 1e-9))
    worst = {name: np.abs(getattr(found, name)[ready:]).max(axis=0) for name in ROW_NAMES}
    return Verdict(float(found.t_s[ready]), held_since_s, bool(within[ready:].all()), worst)


def _first_dwell(t_s: Array, within: np.ndarray, dwell_s: float) -> int | None:
    """Return the first index from which ``within`` holds for ``dwell_s``, None if there is none."""
    edges = np.diff(np.concatenate([[False], within, [False]]).astype(np.int8))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    for start, end in zip(starts, ends, strict=True):
        if t_s[end] - t_s[start] >= dwell_s - 1e-9:
            return int(start)
    return None
