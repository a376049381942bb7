"""The gyros as a witness of a leak: a torque that lasts is one, bending and firings are none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import new
from hil.gnc.estimation import torque_witness
from hil.gnc.estimation.torque_witness import TORQUE_STATE
from hil.params.gnc import gnc as gnc_params

DT_S = 0.02
PARAMS = gnc_params(load_scenario("scheme-1").value).navigation.fusion.thrust.witness


def admitted(acceleration: np.ndarray, steady_radps: float = 0.0, fired: float = 0.0) -> np.ndarray:
    """Return what each step of ``acceleration`` (n, 3), rad/s^2, after one of steady rate, adds to the doubt, m/s^2."""
    state = new(TORQUE_STATE)
    state.fired = fired
    rates = steady_radps + np.cumsum(acceleration, axis=0) * DT_S
    return np.array([torque_witness.watch(PARAMS, state, rates[k - 1], rates[k], DT_S) for k in range(1, len(rates))])


def steps(seconds: float) -> int:
    return round(seconds / DT_S)


def leak(fraction: float) -> np.ndarray:
    """Return half a minute without and one with the torque of a thruster that leaks, (n, 3)."""
    acceleration = np.zeros((steps(90.0), 3))
    acceleration[steps(30.0) :, 2] = fraction * PARAMS.limit / 0.0017
    return acceleration


def test_a_torque_that_begins_admits_the_force_of_its_thruster_within_seconds() -> None:
    found = admitted(leak(0.01))
    first = int(np.flatnonzero(found)[0])
    assert 0.0 < first * DT_S - 30.0 < 6.0
    force = 0.01 * PARAMS.limit / 0.0017 * PARAMS.force
    assert 0.7 * force < math.sqrt(np.sum(found**2)) <= force


def test_a_torque_is_admitted_once() -> None:
    found = admitted(leak(0.01))
    assert not found[steps(55.0) :].any()


def test_no_more_is_admitted_than_what_accelerometers_do_not_show() -> None:
    assert math.sqrt(np.sum(admitted(leak(0.2)) ** 2)) <= PARAMS.most * PARAMS.force * (1.0 + 1e-9)


def test_bending_of_an_array_admits_nothing() -> None:
    t = np.arange(steps(120.0)) * DT_S
    bending = np.outer(5e-4 * np.cos(2.0 * math.pi * 0.25 * t) * np.minimum(1.0, t / 20.0), [0.3, 1.0, 0.2])
    assert not admitted(bending).any()


def test_firings_raise_what_bending_explains() -> None:
    state = new(TORQUE_STATE)
    for _ in range(steps(60.0)):
        torque_witness.count_firings(PARAMS, state, np.array([0.0, 30.0 * PARAMS.limit, 0.0]))
    assert state.fired == pytest.approx(30.0 * PARAMS.limit, rel=0.2)
    acceleration = np.zeros((steps(40.0), 3))
    acceleration[1:, 1] = 1.5 * PARAMS.limit
    assert admitted(acceleration).any()
    assert not admitted(acceleration, fired=float(state.fired)).any()


def test_a_chaser_that_turns_with_its_target_admits_what_its_inertia_tensor_explains_as_nothing() -> None:
    acceleration = np.zeros((steps(60.0), 3))
    acceleration[steps(20.0) :, 1] = 4.0 * PARAMS.limit
    assert admitted(acceleration).any()
    assert not admitted(acceleration, steady_radps=0.02).any()
