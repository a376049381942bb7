"""Columns of the console: one row of numbers per row of CYCLE, and decimation of rows."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.maths import euler, quat
from hil.sensors.vision_unit.pose import position_in_h

_TRIPLES: Final = (
    "reference_m",  # of r_CT_H, in H
    "estimate_m",
    "bench_m",  # from the encoders
    "vision_m",  # from the received pose; nan in cycles without one
    "velocity_estimate_mps",  # in H
    "velocity_truth_mps",
    "angle_reference_deg",  # theta1 theta2 theta3 of H to c
    "angle_estimate_deg",
    "angle_bench_deg",
    "angle_vision_deg",
    "rate_estimate_degps",  # c against H, in c
    "rate_truth_degps",
    "position_error_mm",  # estimate minus truth, in H
    "position_band_mm",  # three sigma of the filter
    "angle_error_deg",  # small rotation from the estimated to the true frame, in c
    "angle_band_deg",
    "rail_m",
    "gimbal_deg",
)
_SINGLES: Final = (
    "q_bench_0",
    "q_bench_1",
    "q_bench_2",
    "q_bench_3",
    "nis_position",  # nan without an update
    "nis_attitude",
    "thrusters",  # bit n set: thruster n is open
    "lateness_us",
    "corridor_margin_m",
    "closing_margin_mps",
    "aborted",
    "phase",
    "level_along",  # protection level over alert limit
    "level_across",
    "level_attitude",
    "level_term",  # the largest of the level that is nearest its limit, as in SUPERVISION
)
NAMES: Final = ("t_s", *(f"{name}.{axis}" for name in _TRIPLES for axis in "xyz"), *_SINGLES)
"""Names of the columns in order; the bits of 24 thrusters are exact in a 32-bit float."""
COLUMNS: Final = len(NAMES)
INDEX: Final = {name: i for i, name in enumerate(NAMES)}

_THRUSTERS: Final = INDEX["thrusters"]
_LATENESS: Final = INDEX["lateness_us"]
_LARGEST: Final = (INDEX["nis_position"], INDEX["nis_attitude"], _LATENESS)
_NEWEST_KNOWN: Final = tuple(INDEX[f"{name}.{axis}"] for name in ("vision_m", "angle_vision_deg") for axis in "xyz")


@kernel
def _put(out, at, vector, scale):
    """Write ``vector`` (3,), scaled, from column ``at`` of the row ``out``; return the column after it."""
    for i in range(3):
        out[at + i] = scale * vector[i]
    return at + 3


@kernel
def _put_angles(out, at, q, order):
    """Write the angles theta1 theta2 theta3 of ``q`` (4,), deg; return the column after them."""
    return _put(out, at, euler.from_quaternion(q, order), 180.0 / math.pi)


@kernel
def _attitude_error(q_true, q_estimate):
    """Return the small rotation (3,), rad, in c, from the estimated to the true frame."""
    return quat.to_rotation_vector(quat.multiply(q_true, quat.conjugate(q_estimate)))


@kernel
def columns_of(params, order, rows, out):
    """Write the console's columns of ``rows`` (n,) of CYCLE into ``out`` (n, COLUMNS), in the order of NAMES.

    params: BENCH_PARAMS. order (3,): rotation sequence of the angles. Lengths in m or mm, angles in deg, as named.
    """
    deg = 180.0 / math.pi
    r_bench, q_bench, r_seen = np.empty(3), np.empty(4), np.empty(3)
    for k in range(rows.shape[0]):
        row, o = rows[k], out[k]
        truth, estimate, reference, pose = row.truth, row.navigation, row.reference, row.pose
        pose_of_axes(params, row.feedback.rail_m, row.feedback.gimbal_rad, r_bench, q_bench)
        o[0] = row.t_s
        at = _put(o, 1, reference.r_CT_H, 1.0)
        at = _put(o, at, estimate.r_CT_H, 1.0)
        at = _put(o, at, r_bench, 1.0)
        seen = pose.fresh > 0
        none = np.full(3, np.nan)
        position_in_h(pose, r_seen)
        at = _put(o, at, r_seen if seen else none, 1.0)
        at = _put(o, at, estimate.v_CT_H, 1.0)
        at = _put(o, at, truth.v_CT_H, 1.0)
        at = _put_angles(o, at, reference.q_CH, order)
        at = _put_angles(o, at, estimate.q_CH, order)
        at = _put_angles(o, at, q_bench, order)
        at = _put(o, at, euler.from_quaternion(pose.q_CH, order) if seen else none, deg)
        at = _put(o, at, estimate.w_CH_C, deg)
        w_HI_C = quat.transform(truth.q_CH, truth.w_HI_H)
        error = _attitude_error(truth.q_CH, estimate.q_CH)
        for i in range(3):
            o[at + i] = deg * (truth.w_CI_C[i] - w_HI_C[i])
            o[at + 3 + i] = 1e3 * (estimate.r_CT_H[i] - truth.r_CT_H[i])
            o[at + 6 + i] = 3e3 * estimate.sigma_r_m[i]
            o[at + 9 + i] = deg * error[i]
            o[at + 12 + i] = 3.0 * deg * estimate.sigma_attitude_rad[i]
        at = _put(o, at + 15, row.feedback.rail_m, 1.0)
        at = _put(o, at, row.feedback.gimbal_rad, deg)
        if estimate.valid == 0:
            _clear_estimate(o)
        for i in range(4):
            o[at + i] = q_bench[i]
        o[at + 4] = estimate.nis_position
        o[at + 5] = estimate.nis_attitude
        open_now = 0
        for i in range(MAX_THRUSTERS):
            if row.command.on[i] != 0:
                open_now += 1 << i
        o[at + 6] = open_now
        o[at + 7] = 1e6 * row.lateness_s
        o[at + 8] = row.supervision.corridor_margin_m
        o[at + 9] = row.supervision.closing_margin_mps
        o[at + 10] = row.supervision.aborted
        o[at + 11] = reference.phase
        for i in range(3):
            o[at + 12 + i] = row.supervision.level[i] / row.supervision.alert_limit[i]
        o[at + 15] = row.supervision.level_term


_OF_ESTIMATE: Final = tuple(
    INDEX[f"{name}.{axis}"]
    for name in _TRIPLES
    if "estimate" in name or "error" in name or "band" in name
    for axis in "xyz"
)


@kernel
def _clear_estimate(out):
    """Write nan into the columns of the estimate, invalid before the first pose."""
    for i in _OF_ESTIMATE:
        out[i] = np.nan


def console_rows(params: np.record, rows: np.ndarray) -> np.ndarray[Any, Any]:
    """Return the columns of ``rows`` (n,) of CYCLE, shape (n, COLUMNS), 32-bit; params: BENCH_PARAMS."""
    out = np.empty((len(rows), COLUMNS))
    if len(rows):
        columns_of(params, euler.YAW_PITCH_ROLL, np.array(rows).view(np.recarray), out)
    return out.astype("<f4")


def decimated(rows: np.ndarray[Any, Any], at_most: int) -> np.ndarray[Any, Any]:
    """Return at most ``at_most`` rows (m, COLUMNS) that represent ``rows`` (n, COLUMNS), the newest of each group.

    Each keeps the largest lateness and NIS of its group, all thrusters that fired, and the newest pose.
    """
    n = len(rows)
    if n <= at_most:
        return rows
    group = -(-n // at_most)
    first = n % group
    parts = [rows[:first][None]] if first else []
    parts.append(rows[first:].reshape(-1, group, COLUMNS))
    return np.concatenate([_one_each(part) for part in parts])


def _one_each(groups: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return one row for each of ``groups`` (m, k, COLUMNS)."""
    out = groups[:, -1].copy()
    for column in _LARGEST:
        out[:, column] = np.fmax.reduce(groups[:, :, column], axis=1)
    out[:, _THRUSTERS] = np.bitwise_or.reduce(groups[:, :, _THRUSTERS].astype(np.int64), axis=1)
    for column in _NEWEST_KNOWN:
        values = groups[:, :, column]
        known = np.isfinite(values)
        newest = values.shape[1] - 1 - known[:, ::-1].argmax(axis=1)
        out[:, column] = values[np.arange(len(values)), newest]
    return out
