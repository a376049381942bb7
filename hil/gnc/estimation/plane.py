"""Filters of a chaser that is held in a plane of H: position across it and rotations that leave it are known.

What is known has no error: after the start and after each step its estimate is the plane's and its covariance zero. A
pose corrects the other states alone, and what it measures out of the plane is an error of its own. ``held``: axis of H
across the plane, 1 x, 2 y, 3 z.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import entry, kernel
from hil.gnc.estimation.error_state import DRIFT, ROTATION, R, V
from hil.maths import elementary, quat
from hil.maths.arrays import fill

OFF_PLANE = np.dtype(
    [
        ("t_s", "f8"),  # exposure, time of the run
        ("across", "f8"),  # m
        ("tilt", "f8"),  # rad, rotation out of the plane
        ("sigmas", "f8"),  # standard deviations of the innovation; 0: there was none
    ],
    align=True,
)
"""First rejected pose that contradicts the plane."""


def filter_states(planar: bool) -> tuple[int, int]:
    """Return the numbers of states of position and attitude filter: the means of their NEES if they are consistent."""
    return (7, 4) if planar else (9, 6)


@kernel
def is_known(held, error):
    """Return whether number ``error`` of the errors of PKF and AKF is none."""
    k = held - 1
    return error == R + k or error == V + k or (ROTATION <= error < DRIFT and error != ROTATION + k)


@kernel
def is_held_innovation(held, i):
    """Return whether number ``i`` of an innovation, position then attitude, is out of the plane."""
    return (i < 3) == (i % 3 == held - 1)


@entry
def hold(held, errors, filters):
    """Project the estimates of FILTERS on the plane; what is known has neither variance nor correlation."""
    k, pkf, akf = held - 1, filters.pkf, filters.akf
    pkf.x[k] = pkf.x[3 + k] = 0.0
    quat.keep_turn(k, akf.x[0:4])
    _clear(errors, filters, R + k)
    _clear(errors, filters, V + k)
    for i in range(3):
        if i != k:
            akf.w_CH_C[i] = 0.0
            _clear(errors, filters, ROTATION + i)
            if errors.target_rate != 0:  # the target tumbles in the plane as well
                filters.parameters[errors.target_rate + i] = 0.0
                _clear(errors, filters, errors.target_rate + i)


@kernel
def _clear(errors, filters, k):
    """Write zeros to variance and correlations of error ``k``."""
    fill(filters.p[k], 0.0)
    for j in range(errors.n):
        filters.p[j, k] = 0.0


@entry
def note_contradiction(params, state, pose):
    """Keep the first rejected pose whose innovation out of the plane is beyond the gate. params: FUSION_PARAMS."""
    k, off, largest = params.held - 1, state.off_plane, 0.0
    if not math.isnan(state.nis_attitude):
        attitude = state.found_attitude
        for i in range(3):
            if i != k:
                largest = max(largest, attitude.value[i] ** 2 / attitude.s[i, i])
    if not math.isnan(state.nis_position):
        largest = max(largest, state.found_position.value[k] ** 2 / state.found_position.s[k, k])
    if largest > params.pkf.gate and off.sigmas == 0.0:
        off.t_s, off.across, off.sigmas = pose.t_s, abs(pose.z_TC_C[k]), math.sqrt(largest)
        off.tilt = 2.0 * elementary.hypot(pose.q_CH[(k + 1) % 3], pose.q_CH[(k + 2) % 3])
