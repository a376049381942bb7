"""Known bending modes and slosh against the requirements: whether control can stay clear of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.config.load import Loaded
from hil.config.scenario import BUILT_IN, Scenario
from hil.errors import Problem
from hil.gnc.control import COAST_OF_TOLERANCE
from hil.params import gnc as gnc_params
from hil.params.control_rule import control_rule
from hil.params.modes import SHARE, part_of_coupling, swing_of


class ModeSwing(NamedTuple):
    """Swing of the hub by two smallest firings, of its worst axis, in ``unit`` and per second, with the limits."""

    mode: str
    frequency_hz: float
    axis: str
    unit: str
    swing: float
    allowed: float
    rate: float
    rate_allowed: float

    @property
    def is_in_band(self) -> bool:
        """Whether control would answer to a swing with the next firing."""
        return self.swing > self.allowed or self.rate > self.rate_allowed


def mode_swings(scenario: Scenario) -> list[ModeSwing]:
    """Return the swing of each known mode that is lighter than the vehicle. Raises ValueError as ``allocation``."""
    rule = control_rule(scenario, gnc_params.allocation(scenario.chaser)[1])
    tolerance, swings = rule.coast_max / COAST_OF_TOLERANCE, []
    for name, mode in scenario.gnc.modes.items():
        if part_of_coupling(scenario, mode) >= 1.0:
            continue
        off, rate = swing_of(scenario, mode).of_rate(rule.pulse_s * rule.acceleration)
        k = int(np.argmax(np.maximum(off / tolerance, rate / rule.rate_max)))
        axis, unit, scale = f"along {'xyz'[k % 3]}", "m", 1.0
        if k >= 3:
            axis, unit, scale = f"about {'xyz'[k - 3]}", "deg", np.degrees(1.0)
        numbers = (off[k], SHARE * tolerance[k], rate[k], SHARE * rule.rate_max[k])
        swings.append(ModeSwing(name, mode.frequency_hz, axis, unit, *(float(scale * each) for each in numbers)))
    return swings


def check_modes(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for each known mode that is heavier than the vehicle, or else lies in the band of control."""
    value = scenario.value
    if not value.gnc.modes or value.gnc.binary is not None or value.gnc.control.backend not in BUILT_IN["control"]:
        return []
    texts = {}
    for name, mode in value.gnc.modes.items():
        if (part := part_of_coupling(value, mode)) >= 1.0:
            couplings = f"couplings {list(mode.coupling)}, {list(mode.translation_coupling)}"
            texts[name] = f"{couplings}: {part:.3g} of the vehicle's inertia would swing, allowed less than 1"
    for each in mode_swings(value):
        if each.is_in_band:
            texts[each.mode] = (
                f"{each.frequency_hz:g} Hz lies in the band of control: smallest firings swing the hub {each.axis} by "
                f"{each.swing:.2g} {each.unit} and {each.rate:.2g} {each.unit}/s, allowed {each.allowed:.2g} and "
                f"{each.rate_allowed:.2g}"
            )
    return [scenario.problem(f"gnc.modes.{name}", text) for name, text in texts.items()]
