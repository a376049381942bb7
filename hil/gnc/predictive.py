"""Predictive law of an axis: the least change of rate that keeps the error within the dead band over three leads.

An axis is a double integrator with impulses ``u_i`` at 0, tau and 2 tau, tau the lead of the rule of control. With the
error ``e`` and its rate, at ``t_j = tau, 2 tau, 3 tau``,

    min sum |u_i|   with   |e + t_j e_dot + sum_(i < j) (t_j - t_i) u_i| <= b_j

where ``b_1`` is the dead band of the phase plane, and the others are the noise of the prediction, or what the smallest
burn moves it by, and the coast: a later burn can still correct what half of one leaves. An error outside its band is
the phase plane's. Nothing is fired if no bound is violated, and only the first impulse is: the program is solved again
in the next decision (Mayne et al., Automatica 36 (2000) 789-814, for receding horizons).
"""

from __future__ import annotations

import math
from typing import Final

from hil.core.jit import kernel
from hil.maths import stack
from hil.maths.linear_program import minimise

STEPS: Final = 3
"""Impulses, and bounds after them."""


@kernel
def write_program(error, rate, lead, bands, tableau):
    """Write the program into ``tableau`` (7, 7), in units of ``lead`` times an impulse; return whether 0 violates it.

    error, rate: m, m/s or rad, rad/s. bands: (3,), m or rad. Columns: positive, then negative parts of the impulses.
    """
    violated = False
    for j in range(STEPS):
        predicted = error + (j + 1) * lead * rate
        for i in range(STEPS):
            weight = max(0.0, j + 1.0 - i)
            tableau[j, i] = tableau[STEPS + j, STEPS + i] = weight
            tableau[j, STEPS + i] = tableau[STEPS + j, i] = -weight
        tableau[j, 2 * STEPS] = bands[j] - predicted
        tableau[STEPS + j, 2 * STEPS] = bands[j] + predicted
        violated = violated or abs(predicted) > bands[j]
    for i in range(2 * STEPS):
        tableau[2 * STEPS, i] = 1.0
    tableau[2 * STEPS, 2 * STEPS] = 0.0
    return violated


@kernel
def first_impulse(error, rate, lead, bands):
    """Return the first impulse of the program, m/s or rad/s; arguments: see ``write_program``."""
    tableau, columns, basis = stack.matrix(7, 7), stack.vector(6), stack.vector(6)
    if not write_program(error, rate, lead, bands, tableau) or not minimise(tableau, columns, basis):
        return 0.0
    first = 0.0
    for i in range(2 * STEPS):
        if basis[i] == 0.0:
            first += tableau[i, 2 * STEPS]
        elif basis[i] == STEPS:
            first -= tableau[i, 2 * STEPS]
    return first / lead


@kernel
def predicted_burn(error, rate, acceleration, lead, bands, shortest):
    """Return for how long to fire, s, negative against a positive error; 0 if the error stays within its bounds.

    error: within the first of ``bands`` (3,), m or rad; from outside it would be braked before it has returned.
    shortest: least time of a firing, s.
    """
    impulse = first_impulse(error, rate, lead, bands)
    if impulse == 0.0:
        return 0.0
    return math.copysign(abs(impulse) / acceleration + shortest, impulse)
