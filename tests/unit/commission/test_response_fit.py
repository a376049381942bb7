"""Delay and bandwidth found again in axes whose delay and bandwidth are known."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.models.servo import servo_step
from hil.parts.commissioning.response_fit import Series, SweepFit, fit_sine, fit_step, fit_sweep

DT = 0.02
KP, TAU = 25.0, 0.008  # of the shipped rails
FREQUENCIES = (0.5, 0.8, 1.25, 2.0, 3.15, 5.0, 8.0)


def steps(size: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return times and setpoints of eight steps to and fro."""
    t = DT * np.arange(300)
    return t, np.where((np.arange(300) // 30) % 2 == 1, size, 0.0)


def answer_of_first_order(
    t: np.ndarray, position: np.ndarray, at: np.ndarray, delay_s: float, lag_s: float
) -> np.ndarray:
    """Return where a lag of first order behind a dead time is at the times ``at``; setpoints are held."""
    x, out, now = position[0], [], t[0]
    events = sorted([*((s + delay_s, 0, p) for s, p in zip(t, position, strict=True)), *((s, 1, 0.0) for s in at)])
    held = position[0]
    for when, kind, value in events:
        x = held + (x - held) * math.exp(-max(0.0, when - now) / lag_s)
        now = max(now, when)
        if kind == 0:
            held = value
        else:
            out.append(x)
    return np.array(out)


def servo_answer(position: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return where the shipped rail is a period after each setpoint was sent."""
    n = np.ones(1)
    x, v, out = position[:1].copy(), np.zeros(1), []
    for wanted, speed in zip(position, rate, strict=True):
        servo_step(x, v, np.array([wanted]), np.array([speed]), KP * n, TAU * n, 0.5 * n, 0.6 * n, -9 * n, 9 * n, DT)
        out.append(x[0])
    return np.array(out)


def sweep(answer: Callable[[np.ndarray, np.ndarray, float], np.ndarray], noise: float = 0.0) -> SweepFit:
    """Return the fit to sines of 1 mm; ``answer`` gives the axis at the times of the setpoints."""
    rng = np.random.default_rng(5)
    points = []
    for f in FREQUENCIES:
        t = DT * np.arange(400)
        w = math.tau * f
        told = 1e-3 * np.sin(w * t)
        went = answer(t, told, w) + noise * rng.standard_normal(len(t))
        points.append(fit_sine(Series(t[100:], told[100:], told[100:], t[100:], went[100:]), f))
    return fit_sweep(points)


@pytest.mark.parametrize(("delay_s", "lag_s"), [(0.0, 0.04), (0.013, 0.04), (0.047, 0.03), (0.03, 0.1)])
def test_step_finds_dead_time_and_lag(delay_s: float, lag_s: float) -> None:
    t, position = steps()
    at = t + 0.007  # the encoder answers at moments of its own
    fit = fit_step(Series(t, position, np.zeros(300), at, answer_of_first_order(t, position, at, delay_s, lag_s)))
    assert fit.delay_s == pytest.approx(delay_s, abs=1e-5)
    assert fit.lag_s == pytest.approx(lag_s, rel=1e-3)
    assert fit.bandwidth_hz == pytest.approx(1.0 / (math.tau * lag_s), rel=1e-3)
    assert fit.residual < 1e-4


def test_step_reports_its_uncertainty() -> None:
    t, position = steps()
    clean = answer_of_first_order(t, position, t, 0.013, 0.04)
    rng = np.random.default_rng(3)
    fits = [fit_step(Series(t, position, np.zeros(300), t, clean + 3e-5 * rng.standard_normal(300))) for _ in range(12)]
    delays, lags = [fit.delay_s for fit in fits], [fit.lag_s for fit in fits]
    assert np.mean(delays) == pytest.approx(0.013, abs=0.002)
    assert np.mean(lags) == pytest.approx(0.04, abs=0.003)
    assert np.std(delays) == pytest.approx(np.mean([fit.delay_sigma_s for fit in fits]), rel=0.8)
    assert np.std(lags) == pytest.approx(np.mean([fit.lag_sigma_s for fit in fits]), rel=0.8)
    assert all(fit.residual == pytest.approx(0.03, rel=0.2) for fit in fits)


def test_step_of_the_shipped_servo_lies_near_its_gain() -> None:
    t, position = steps(2e-4)
    fit = fit_step(Series(t, position, np.zeros(300), t + DT, servo_answer(position, np.zeros(300))))
    # second order: a gain of 25/s behind a lag of 8 ms is 3 dB down at 4.9 Hz
    assert fit.bandwidth_hz == pytest.approx(4.9, rel=0.2)
    assert 0.004 < fit.delay_s < 0.016
    assert fit.residual < 0.05


def test_step_with_feed_forward_is_refused() -> None:
    t, position = steps()
    with pytest.raises(ValueError, match="feed-forward"):
        fit_step(Series(t, position, np.ones(300), t, position))


def test_step_that_never_came_is_refused() -> None:
    t, _ = steps()
    with pytest.raises(ValueError, match="did not move"):
        fit_step(Series(t, np.zeros(300), np.zeros(300), t, np.zeros(300)))


@pytest.mark.parametrize("delay_s", [-0.01, 0.0, 0.017, 0.06])
def test_sweep_finds_a_pure_delay(delay_s: float) -> None:
    fit = sweep(lambda t, told, w: 1e-3 * np.sin(w * (t - delay_s)))
    assert fit.delay_s == pytest.approx(delay_s, abs=1e-5)
    assert fit.residual < 1e-9


def test_sweep_finds_dead_time_and_lag_as_one_delay() -> None:
    delay_s, lag_s = 0.015, 0.012

    def answer(t: np.ndarray, told: np.ndarray, w: float) -> np.ndarray:
        return 1e-3 * np.sin(w * (t - delay_s) - math.atan(w * lag_s)) / math.hypot(1.0, w * lag_s)

    fit = sweep(answer)
    assert fit.delay_s == pytest.approx(delay_s + lag_s, abs=5e-4)
    assert math.tau * 8.0 * delay_s + math.atan(math.tau * 8.0 * lag_s) < math.pi / 2  # at the fastest sine
    assert fit.bandwidth_hz is None


def test_bandwidth_is_where_the_gain_falls_or_the_phase_lags_a_quarter_turn() -> None:
    lag_s = 0.05

    def of_first_order(t: np.ndarray, told: np.ndarray, w: float) -> np.ndarray:
        return 1e-3 * np.sin(w * t - math.atan(w * lag_s)) / math.hypot(1.0, w * lag_s)

    assert sweep(of_first_order).bandwidth_hz == pytest.approx(1.0 / (math.tau * lag_s), rel=0.03)
    assert sweep(lambda t, told, w: 1e-3 * np.sin(w * (t - 0.06))).bandwidth_hz == pytest.approx(0.25 / 0.06, rel=0.01)


def test_sweep_reports_its_uncertainty() -> None:
    fits = [sweep(lambda t, told, w: 1e-3 * np.sin(w * (t - 0.02)), noise=n) for n in (1e-5, 1e-4)]
    for fit in fits:
        assert abs(fit.delay_s - 0.02) < 4.0 * fit.delay_sigma_s
    assert fits[1].delay_sigma_s == pytest.approx(10.0 * fits[0].delay_sigma_s, rel=0.3)
    assert fits[1].residual == pytest.approx(0.1, rel=0.2)


def test_sampled_servo_with_feed_forward_runs_half_a_period_ahead_of_its_time() -> None:
    # setpoints are sent a period before their moment and held: on the average of a ramp half a period early
    ramp = 0.01 * DT * np.arange(400)
    lead_s = (servo_answer(ramp, np.full(400, 0.01)) - ramp)[-1] / 0.01
    assert lead_s == pytest.approx(0.5 * DT, abs=1e-3)
    points = []
    for f in FREQUENCIES:
        t = DT * np.arange(600)
        w = math.tau * f
        told, speed = 2e-4 * np.sin(w * t), 2e-4 * w * np.cos(w * t)
        went = servo_answer(told, speed)
        points.append(fit_sine(Series(t[200:], told[200:], speed[200:], t[200:], went[200:]), f))
    assert fit_sweep(points).delay_s == pytest.approx(-lead_s, abs=1.5e-4)


def test_undeclared_sine_is_refused() -> None:
    t = DT * np.arange(200)
    with pytest.raises(ValueError, match="no sine of 3 Hz"):
        fit_sine(Series(t, np.zeros(200), np.zeros(200), t, np.zeros(200)), 3.0)
