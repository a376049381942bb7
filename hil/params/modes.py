"""Bending modes and slosh that the GNC accounts for: what firings make of them, and how control stays clear of them.

A mode with the part f of an axis's inertia, or mass, and the frequency Omega on a hub that does not move swings with
Omega / sqrt(1 - f). A firing that changes the rate by d makes the hub swing by f / (1 - f) d about it (Likins, JPL
TR 32-1329). Two firings may add, so the limit cycle and corrections count twice.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from hil.config.scenario import Scenario
from hil.config.tables.truth import KnownMode
from hil.core.messages import Array
from hil.maths import linear
from hil.maths.elementary import square

SHARE: Final = 0.5
"""Of a tolerance of the requirements, that the swing after two firings may take."""
_FIRINGS: Final = 2.0


class Swing(NamedTuple):
    """Swing of the hub after a change of its rate, per axis, (6,): ratio of the rates, and frequency, rad/s."""

    ratio: Array
    frequency: Array

    def of_rate(self, rate: Array | float) -> tuple[Array, Array]:
        """Return the amplitudes, (6,), in m, rad and m/s, rad/s, after two changes of ``rate``, m/s, rad/s."""
        swings = _FIRINGS * self.ratio * rate
        return swings / self.frequency, swings


def swing_of(scenario: Scenario, mode: KnownMode) -> Swing:
    """Return the swing of ``mode`` at the lowest frequency that its standard deviation leaves.

    A coupling delta to the rotation, of less than the whole inertia, swings axis j by delta_j delta_i / (J_j (1 - f))
    after a firing about axis i.
    """
    chaser = scenario.chaser
    of_row = np.concatenate([np.full(3, chaser.mass_kg), np.diag(np.array(chaser.inertia_kg_m2))])
    coupling = np.abs([mode.translation_coupling, mode.coupling])
    by_coupling = (coupling * coupling.max(axis=1, keepdims=True)).ravel() / of_row
    given, part = np.array([*mode.mass_fraction, *mode.inertia_fraction]), part_of_coupling(scenario, mode)
    omega = 2.0 * math.pi * mode.frequency_hz * (1.0 - 2.0 * mode.frequency_sigma)
    ratio = by_coupling / (1.0 - part) + given / (1.0 - given)
    return Swing(ratio, omega / np.sqrt(1.0 - np.maximum(part, given)))


def part_of_coupling(scenario: Scenario, mode: KnownMode) -> float:
    """Return the part of the whole vehicle's inertia, in the direction of the couplings, that swings in ``mode``."""
    chaser, coupling, moving = scenario.chaser, np.array(mode.coupling), np.array(mode.translation_coupling)
    turning = linear.product(coupling, linear.solve(chaser.inertia_kg_m2, coupling))
    return float(turning + linear.product(moving, moving) / chaser.mass_kg)


def moves(scenario: Scenario) -> bool:
    """Return whether a known mode moves the centre of the hub: without thrust the specific force is not known then."""
    return any(any(mode.mass_fraction) or any(mode.translation_coupling) for mode in scenario.gnc.modes.values())


def swing_allowance(scenario: Scenario, pulse: Array, lead_s: Array) -> Array:
    """Return by how much modes widen the dead bands, (6,), m, rad. pulse: smallest firing, m/s, rad/s."""
    total = np.zeros(6)
    for mode in scenario.gnc.modes.values():
        off, rate = swing_of(scenario, mode).of_rate(pulse)
        total += np.sqrt(square(off) + square(lead_s * rate))
    return total


def correction_rates(scenario: Scenario, rates: Array, tolerance: Array, rate_max: Array) -> Array:
    """Return ``rates`` (6,), m/s, rad/s, at most those after which no mode swings beyond part of the tolerances."""
    most = np.asarray(rates, dtype=float)
    for mode in scenario.gnc.modes.values():
        off, rate = swing_of(scenario, mode).of_rate(1.0)
        off, rate = np.maximum(off, 1e-300), np.maximum(rate, 1e-300)
        most = np.minimum(most, SHARE * np.minimum(tolerance / off, rate_max / rate))
    return most
