"""Delay and bandwidth of an axis from what it was told and where it went.

Two measurements. Small steps without feed-forward show the position loop: a dead time and a lag of
first order. Sines with their rate as feed-forward show what a moving setpoint meets: gain and phase
by frequency. The slope of the phase towards standstill is the delay that a setpoint taken ahead of
its time makes up for. Nothing here moves or reads anything.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from hil.core.messages import Array

DELAY_PHASE_RAD = 1.0  # sines that lag further, or are faster than so many times the slowest one, say nothing
DELAY_FREQUENCIES = 4.0  # of the slope at standstill
_LONGEST_LAG_S = 0.4
_QUARTER_TURN_RAD = 0.5 * math.pi
_FLAT_RAD = 1e-5  # added to the scatter of each phase: no sine is trusted more than that
_MINUS_3_DB = math.sqrt(0.5)


@dataclass(frozen=True)
class Series:
    """What was recorded of one axis, m or rad.

    commanded_s (n,): the moments that the setpoints ``position`` and ``rate`` (n,) belong to, s.
    measured_s (m,): when the encoder stood at ``measured`` (m,). All times rise.
    """

    commanded_s: Array
    position: Array
    rate: Array
    measured_s: Array
    measured: Array


@dataclass(frozen=True)
class StepFit:
    """Dead time and lag of first order; ``_sigma``: standard deviations; residual: rms, as a share of the step."""

    delay_s: float
    delay_sigma_s: float
    lag_s: float
    lag_sigma_s: float
    residual: float

    @property
    def bandwidth_hz(self) -> float:
        """-3 dB of the lag."""
        return 1.0 / (math.tau * self.lag_s)

    @property
    def bandwidth_sigma_hz(self) -> float:
        return self.bandwidth_hz * self.lag_sigma_s / self.lag_s


@dataclass(frozen=True)
class Point:
    """Response at one frequency: gain, phase, rad, not wrapped; residual: rms beside the sine, share of its size."""

    frequency_hz: float
    gain: float
    phase_rad: float
    phase_sigma_rad: float
    residual: float


@dataclass(frozen=True)
class SweepFit:
    """Delay of a slowly moving axis, s, below zero where it is ahead of its time.

    bandwidth_hz: -3 dB or a quarter turn of lag, None where that lies beyond the sines.
    residual: the largest of the points that the delay is taken from.
    """

    delay_s: float
    delay_sigma_s: float
    bandwidth_hz: float | None
    residual: float
    points: tuple[Point, ...]


def fit_step(series: Series) -> StepFit:
    """Return dead time and lag of an axis that was moved in steps without feed-forward.

    Setpoints are held until the next one. Raises ValueError where they carried a rate, or nothing moved.
    """
    if np.any(series.rate != 0.0):
        raise ValueError("steps with feed-forward do not show the lag")
    jumps = np.flatnonzero(np.diff(series.position))
    if not len(jumps):
        raise ValueError("the setpoint did not move")
    at_s, size = series.commanded_s[jumps + 1], np.diff(series.position)[jumps]
    span = float(np.ptp(series.position))
    since_s = series.measured_s[:, None] - at_s[None, :]

    def missing(parameters: Array) -> Array:
        """Return the residuals, share of the span, for dead time, lag, offset."""
        delay_s, lag_s, offset = parameters
        response = -np.expm1(-np.maximum(0.0, since_s - delay_s) / lag_s) @ size
        wrong: Array = (series.position[0] + offset * span + response - series.measured) / span
        return wrong

    lags = np.geomspace(0.002, _LONGEST_LAG_S, 12)
    delays = np.linspace(0.0, 0.1, 21)
    first = min(
        ((delay, lag) for delay in delays for lag in lags),
        key=lambda p: float(np.sum(missing(np.array([*p, 0.0])) ** 2)),
    )
    found = least_squares(
        missing,
        [*first, 0.0],
        bounds=([-0.1, 1e-4, -1.0], [0.5, 2.0 * _LONGEST_LAG_S, 1.0]),
        x_scale=[0.01, 0.01, 0.01],
    )
    sigma = _sigmas(found.jac, found.fun)
    return StepFit(
        delay_s=float(found.x[0]),
        delay_sigma_s=float(sigma[0]),
        lag_s=float(found.x[1]),
        lag_sigma_s=float(sigma[1]),
        residual=float(np.sqrt(np.mean(found.fun**2))),
    )


def _sigmas(jacobian: Array, residuals: Array) -> Array:
    """Return the standard deviations of parameters fitted to white noise."""
    freedom = max(1, len(residuals) - jacobian.shape[1])
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(np.sum(residuals**2)) / freedom
    sigma: Array = np.sqrt(np.diag(covariance))
    return sigma


def fit_sine(series: Series, frequency_hz: float) -> Point:
    """Return gain and phase, within half a turn, of an axis that was told a sine of ``frequency_hz``.

    Raises ValueError where the setpoint has no such sine in it.
    """
    told, _, _ = _sine(series.commanded_s, series.position, frequency_hz)
    went, sigma, rms = _sine(series.measured_s, series.measured, frequency_hz)
    if abs(told) == 0.0 or abs(told) < 0.1 * float(np.ptp(series.position)):
        raise ValueError(f"the setpoint has no sine of {frequency_hz:g} Hz")
    ratio = went / told
    return Point(
        frequency_hz=frequency_hz,
        gain=abs(ratio),
        phase_rad=float(np.angle(ratio)),
        phase_sigma_rad=min(math.pi, sigma / abs(went)) if abs(went) > 0.0 else math.pi,
        residual=rms / abs(told),
    )


def _sine(t_s: Array, values: Array, frequency_hz: float) -> tuple[complex, float, float]:
    """Return amplitude with phase at t = 0, the standard deviation of each part of it, and the rms of the rest."""
    turn = math.tau * frequency_hz * t_s
    basis = np.column_stack([np.cos(turn), -np.sin(turn), np.ones_like(turn)])
    parts, *_ = np.linalg.lstsq(basis, values, rcond=None)
    rest = values - basis @ parts
    return complex(parts[0], parts[1]), float(_sigmas(basis, rest)[0]), float(np.sqrt(np.mean(rest**2)))


def fit_sweep(points: Sequence[Point], setpoint_age_s: float = 0.0) -> SweepFit:
    """Return delay and bandwidth from the responses ``points``, of rising frequency.

    setpoint_age_s: by how much earlier than the moment they belong to the setpoints were sent; the
    bandwidth counts from there, the delay does not. Raises ValueError for fewer than two points.
    """
    if len(points) < 2:
        raise ValueError(f"{len(points)} sines: at least two are needed")
    phases = np.unwrap([point.phase_rad for point in points])
    unwrapped = tuple(
        Point(p.frequency_hz, p.gain, float(phase), p.phase_sigma_rad, p.residual)
        for p, phase in zip(points, phases, strict=True)
    )
    slow = _slow(unwrapped)
    delay_s, sigma_s = _delay(slow)
    return SweepFit(
        delay_s=delay_s,
        delay_sigma_s=sigma_s,
        bandwidth_hz=_bandwidth(unwrapped, setpoint_age_s),
        residual=max(point.residual for point in slow),
        points=unwrapped,
    )


def _slow(points: Sequence[Point]) -> Sequence[Point]:
    """Return the points that tell the slope of the phase at standstill, two at least."""
    fastest_hz = DELAY_FREQUENCIES * points[0].frequency_hz * (1.0 + 1e-9)
    slow = [p for p in points if abs(p.phase_rad) <= DELAY_PHASE_RAD and p.frequency_hz <= fastest_hz]
    return slow if len(slow) >= 2 else points[:2]


def _delay(slow: Sequence[Point]) -> tuple[float, float]:
    """Return the delay towards standstill, s, and its standard deviation.

    The phase is taken for ``-w delay - c w^3``; the second term is the first bend that lags give it.
    """
    w = math.tau * np.array([p.frequency_hz for p in slow])
    weight = 1.0 / np.hypot([p.phase_sigma_rad for p in slow], _FLAT_RAD)
    basis = -np.column_stack([w, w**3]) if len(slow) > 2 else -w[:, None]
    scale = np.linalg.norm(basis, axis=0)
    weighted = (basis / scale) * weight[:, None]
    phase = weight * np.array([p.phase_rad for p in slow])
    found, *_ = np.linalg.lstsq(weighted, phase, rcond=None)
    rest = phase - weighted @ found
    # no better than the scatter of the sines says, worse where the points do not lie on the curve
    excess = max(1.0, float(np.sum(rest**2)) / max(1, len(slow) - basis.shape[1]))
    variance = np.linalg.pinv(weighted.T @ weighted)[0, 0] * excess
    return float(found[0] / scale[0]), float(math.sqrt(variance) / scale[0])


def _bandwidth(points: Sequence[Point], setpoint_age_s: float) -> float | None:
    """Return the first frequency, between two points or at one, with -3 dB of gain or a quarter turn of lag."""
    lag = [-p.phase_rad + math.tau * p.frequency_hz * setpoint_age_s for p in points]
    crossings = [
        *_crossings(points, [p.gain - _MINUS_3_DB for p in points]),
        *_crossings(points, [_QUARTER_TURN_RAD - turn for turn in lag]),
    ]
    return min(crossings, default=None)


def _crossings(points: Sequence[Point], margin: Sequence[float]) -> list[float]:
    """Return where ``margin`` first falls to zero: a list of one, or of none."""
    if margin[0] <= 0.0:
        return [points[0].frequency_hz]
    for k in range(1, len(points)):
        if margin[k] <= 0.0:
            share = margin[k - 1] / (margin[k - 1] - margin[k])
            low, high = points[k - 1].frequency_hz, points[k].frequency_hz
            return [low + share * (high - low)]
    return []
