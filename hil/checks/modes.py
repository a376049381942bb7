"""Known bending modes and slosh against the requirements: whether control can stay clear of them."""

from __future__ import annotations

import numpy as np

from hil.config.load import Loaded
from hil.config.scenario import BUILT_IN, Scenario
from hil.errors import Problem
from hil.gnc.control import COAST_OF_TOLERANCE
from hil.params import gnc as gnc_params
from hil.params.control_rule import control_rule
from hil.params.modes import SHARE, part_of_coupling, swing_of


def check_modes(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for each known mode that is heavier than the vehicle, or lies in the band of control.

    It does where the smallest firings make the hub swing by more than a share of the requirement: control would answer
    to each swing with the next firing.
    """
    value, problems = scenario.value, []
    if not value.gnc.modes or value.gnc.binary is not None or value.gnc.control.backend not in BUILT_IN["control"]:
        return []
    rule = control_rule(value, gnc_params.allocation(value.chaser)[1])
    tolerance = rule.coast_max / COAST_OF_TOLERANCE
    for name, mode in value.gnc.modes.items():
        key = f"gnc.modes.{name}"
        if (part := part_of_coupling(value, mode)) >= 1.0:
            text = f"couplings {list(mode.coupling)}, {list(mode.translation_coupling)}: {part:.3g} of the vehicle's "
            problems.append(Problem(scenario.where(key), key, f"{text}inertia would swing, allowed less than 1"))
            continue
        off, rate = swing_of(value, mode).of_rate(rule.pulse_s * rule.acceleration)
        worst = int(np.argmax(np.maximum(off / tolerance, rate / rule.rate_max)))
        scale, unit = (np.degrees(1.0), "deg") if worst >= 3 else (1.0, "m")
        if off[worst] > SHARE * tolerance[worst] or rate[worst] > SHARE * rule.rate_max[worst]:
            text = (
                f"{mode.frequency_hz:g} Hz lies in the band of control: smallest firings swing the hub "
                f"{'about' if worst >= 3 else 'along'} {'xyz'[worst % 3]} by {scale * off[worst]:.2g} {unit} and "
                f"{scale * rate[worst]:.2g} {unit}/s, allowed {SHARE * scale * tolerance[worst]:.2g} and "
                f"{SHARE * scale * rule.rate_max[worst]:.2g}"
            )
            problems.append(Problem(scenario.where(key), key, text))
    return problems
