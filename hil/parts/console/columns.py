"""Columns of the console: one row of numbers per row of CYCLE, and decimation of rows."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.core.fields import Field, record_dtype
from hil.core.jit import kernel
from hil.core.messages import CYCLE, MAX_THRUSTERS
from hil.maths import euler, quat
from hil.sensors.vision_unit.pose import position_in_h


def _vector(name: str, unit: str, frame: str = "", meaning: str = "") -> Field:
    return Field(name, "f8", 3, unit, frame, meaning)


ROW_FIELDS: Final = (
    Field("t_s", "f8", unit="s"),
    _vector("reference_m", "m", "H", "r_CT_H"),
    _vector("estimate_m", "m", "H"),
    _vector("bench_m", "m", "H", "from the encoders"),
    _vector("vision_m", "m", "H", "from the received pose; nan in cycles without one"),
    _vector("velocity_estimate_mps", "m/s", "H"),
    _vector("velocity_truth_mps", "m/s", "H"),
    _vector("angle_reference_deg", "deg", "", "theta1 theta2 theta3 of H to c"),
    _vector("angle_estimate_deg", "deg"),
    _vector("angle_bench_deg", "deg"),
    _vector("angle_vision_deg", "deg"),
    _vector("rate_estimate_degps", "deg/s", "c", "c against H"),
    _vector("rate_truth_degps", "deg/s", "c"),
    _vector("position_error_mm", "mm", "H", "estimate minus truth"),
    _vector("position_band_mm", "mm", "H", "three sigma of the filter"),
    _vector("angle_error_deg", "deg", "c", "small rotation from the estimated to the true frame"),
    _vector("angle_band_deg", "deg", "c", "three sigma of the filter"),
    _vector("rail_m", "m"),
    _vector("gimbal_deg", "deg"),
    Field("q_bench", "f8", 4, meaning="attitude by the encoders"),
    Field("nis_position", "f8", meaning="nan without an update"),
    Field("nis_attitude", "f8", meaning="nan without an update"),
    Field("thrusters", "f8", meaning="bit n set: thruster n is open; the bits of 24 are exact in a 32-bit float"),
    Field("lateness_us", "f8", unit="us"),
    Field("corridor_margin_m", "f8", unit="m"),
    Field("closing_margin_mps", "f8", unit="m/s"),
    Field("aborted", "f8"),
    Field("phase", "f8"),
    Field("level_along", "f8", meaning="protection level over alert limit"),
    Field("level_across", "f8", meaning="protection level over alert limit"),
    Field("level_attitude", "f8", meaning="protection level over alert limit"),
    Field("level_term", "f8", meaning="largest term of the level that is nearest its limit, as in SUPERVISION"),
)
"""Numbers of a row of the console: columns, in the order of the message, and record of the kernel."""
ROW: Final = np.dtype((np.record, record_dtype(ROW_FIELDS)))
_CYCLE: Final = np.dtype((np.record, CYCLE))


def _columns(field: Field) -> list[str]:
    """Return the columns of ``field``: a vector has one for each axis, a quaternion for each component."""
    ends = {3: [".x", ".y", ".z"], 4: ["_0", "_1", "_2", "_3"], (): [""]}[field.shape]
    return [f"{field.name}{end}" for end in ends]


NAMES: Final = tuple(name for field in ROW_FIELDS for name in _columns(field))
"""Names of the columns in order."""
COLUMNS: Final = len(NAMES)
INDEX: Final = {name: i for i, name in enumerate(NAMES)}

_THRUSTERS: Final = INDEX["thrusters"]
_LATENESS: Final = INDEX["lateness_us"]
_LARGEST: Final = (INDEX["nis_position"], INDEX["nis_attitude"], _LATENESS)
_NEWEST_KNOWN: Final = tuple(INDEX[f"{name}.{axis}"] for name in ("vision_m", "angle_vision_deg") for axis in "xyz")


@kernel
def _put(out, vector, scale):
    """Write ``vector`` (n,), scaled, into ``out`` (n,)."""
    for i in range(vector.shape[0]):
        out[i] = scale * vector[i]


@kernel
def _attitude_error(q_true, q_estimate):
    """Return the small rotation (3,), rad, in c, from the estimated to the true frame."""
    return quat.to_rotation_vector(quat.multiply(q_true, quat.conjugate(q_estimate)))


@kernel
def columns_of(params, order, rows, out):
    """Write the console's numbers of ``rows`` (n,) of CYCLE into ``out`` (n,) of ROW.

    params: BENCH_PARAMS. order (3,): rotation sequence of the angles. Lengths in m or mm, angles in deg, as named.
    """
    deg = 180.0 / math.pi
    r_bench, q_bench, r_seen, none = np.empty(3), np.empty(4), np.empty(3), np.full(3, np.nan)
    for k in range(rows.shape[0]):
        row, o = rows[k], out[k]
        truth, estimate, reference, pose, supervision = (
            row.truth,
            row.navigation,
            row.reference,
            row.pose,
            row.supervision,
        )
        pose_of_axes(params, row.feedback.rail_m, row.feedback.gimbal_rad, r_bench, q_bench)
        position_in_h(pose, r_seen)
        seen = pose.fresh > 0
        o.t_s = row.t_s
        _put(o.reference_m, reference.r_CT_H, 1.0)
        _put(o.estimate_m, estimate.r_CT_H, 1.0)
        _put(o.bench_m, r_bench, 1.0)
        _put(o.vision_m, r_seen if seen else none, 1.0)
        _put(o.velocity_estimate_mps, estimate.v_CT_H, 1.0)
        _put(o.velocity_truth_mps, truth.v_CT_H, 1.0)
        _put(o.angle_reference_deg, euler.from_quaternion(reference.q_CH, order), deg)
        _put(o.angle_estimate_deg, euler.from_quaternion(estimate.q_CH, order), deg)
        _put(o.angle_bench_deg, euler.from_quaternion(q_bench, order), deg)
        _put(o.angle_vision_deg, euler.from_quaternion(pose.q_CH, order) if seen else none, deg)
        _put(o.rate_estimate_degps, estimate.w_CH_C, deg)
        _put(o.rate_truth_degps, truth.w_CI_C - quat.transform(truth.q_CH, truth.w_HI_H), deg)
        _put(o.position_error_mm, estimate.r_CT_H - truth.r_CT_H, 1e3)
        _put(o.position_band_mm, estimate.sigma_r_m, 3e3)
        _put(o.angle_error_deg, _attitude_error(truth.q_CH, estimate.q_CH), deg)
        _put(o.angle_band_deg, estimate.sigma_attitude_rad, 3.0 * deg)
        _put(o.rail_m, row.feedback.rail_m, 1.0)
        _put(o.gimbal_deg, row.feedback.gimbal_rad, deg)
        _put(o.q_bench, q_bench, 1.0)
        o.nis_position, o.nis_attitude = estimate.nis_position, estimate.nis_attitude
        open_now = 0
        for i in range(MAX_THRUSTERS):
            if row.command.on[i] != 0:
                open_now += 1 << i
        o.thrusters = open_now
        o.lateness_us = 1e6 * row.lateness_s
        o.corridor_margin_m, o.closing_margin_mps = supervision.corridor_margin_m, supervision.closing_margin_mps
        o.aborted, o.phase = supervision.aborted, reference.phase
        o.level_along = supervision.level[0] / supervision.alert_limit[0]
        o.level_across = supervision.level[1] / supervision.alert_limit[1]
        o.level_attitude = supervision.level[2] / supervision.alert_limit[2]
        o.level_term = supervision.level_term


_OF_ESTIMATE: Final = [INDEX[name] for name in NAMES if any(part in name for part in ("estimate", "error", "band"))]


def console_rows(params: np.record, rows: np.ndarray) -> np.ndarray[Any, Any]:
    """Return the columns of ``rows`` (n,) of CYCLE, shape (n, COLUMNS), 32-bit; params: BENCH_PARAMS.

    Columns of the estimate are nan before the first pose, while it is invalid.
    """
    out = np.full((len(rows), COLUMNS), np.nan).view(ROW)[:, 0]
    if len(rows):  # copied as bytes: numpy copies records field by field
        columns_of(params, euler.YAW_PITCH_ROLL, np.frombuffer(bytearray(rows.tobytes()), _CYCLE), out)
    columns = out.view("<f8").reshape(len(rows), COLUMNS).astype("<f4")
    if not (valid := rows["navigation"]["valid"] != 0).all():
        columns[np.ix_(~valid, _OF_ESTIMATE)] = np.nan
    return columns


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
        finite = np.isfinite(values)
        newest = values.shape[1] - 1 - finite[:, ::-1].argmax(axis=1)
        out[:, column] = values[np.arange(len(values)), newest]
    return out
