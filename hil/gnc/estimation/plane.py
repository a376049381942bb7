"""Filters of a chaser that is held in the x-z plane of H: position along y and rotation about x and z are known.

What is known has no error: after the start and after each step its estimate is the plane's and its covariance zero. A
pose corrects the other states alone, and what it measures out of the plane is an error of its own.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import entry, kernel
from hil.gnc.estimation.error_state import ROTATION, R, V
from hil.maths import quat
from hil.maths.arrays import fill

HELD: Final = (R + 1, V + 1, ROTATION, ROTATION + 2)
"""Errors that are none."""
HELD_INNOVATIONS: Final = (1, 3, 5)
"""Of the innovations of position and attitude."""

OFF_PLANE = np.dtype(
    [
        ("t_s", "f8"),  # exposure, time of the run
        ("along_y", "f8"),  # m, in c
        ("about", "f8", 3),  # rad, rotation about the axes of c
        ("sigmas", "f8"),  # standard deviations of the innovation; 0: there was none
    ],
    align=True,
)
"""First rejected pose that contradicts the plane."""


def filter_states(planar: bool) -> tuple[int, int]:
    """Return the numbers of states of position and attitude filter: the means of their NEES if they are consistent."""
    return (7, 4) if planar else (9, 6)


@entry
def hold(errors, filters):
    """Project the estimates of FILTERS on the plane; what is known has neither variance nor correlation."""
    pkf, akf = filters.pkf, filters.akf
    pkf.x[1] = pkf.x[4] = akf.x[0] = akf.x[2] = akf.w_CH_C[0] = akf.w_CH_C[2] = 0.0
    quat.normalise(akf.x[0:4])
    for k in HELD:
        _clear(errors, filters, k)
    if errors.target_rate != 0:  # the target tumbles in the plane as well
        for k in (errors.target_rate, errors.target_rate + 2):
            filters.parameters[k] = 0.0
            _clear(errors, filters, k)


@kernel
def _clear(errors, filters, k):
    """Write zeros to variance and correlations of error ``k``."""
    fill(filters.p[k], 0.0)
    for j in range(errors.n):
        filters.p[j, k] = 0.0


@entry
def note_contradiction(params, state, pose):
    """Keep the first rejected pose whose innovation out of the plane is beyond the gate. params: FUSION_PARAMS."""
    largest = 0.0
    if not math.isnan(state.nis_attitude):
        found = state.found_attitude
        for i in (0, 2):
            largest = max(largest, found.value[i] ** 2 / found.s[i, i])
    if not math.isnan(state.nis_position):
        largest = max(largest, state.found_position.value[1] ** 2 / state.found_position.s[1, 1])
    if largest > params.pkf.gate and state.off_plane.sigmas == 0.0:
        off = state.off_plane
        off.t_s, off.along_y, off.sigmas = pose.t_s, -pose.z_TC_C[1], math.sqrt(largest)
        off.about[0], off.about[2] = 2.0 * pose.q_CH[0], 2.0 * pose.q_CH[2]
