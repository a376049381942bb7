"""Times of a run: latencies of poses, thruster commands and setpoints, and execution times of the devices.

Devices: ``cycle``: from the start of a cycle to its thruster command. ``rails``, ``turntable``: age of the encoders'
sample that the cycle used, with the rate of the exchanges. ``vmu``: from the exposure of a pose to its last byte.
``io``: from a thruster command to the acknowledgement of its digital lines by the coupler.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.config.rig import Rig
from hil.core.messages import Array
from hil.report.results import DeviceResults
from hil.sensors.vision_unit import columns as vmu_columns

LATENCIES: Final = (
    "pose_to_command_ms", "pose_to_wire_ms", "setpoint_to_encoder_ms", "encoder_behind_lead_ms", "pose_behind_imu_ms",
)  # fmt: skip
_NO_LEAD: Final = np.zeros(6)
_WINDOW_S = 1.0
_SLOWEST = (0.0005, math.radians(0.02))  # m/s and rad/s, rms: slower windows do not determine a delay
_SIGMA_MAX_S = 0.002
_LEAST_SAMPLES = 10
_POSE_WINDOW_S = 20.0
_KNOWN_WITHIN = 2  # rows after the command
_STAMP_S = 1e-3  # a command is stamped just after its lines were passed on


def measured(
    rows: np.ndarray, joined: np.ndarray, step_s: float, tick_s: float, lead_s: Array = _NO_LEAD
) -> dict[str, Array]:
    """Return the values of each latency, s of bench time, by the names of LATENCIES.

    ``pose_to_command_ms``: from the last byte of a pose's frame to the command of the cycle that used
    it. ``pose_to_wire_ms``: to the time at which the coupler of the digital lines received a command that
    changed them. ``setpoint_to_encoder_ms``: from sending a setpoint to the encoder's arrival at it, one
    value for each second in which an axis moved. ``encoder_behind_lead_ms``: how much later than its setpoint's own
    time and ``lead_s`` it is there, by which the bench shows the truth too late. ``pose_behind_imu_ms``: see
    ``pose_behind_imu_s``.

    joined: ``rows`` with the row before them, unless they are the first of the run. tick_s: period of the setpoints.
    lead_s: (6,), of the axes.
    """
    behind_s, axes = encoder_behind_s(joined, step_s)
    times = (
        pose_to_command_s(rows),
        pose_to_wire_s(joined),
        behind_s + tick_s,
        behind_s - lead_s[axes],
        pose_behind_imu_s(joined),
    )
    return dict(zip(LATENCIES, times, strict=True))


def pose_to_command_s(history: np.ndarray) -> Array:
    """Return a time for each cycle that used a pose, s."""
    used = history[vmu_columns.has_pose(history)]
    taken: Array = used["commanded_s"] - used["received_s"]
    return taken


def pose_to_wire_s(history: np.ndarray) -> Array:
    """Return a time for each cycle that used a pose and changed a digital line of a thruster, s.

    A row's ``on_wire_s`` is that of the newest change known at its start. Changes that were not on the wire before
    the next one are omitted.
    """
    wire_s, commanded_s = history["on_wire_s"], history["commanded_s"]
    delays = []
    for k in np.flatnonzero(vmu_columns.has_pose(history)):
        later = wire_s[k + 1 : k + 1 + _KNOWN_WITHIN]
        changed = later[later >= commanded_s[k] - _STAMP_S]
        if k and len(changed) and (history["command"]["on"][k] != history["command"]["on"][k - 1]).any():
            delays.append(changed[0] - history["received_s"][k])
    return np.array(delays)


def encoder_behind_s(history: np.ndarray, step_s: float) -> tuple[Array, NDArray[np.int64]]:
    """Return a time for each axis and each window of a second in which it moved, s, (n,), and the axes' numbers (n,).

    A row's setpoint belongs to ``t_s``; its feedback was sampled at ``sampled_s``. While an axis follows with a
    delay d, its encoder lags by d times the speed: d is fitted to each window by least squares. Windows with an
    uncertain d are omitted.
    """
    rows = history[1:]  # the first setpoint of a run is its last one before it
    delays, axes = list[float](), list[int]()
    window = max(_LEAST_SAMPLES, round(_WINDOW_S / step_s))
    for axis in range(6):
        t_s, behind, speed = _of_axis(rows, axis)
        for k in range(0, len(t_s) - window + 1, window):
            part = slice(k, k + window)
            delays += _delay_of_window(behind[part], speed[part], axis)
            axes += [axis] * (len(delays) - len(axes))
    return np.array(delays), np.array(axes, np.int64)


def pose_behind_imu_s(history: np.ndarray) -> Array:
    """Return the time offset between vision unit and IMU for each window of 20 s in which the chaser moved, s.

    The IMU measures the motion of the truth at its time. A pose that shows it d later than the exposure that it states
    (lag of the axes, an unknown latency of cameras or clock) lags by d times the velocity: d is fitted to the
    poses' positions of a window by least squares. Windows with an uncertain d are omitted.
    """
    used = vmu_columns.poses(history)
    used = used[np.isfinite(used["t_s"]) & (used["t_s"] >= (history["t_s"][0] if len(history) else 0.0))]
    if not len(used):
        return np.empty(0)
    truth, t_s = history["truth"], history["t_s"]
    r, v = (
        np.column_stack([np.interp(used["t_s"], t_s, truth[name][:, i]) for i in range(3)])
        for name in ("r_CT_H", "v_CT_H")
    )
    q = truth["q_CH"][np.searchsorted(t_s, used["t_s"]).clip(max=len(t_s) - 1)]
    z, u, w = used["z_TC_C"], q[:, :3], q[:, 3:]
    cross = 2.0 * np.cross(u, z)
    behind = r + z + w * cross + np.cross(u, cross)  # r_CT_H - (-A(q_CH).T z_TC_C)
    windows = np.floor(used["t_s"] / _POSE_WINDOW_S)
    delays = []
    for window in np.unique(windows):
        chosen = windows == window
        if np.count_nonzero(chosen) >= _LEAST_SAMPLES:
            delays += _delay_of_window(behind[chosen].ravel(), v[chosen].ravel(), 0)
    return np.array(delays)


def _delay_of_window(behind: Array, speed: Array, axis: int) -> list[float]:
    """Return the delay, s, of a window as a list of one; empty if the motion is too slow or does not fit."""
    square = float(speed @ speed)
    if not square >= len(speed) * _SLOWEST[axis // 3] ** 2:
        return []
    delay = float(behind @ speed) / square
    rest = behind - delay * speed
    sigma = math.sqrt(float(rest @ rest) / (len(speed) - 1) / square)
    return [delay] if sigma <= _SIGMA_MAX_S else []


def _of_axis(rows: np.ndarray, axis: int) -> tuple[Array, Array, Array]:
    """Return times of the encoder's samples, its lag behind the setpoint at them, and its speed."""
    i, position, rate = (axis, "rail_m", "rail_mps") if axis < 3 else (axis - 3, "gimbal_rad", "gimbal_radps")
    setpoint, measured, setpoint_s = rows["setpoint"], rows["feedback"][position][:, i], rows["t_s"]
    sampled = rows["sampled_s"][:, axis // 3] >= (setpoint_s[0] if len(rows) else 0.0)
    t_s = rows["sampled_s"][sampled, axis // 3]
    if not len(t_s):
        return t_s, t_s, t_s
    behind = np.interp(t_s, setpoint_s, setpoint[position][:, i]) - measured[sampled]
    return t_s, behind, np.interp(t_s, setpoint_s, setpoint[rate][:, i])


def percentiles(values: Array) -> dict[str, float | None]:
    """Return p50, p99 and max, None without values."""
    if not len(values) or not np.isfinite(values).all():
        return {"p50": None, "p99": None, "max": None}
    p50, p99, largest = np.percentile(values, [50.0, 99.0, 100.0])
    return {"p50": float(p50), "p99": float(p99), "max": float(largest)}


NAMES: Final = ("cycle", "rails", "turntable", "vmu", "io")
_SAMPLE_PERIODS: Final = 2.0  # of the cycle: the limit of a sample's age, unless the rig file sets it
_LATE_STAMP_S: Final = 1e-3  # a command is stamped just after its lines were passed on


def execution_times_s(history: np.ndarray) -> dict[str, Array]:
    """Return the times in the rows (n,) of CYCLE, s of bench time, by what they are of."""
    begun_s = history["t_s"] + np.nan_to_num(history["lateness_s"])  # in lock-step it has none
    return {
        "cycle": history["commanded_s"] - begun_s,
        "rails": begun_s - history["sampled_s"][:, 0],
        "turntable": begun_s - history["sampled_s"][:, 1],
        "vmu": vmu_columns.travel_s(history),
        "io": _acknowledged_s(history),
    }


def _acknowledged_s(history: np.ndarray) -> Array:
    """Return a time for each command that changed a line and is known within the next two rows."""
    on, wire_s, commanded_s = history["command"]["on"], history["on_wire_s"], history["commanded_s"]
    k = 1 + np.flatnonzero((on[1:-2] != on[:-3]).any(axis=1)) if len(history) > 3 else np.empty(0, int)
    sent_s = commanded_s[k]
    next_s, later_s = wire_s[k + 1], wire_s[k + 2]
    times: Array = np.where(next_s >= sent_s - _LATE_STAMP_S, next_s, later_s) - sent_s
    return times[np.isfinite(times) & (times >= -_LATE_STAMP_S)]


def limits_s(rig: Rig, step_s: float) -> dict[str, float]:
    """Return the limit of each time, s: of the cycle its period, of a pose the time-out of its unit."""
    exchange_s = _SAMPLE_PERIODS * step_s if rig.host.exchange_max_s is None else rig.host.exchange_max_s
    return dict.fromkeys(NAMES, exchange_s) | {"cycle": step_s, "vmu": rig.vmu.timeout_s}


def judge_times(times_s: Mapping[str, Array], beyond: Mapping[str, int], rig: Rig, step_s: float) -> DeviceResults:
    """Return the times of each device against its limit. beyond: number of times above their limits."""
    judged = {}
    for name, limit_s in limits_s(rig, step_s).items():
        times = {f"{key}_ms": value for key, value in percentiles(1e3 * times_s[name]).items()}
        judged[name] = times | {"limit_ms": 1e3 * limit_s, "beyond": beyond[name]}
    return DeviceResults.of(judged)


def count_beyond(times_s: Mapping[str, Array], rig: Rig, step_s: float) -> dict[str, int]:
    """Return how many of the times are above their limits."""
    return {name: int(np.count_nonzero(times_s[name] > limit_s)) for name, limit_s in limits_s(rig, step_s).items()}
