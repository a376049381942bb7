"""Evidence about the IMU: wrong readings stand out from a swing of the chaser and from sound ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hil.core.messages import new
from hil.gnc import evidence
from hil.gnc.evidence import CYCLES, EVIDENCE_STATE, ROWS

STEP_S = 0.02


def weighed(reading: Callable[[float], np.ndarray], seconds: float, odd_from_s: float = 0.0) -> bool:
    """Return whether the IMU is named after residuals ``reading`` (6,) of the time, which nothing explains."""
    state = new(EVIDENCE_STATE)
    for cycle in range(round(seconds / STEP_S)):
        t_s = cycle * STEP_S
        evidence.keep(state, reading(t_s), np.zeros(16), 16, t_s >= odd_from_s)
    return bool(evidence.names_imu(state))


@pytest.mark.parametrize("frequencies_hz", [(0.1,), (0.6,), (2.4,), (0.11, 2.4)])
@pytest.mark.parametrize("component", [1, 4])
def test_chaser_that_swings_by_one_or_two_modes_does_not_name_the_imu(
    frequencies_hz: tuple[float, ...], component: int, rng: np.random.Generator
) -> None:
    def swing(t_s: float) -> np.ndarray:
        out = 0.02 * rng.standard_normal(6)
        out[component] += sum(np.sin(2.0 * np.pi * f * t_s + 0.3) for f in frequencies_hz)
        return np.asarray(out)

    assert not weighed(swing, 15.0)


@pytest.mark.parametrize("component", [0, 5])
def test_reading_that_stays_on_its_side_names_the_imu_after_a_second(component: int, rng: np.random.Generator) -> None:
    def biased(t_s: float) -> np.ndarray:
        out = 0.02 * rng.standard_normal(6)
        out[component] += 0.5 if t_s >= 10.0 else 0.0
        return np.asarray(out)

    assert weighed(biased, 11.0, 10.0)
    assert not weighed(biased, 10.0, 10.0)


def test_noise_beyond_what_thrusters_explain_names_the_imu(rng: np.random.Generator) -> None:
    assert weighed(lambda _: 3.0 * rng.standard_normal(6), 10.0)


def test_small_residuals_name_nothing_and_the_oldest_are_forgotten(rng: np.random.Generator) -> None:
    assert not weighed(lambda _: 0.1 * rng.standard_normal(6), 10.0)
    window_s = ROWS * CYCLES * STEP_S
    wrong = np.array([0.8, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert weighed(lambda t_s: wrong if t_s < 1.0 else np.zeros(6), window_s - 1.0)
    assert not weighed(lambda t_s: wrong if t_s < 1.0 else np.zeros(6), window_s + 2.0)


SIGNATURES = np.zeros((16, 6))
SIGNATURE = SIGNATURES[9] = np.array([-1.0, 0.0, 0.0, 0.0, -0.8, 0.0])
SIGNATURES[0] = np.array([-1.0, 0.0, 0.0, 0.0, 0.8, 0.0])  # fires with the other for a force without a torque


@pytest.mark.parametrize("opens", [True, False])
@pytest.mark.parametrize("swings", [False, True])
def test_thruster_that_fails_is_named_on_a_chaser_that_swings_and_one_that_does_not_fail_is_not(
    opens: bool, swings: bool, rng: np.random.Generator
) -> None:
    state, thrust, failed_s = new(EVIDENCE_STATE), np.zeros(16), 12.0
    for cycle in range(round(13.0 / STEP_S)):
        t_s = cycle * STEP_S
        thrust[9] = 1.0 if not opens and rng.uniform() < 0.2 else 0.0
        residual = 0.02 * rng.standard_normal(6)
        if swings:
            residual += np.array([0.6, 0.0, 0.0, 0.0, 0.4, 0.0]) * np.sin(2.0 * np.pi * 0.3 * t_s)
        if t_s >= failed_s:
            residual += SIGNATURE * (1.0 - thrust[9] if opens else -thrust[9])
        evidence.keep(state, residual, thrust, 16, False)
        named = evidence.names_thruster(state, SIGNATURES, 9, opens)
        assert not named or t_s >= failed_s or state.n <= 8
    assert named


def test_valves_of_a_pair_that_close_late_are_none_that_is_open(rng: np.random.Generator) -> None:
    state, thrust, closes = new(EVIDENCE_STATE), np.zeros(16), 0
    for cycle in range(round(13.0 / STEP_S)):
        closes = int(rng.integers(1, 7)) if cycle % 8 == 0 else closes
        thrust[0] = thrust[9] = 1.0 if cycle % 8 < closes else 0.0
        residual = 0.02 * rng.standard_normal(6) + 0.5 * (1.0 - thrust[0]) * (SIGNATURES[0] + SIGNATURES[9])
        evidence.keep(state, residual, thrust, 16, False)
    assert not evidence.names_thruster(state, SIGNATURES, 9, True)
