"""How long things took in a run: from a pose's last byte to the thrusters' command, from a setpoint to the encoder."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hil.messages import Array

_WINDOW_S = 1.0
_SLOWEST = (0.0005, math.radians(0.02))  # m/s and rad/s, rms: slower windows say nothing of a delay
_SIGMA_MAX_S = 0.002
_LEAST_SAMPLES = 10


def measure_latency(history: np.ndarray, step_s: float) -> dict[str, Any]:
    """Return p50, p99 and max, ms of bench time, of both ways; None where nothing was to be measured.

    ``pose_to_command_ms``: from the last byte of a pose's frame to the command of the cycle that used
    it. ``setpoint_to_encoder_ms``: from the sending of a setpoint to the encoder's arrival there, one
    value for each second in which an axis moved.
    """
    return {
        "pose_to_command_ms": _percentiles(1e3 * pose_to_command_s(history)),
        "setpoint_to_encoder_ms": _percentiles(1e3 * setpoint_to_encoder_s(history, step_s)),
    }


def pose_to_command_s(history: np.ndarray) -> Array:
    """Return a time for each cycle that used a pose, s."""
    used = history[history["pose"]["fresh"] > 0]
    taken: Array = used["commanded_s"] - used["received_s"]
    return taken


def setpoint_to_encoder_s(history: np.ndarray, step_s: float) -> Array:
    """Return a time for each axis and each window of a second in which it moved, s.

    A row's setpoint belongs to ``t_s`` and was sent a step earlier; its feedback was taken at
    ``sampled_s``. While an axis follows with a delay d, its encoder stands d times the speed behind:
    d is fitted to each window by least squares. Windows that leave it uncertain are left out.
    """
    rows = history[1:]  # the first setpoint of a run is its last one before it
    found = []
    window = max(_LEAST_SAMPLES, round(_WINDOW_S / step_s))
    for axis in range(6):
        setpoint, rate, t_s, encoder = _of_axis(rows, axis)
        for k in range(0, len(rows) - window, window):
            part = slice(k, k + window)
            behind = np.interp(t_s[part], rows["t_s"], setpoint) - encoder[part]
            speed = np.interp(t_s[part], rows["t_s"], rate)
            square = float(speed @ speed)
            if not square >= window * _SLOWEST[axis // 3] ** 2:
                continue
            delay = float(behind @ speed) / square
            rest = behind - delay * speed
            if math.sqrt(float(rest @ rest) / (window - 1) / square) <= _SIGMA_MAX_S:
                found.append(delay + step_s)
    return np.array(found)


def _of_axis(rows: np.ndarray, axis: int) -> tuple[Array, Array, Array, Array]:
    """Return setpoint and its rate by row, and the moments and values of the encoder."""
    i, place, rate = (axis, "rail_m", "rail_mps") if axis < 3 else (axis - 3, "gimbal_rad", "gimbal_radps")
    setpoint, feedback = rows["setpoint"], rows["feedback"]
    return setpoint[place][:, i], setpoint[rate][:, i], rows["sampled_s"][:, axis // 3], feedback[place][:, i]


def _percentiles(values: Array) -> dict[str, float | None]:
    if not len(values) or not np.isfinite(values).all():
        return {"p50": None, "p99": None, "max": None}
    p50, p99, largest = np.percentile(values, [50.0, 99.0, 100.0])
    return {"p50": float(p50), "p99": float(p99), "max": float(largest)}
