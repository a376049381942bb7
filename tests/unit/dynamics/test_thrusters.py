"""Thrusters: valves, wrench and propellant."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.config.scenario import Scenario
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import truth as kernels
from hil.dynamics.thrusters import propellant_flow, wrench
from hil.dynamics.truth import TRUTH_MEMORY
from hil.models.valves import step_valves
from hil.params import dynamics as dynamics_params

NO_FIELD = np.zeros((1, 1, 6))  # the linear model reads no gravity field
DT_S = 0.02


def fractions(commands: list[int], minimum_on_s: float) -> list[float]:
    """Return the open part of each step for one valve."""
    open_s, fraction = np.zeros(1), np.zeros(1)
    found = []
    for on in commands:
        step_valves(np.array([on]), open_s, minimum_on_s, DT_S, fraction)
        found.append(float(fraction[0]))
    return found


def test_valve_follows_its_command_when_steps_are_longer_than_the_minimum() -> None:
    assert fractions([0, 1, 0, 1, 1, 0], 0.01) == [0, 1, 0, 1, 1, 0]


def test_valve_stays_open_for_its_minimum_time_down_to_a_part_of_a_step() -> None:
    assert fractions([1, 0, 0, 0], 0.05) == pytest.approx([1.0, 1.0, 0.5, 0.0])
    assert fractions([1, 0, 0], 0.025) == pytest.approx([1.0, 0.25, 0.0])


def test_valve_that_has_been_open_long_enough_closes_at_once() -> None:
    assert fractions([1, 1, 1, 0, 0], 0.05) == [1, 1, 1, 0, 0]


def test_second_pulse_has_its_own_minimum_time() -> None:
    assert fractions([1, 0, 0, 0, 1, 0, 0, 0], 0.05) == pytest.approx([1, 1, 0.5, 0, 1, 1, 0.5, 0])


@given(st.lists(st.integers(0, 1), min_size=1, max_size=30), st.floats(0.0, 0.2))
def test_every_pulse_lasts_the_minimum_and_no_command_is_cut(commands: list[int], minimum_on_s: float) -> None:
    found = fractions([*commands, *[0] * 12], minimum_on_s)
    for on, fraction in zip(commands, found, strict=False):
        assert 0.0 <= fraction <= 1.0
        assert not on or fraction == 1.0
    pulse_s = 0.0
    for fraction in found:
        if fraction > 0.0:
            pulse_s += fraction * DT_S
        elif pulse_s > 0.0:
            assert pulse_s >= minimum_on_s - 1e-9
            pulse_s = 0.0
    assert pulse_s == 0.0


def test_wrench_is_the_sum_of_forces_and_of_their_moments(rng: np.random.Generator) -> None:
    n = 7
    position, direction = rng.standard_normal((n, 3)), rng.standard_normal((n, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    size, fraction = rng.uniform(1.0, 9.0, n), rng.uniform(0.0, 1.0, n)
    fraction[2] = 0.0
    force, torque = np.empty(3), np.empty(3)
    wrench(fraction, position, direction, size, n, force, torque)
    each = (fraction * size)[:, None] * direction
    np.testing.assert_allclose(force, each.sum(axis=0), atol=1e-13)
    np.testing.assert_allclose(torque, np.cross(position, each).sum(axis=0), atol=1e-13)


def test_propellant_is_thrust_times_time_over_exhaust_speed(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    on = np.zeros(MAX_THRUSTERS, dtype=np.int64)
    on[[0, 5, 9]] = 1
    steps = 250
    for _ in range(steps):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, on)
    thrusters = plain_1.chaser.thrusters
    expected = 3 * thrusters.force_n * steps * plain_1.step_s / (thrusters.specific_impulse_s * 9.80665)
    assert plain_1.chaser.mass_kg - truth.mass_kg == pytest.approx(expected, rel=1e-9)


def test_propellant_flow_counts_the_open_part_of_the_step() -> None:
    fraction, force = np.array([0.5, 0.0, 1.0]), np.array([4.0, 4.0, 10.0])
    assert propellant_flow(fraction, force, 2000.0, 3) == pytest.approx(12.0 / 2000.0)
    assert propellant_flow(fraction, force, 2000.0, 1) == pytest.approx(2.0 / 2000.0)
