"""Error model of the thrusters: impulse of firings, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import TRUTH, new
from hil.dynamics.thruster_faults import THRUST_MEMORY, step_real_valves
from hil.params import dynamics as dynamics_params

DT = 0.02


def thrust(commands: list[int], *settings: str, used_kg: float = 0.0, seed: int = 3) -> np.ndarray:
    """Return the mean thrust over nominal thrust of thruster 1 in each step of ``commands``."""
    scenario = load_scenario("scheme-1", settings).value
    params, truth, memory = dynamics_params.dss(scenario, None, seed), new(TRUTH), new(THRUST_MEMORY)
    truth.mass_kg = scenario.chaser.mass_kg - used_kg
    n, found = params.n_thrusters, []
    for k, command in enumerate(commands):
        truth.t_s = k * DT
        on, fraction = np.zeros(n, np.int64), np.zeros(n)
        on[0] = command
        step_real_valves(
            params.thruster_faults, params.thruster_errors, memory, truth, on, params.minimum_on_s, DT, fraction
        )  # fmt: skip
        found.append(fraction[0])
    return np.array(found)


BURST = [0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]


def test_delay_shifts_a_firing_by_its_time_and_keeps_its_impulse() -> None:
    found = thrust(BURST, "chaser.thrusters.errors.delay_s=0.05")
    np.testing.assert_allclose(found[:8], [0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 0.5, 0.0], atol=1e-12)


def test_minimum_on_time_need_not_be_a_multiple_of_the_cycle_even_when_delayed() -> None:
    settings = ("chaser.thrusters.minimum_on_s=0.033", "chaser.thrusters.errors.delay_s=0.013")
    found = thrust([1, 0, 0, 0, 0], *settings)
    np.testing.assert_allclose(found * DT, [0.007, 0.02, 0.006, 0.0, 0.0], atol=1e-12)


def test_rise_and_tail_off_have_the_impulse_of_first_order_lags() -> None:
    rise, tail = 0.012, 0.03
    found = thrust(
        BURST, f"chaser.thrusters.errors.rise_s={rise}", f"chaser.thrusters.errors.tail_off_s={tail}"
    )  # fmt: skip
    first = 1.0 - rise / DT * (1.0 - math.exp(-DT / rise))
    assert found[1] == pytest.approx(first, rel=1e-12)
    level = 1.0 - math.exp(-3.0 * DT / rise)
    total = 3.0 * DT - rise * level + tail * level
    assert found.sum() * DT == pytest.approx(total, abs=tail * 1.1e-3)
    assert found[-1] == 0.0  # the tail ends


def test_scatter_is_that_of_firings_of_the_minimum_on_time_and_less_in_longer_ones() -> None:
    settings = ("chaser.thrusters.minimum_on_s=0.03", "chaser.thrusters.errors.impulse_scatter_sigma=0.1")
    short = thrust([1, 0, 0, 0] * 1000, *settings).reshape(-1, 4).sum(axis=1) * DT / 0.03
    long = thrust([1, 1, 1, 1, 1, 1, 0, 0] * 500, *settings).reshape(-1, 8).sum(axis=1) * DT / 0.12
    assert short.mean() == pytest.approx(1.0, abs=0.01)
    assert short.std() == pytest.approx(0.1, abs=0.008)
    assert long.std() == pytest.approx(0.1 * 0.03 / 0.12, abs=0.003)


def test_pressure_halves_when_its_propellant_is_used() -> None:
    setting = "chaser.thrusters.errors.half_pressure_kg=8.0"
    assert thrust([1], setting)[0] == 1.0
    assert thrust([1], setting, used_kg=8.0)[0] == pytest.approx(0.5)
    assert thrust([1], setting, used_kg=24.0)[0] == pytest.approx(0.25)
