"""Delay and bandwidth of an axis, fitted to recorded setpoints and encoder samples.

Two measurements. Small steps without feed-forward identify the position loop: dead time and first-order lag. Sines
with their rate as feed-forward identify the response to a moving setpoint: gain and phase over frequency. The slope of
the phase at zero frequency is the delay that the lead of the setpoints compensates. No I/O.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from hil.core.messages import Array

DELAY_PHASE_RAD = 1.0  # largest lag of the sines used for the slope at zero frequency
DELAY_FREQUENCIES = 4.0  # largest ratio of their frequency to the lowest one
_LONGEST_LAG_S = 0.4
_QUARTER_TURN_RAD = 0.5 * math.pi
_FLAT_RAD = 1e-5  # added to the standard deviation of each phase, a lower bound
_MINUS_3_DB = math.sqrt(0.5)


@dataclass(frozen=True)
class Series:
    """Recorded setpoints and encoder samples of one axis, m or rad.

    commanded_s (n,): times of the setpoints ``position`` and ``rate`` (n,), s. measured_s (m,): times of the encoder
    samples ``measured`` (m,). All times increase.
    """

    commanded_s: Array
    position: Array
    rate: Array
    measured_s: Array
    measured: Array


@dataclass(frozen=True)
class StepFit:
    """Dead time and first-order lag; ``_sigma``: standard deviations; residual: rms relative to the step."""

    delay_s: float
    delay_sigma_s: float
    lag_s: float
    lag_sigma_s: float
    residual: float

    @property
    def bandwidth_hz(self) -> float:
        """-3 dB bandwidth of the lag."""
        return 1.0 / (math.tau * self.lag_s)

    @property
    def bandwidth_sigma_hz(self) -> float:
        return self.bandwidth_hz * self.lag_sigma_s / self.lag_s


@dataclass(frozen=True)
class Point:
    """Response at one frequency: gain, unwrapped phase, rad; residual: rms relative to the amplitude."""

    frequency_hz: float
    gain: float
    phase_rad: float
    phase_sigma_rad: float
    residual: float


@dataclass(frozen=True)
class SweepFit:
    """Delay of a slowly moving axis, s, negative if the axis leads.

    bandwidth_hz: -3 dB or 90 degrees of lag, None beyond the measured frequencies. residual: largest of the points used
    for the delay.
    """

    delay_s: float
    delay_sigma_s: float
    bandwidth_hz: float | None
    residual: float
    points: tuple[Point, ...]


def fit_step(series: Series) -> StepFit:
    """Return dead time and lag of an axis moved in steps without feed-forward.

    Setpoints are held until the next one. Raises ValueError if they have a rate or do not move.
    """
    if np.any(series.rate != 0.0):
        raise ValueError("steps with feed-forward do not identify the lag")
    jumps = np.flatnonzero(np.diff(series.position))
    if not len(jumps):
        raise ValueError("the setpoint did not move")
    at_s, size = series.commanded_s[jumps + 1], np.diff(series.position)[jumps]
    span = float(np.ptp(series.position))
    since_s = series.measured_s[:, None] - at_s[None, :]

    def residuals(parameters: Array) -> Array:
        """Return the residuals, relative to the span, for dead time, lag and offset."""
        delay_s, lag_s, offset = parameters
        response = -np.expm1(-np.maximum(0.0, since_s - delay_s) / lag_s) @ size
        difference: Array = (series.position[0] + offset * span + response - series.measured) / span
        return difference

    lags = np.geomspace(0.002, _LONGEST_LAG_S, 12)
    delays = np.linspace(0.0, 0.1, 21)
    first = min(
        ((delay, lag) for delay in delays for lag in lags),
        key=lambda p: float(np.sum(residuals(np.array([*p, 0.0])) ** 2)),
    )
    solution = least_squares(
        residuals,
        [*first, 0.0],
        bounds=([-0.1, 1e-4, -1.0], [0.5, 2.0 * _LONGEST_LAG_S, 1.0]),
        x_scale=[0.01, 0.01, 0.01],
    )
    sigma = _sigmas(solution.jac, solution.fun)
    return StepFit(
        delay_s=float(solution.x[0]),
        delay_sigma_s=float(sigma[0]),
        lag_s=float(solution.x[1]),
        lag_sigma_s=float(sigma[1]),
        residual=float(np.sqrt(np.mean(solution.fun**2))),
    )


def _sigmas(jacobian: Array, residuals: Array) -> Array:
    """Return the standard deviations of parameters fitted to white noise."""
    freedom = max(1, len(residuals) - jacobian.shape[1])
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(np.sum(residuals**2)) / freedom
    sigma: Array = np.sqrt(np.diag(covariance))
    return sigma


def fit_sine(series: Series, frequency_hz: float) -> Point:
    """Return gain and phase, -pi..pi, of an axis with a sine of ``frequency_hz`` as setpoint.

    Raises ValueError if the setpoint contains no such sine.
    """
    setpoint, _, _ = _sine(series.commanded_s, series.position, frequency_hz)
    encoder, sigma, rms = _sine(series.measured_s, series.measured, frequency_hz)
    if abs(setpoint) == 0.0 or abs(setpoint) < 0.1 * float(np.ptp(series.position)):
        raise ValueError(f"the setpoint has no sine of {frequency_hz:g} Hz")
    ratio = encoder / setpoint
    return Point(
        frequency_hz=frequency_hz,
        gain=abs(ratio),
        phase_rad=float(np.angle(ratio)),
        phase_sigma_rad=min(math.pi, sigma / abs(encoder)) if abs(encoder) > 0.0 else math.pi,
        residual=rms / abs(setpoint),
    )


def _sine(t_s: Array, values: Array, frequency_hz: float) -> tuple[complex, float, float]:
    """Return the complex amplitude at t = 0, the standard deviation of each part, and the rms of the residual."""
    angle = math.tau * frequency_hz * t_s
    basis = np.column_stack([np.cos(angle), -np.sin(angle), np.ones_like(angle)])
    parts, *_ = np.linalg.lstsq(basis, values, rcond=None)
    rest = values - basis @ parts
    return complex(parts[0], parts[1]), float(_sigmas(basis, rest)[0]), float(np.sqrt(np.mean(rest**2)))


def fit_sweep(points: Sequence[Point], setpoint_age_s: float = 0.0) -> SweepFit:
    """Return delay and bandwidth from the responses ``points``, in order of frequency.

    setpoint_age_s: time by which the setpoints were sent in advance; the bandwidth includes it, the delay does not.
    Raises ValueError for fewer than two points.
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
    """Return the points used for the slope of the phase at zero frequency, at least two."""
    fastest_hz = DELAY_FREQUENCIES * points[0].frequency_hz * (1.0 + 1e-9)
    slow = [p for p in points if abs(p.phase_rad) <= DELAY_PHASE_RAD and p.frequency_hz <= fastest_hz]
    return slow if len(slow) >= 2 else points[:2]


def _delay(slow: Sequence[Point]) -> tuple[float, float]:
    """Return the delay at zero frequency, s, and its standard deviation.

    The phase is modelled as ``-w delay - c w^3``; the second term is the leading curvature of lags.
    """
    w = math.tau * np.array([p.frequency_hz for p in slow])
    weight = 1.0 / np.hypot([p.phase_sigma_rad for p in slow], _FLAT_RAD)
    basis = -np.column_stack([w, w**3]) if len(slow) > 2 else -w[:, None]
    scale = np.linalg.norm(basis, axis=0)
    weighted = (basis / scale) * weight[:, None]
    phase = weight * np.array([p.phase_rad for p in slow])
    coefficients, *_ = np.linalg.lstsq(weighted, phase, rcond=None)
    rest = phase - weighted @ coefficients
    # at least the scatter of the sines, larger if the points deviate from the model
    excess = max(1.0, float(np.sum(rest**2)) / max(1, len(slow) - basis.shape[1]))
    variance = np.linalg.pinv(weighted.T @ weighted)[0, 0] * excess
    return float(coefficients[0] / scale[0]), float(math.sqrt(variance) / scale[0])


def _bandwidth(points: Sequence[Point], setpoint_age_s: float) -> float | None:
    """Return the lowest frequency, interpolated between points, with -3 dB of gain or 90 degrees of lag."""
    lag = [-p.phase_rad + math.tau * p.frequency_hz * setpoint_age_s for p in points]
    crossings = [
        *_crossings(points, [p.gain - _MINUS_3_DB for p in points]),
        *_crossings(points, [_QUARTER_TURN_RAD - angle for angle in lag]),
    ]
    return min(crossings, default=None)


def _crossings(points: Sequence[Point], margin: Sequence[float]) -> list[float]:
    """Return the frequency where ``margin`` first falls to zero, as a list of one or none."""
    if margin[0] <= 0.0:
        return [points[0].frequency_hz]
    for k in range(1, len(points)):
        if margin[k] <= 0.0:
            fraction = margin[k - 1] / (margin[k - 1] - margin[k])
            low, high = points[k - 1].frequency_hz, points[k].frequency_hz
            return [low + fraction * (high - low)]
    return []
