"""Outputs of navigation and of control elsewhere: preset, checked, and used as estimate and demands.

The records are those of ``hil.core.gnc_records``; an output of a whole GNC is taken apart into both of them.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.gnc_records import GncHealth, GncState
from hil.core.jit import kernel
from hil.maths.arrays import copy_into, fill

FINE, STATE, VALID, POSITION, VELOCITY, ATTITUDE, RATE, SIGMA, PROTECTION_LEVEL, HEALTH = range(10)
DIRECT, FORCE, TORQUE, THRUSTER, BIAS, REPORTED, RETURNED, CYCLE = range(10, 18)
"""Faults of an output. REPORTED: the backend reports a fault; RETURNED: its step returned another number than 0;
CYCLE: it answers another input."""

NOBODY, NAVIGATION, CONTROL, GNC = range(4)
"""Backend that has failed; GNC: of both parts."""

HEALTH_MAX = sum(bit.value for bit in GncHealth)
_NORM_TOLERANCE = 1e-3  # of an estimated quaternion
STARTING, WORKING, ASKS_FOR_HOLD, FAULT = (state.value for state in GncState)
"""GncState, as numbers for the kernels."""


@kernel
def mark_invalid(navigation):
    """Write NAVIGATION without an estimate."""
    navigation.valid = 0
    fill(navigation.r_CT_H, np.nan)
    fill(navigation.v_CT_H, np.nan)
    fill(navigation.q_CH, np.nan)
    fill(navigation.w_CH_C, np.nan)
    fill(navigation.sigma_r_m, np.nan)
    fill(navigation.sigma_v_mps, np.nan)
    fill(navigation.sigma_attitude_rad, np.nan)
    navigation.nis_position = np.nan
    navigation.nis_attitude = np.nan
    fill(navigation.protection_level_m, np.nan)
    navigation.protection_level_rad = np.nan
    navigation.health = 0


@kernel
def preset_navigation(out):
    """Preset an output of navigation: WORKING, no estimate, numbers that are not reported nan."""
    mark_invalid(out)
    fill(out.bias_mps2, np.nan)
    fill(out.bias_sigma_mps2, np.nan)
    out.state = WORKING


@kernel
def preset_control(out):
    """Preset an output of control: WORKING, no demands."""
    fill(out.force, 0)
    fill(out.torque, 0)
    fill(out.on, 0)
    out.direct, out.state = 0, WORKING


@kernel
def _copy_estimate(estimate, out):
    """Copy the fields of NAVIGATION from an output to NAVIGATION."""
    out.valid, out.health = estimate.valid, estimate.health
    copy_into(out.r_CT_H, estimate.r_CT_H)
    copy_into(out.v_CT_H, estimate.v_CT_H)
    copy_into(out.q_CH, estimate.q_CH)
    copy_into(out.w_CH_C, estimate.w_CH_C)
    copy_into(out.sigma_r_m, estimate.sigma_r_m)
    copy_into(out.sigma_v_mps, estimate.sigma_v_mps)
    copy_into(out.sigma_attitude_rad, estimate.sigma_attitude_rad)
    out.nis_position, out.nis_attitude = estimate.nis_position, estimate.nis_attitude
    copy_into(out.protection_level_m, estimate.protection_level_m)
    out.protection_level_rad = estimate.protection_level_rad


@kernel
def _first_not_finite(values):
    """Return the index of the first of ``values`` that is not finite, -1 if all are finite."""
    for i in range(values.shape[0]):
        if not math.isfinite(values[i]):
            return i
    return -1


@kernel
def _negative(values):
    """Return the index of the first of ``values`` that is negative, -1 if there is none."""
    for i in range(values.shape[0]):
        if values[i] < 0.0:
            return i
    return -1


@kernel
def fault_of_estimate(out):
    """Return (fault, index) of NAVIGATION_OUTPUT; (FINE, 0) if there is none."""
    if out.valid != 0 and out.valid != 1:
        return VALID, 0
    if out.valid == 0:
        return FINE, 0
    index = _first_not_finite(out.r_CT_H)
    if index >= 0:
        return POSITION, index
    index = _first_not_finite(out.v_CT_H)
    if index >= 0:
        return VELOCITY, index
    index = _first_not_finite(out.w_CH_C)
    if index >= 0:
        return RATE, index
    square = 0.0
    for i in range(4):
        square += out.q_CH[i] * out.q_CH[i]
    if not abs(square - 1.0) <= 2.0 * _NORM_TOLERANCE:
        return ATTITUDE, 0
    index = max(_negative(out.sigma_r_m), _negative(out.sigma_v_mps), _negative(out.sigma_attitude_rad))
    if index >= 0:
        return SIGMA, index
    index = _negative(out.protection_level_m)
    if index >= 0:
        return PROTECTION_LEVEL, index
    if out.protection_level_rad < 0.0:
        return PROTECTION_LEVEL, 3
    index = _negative(out.bias_sigma_mps2)
    if math.isfinite(out.bias_sigma_mps2[0]):
        index = max(index, _first_not_finite(out.bias_mps2))
    if index >= 0:
        return BIAS, index
    if not 0 <= out.health <= HEALTH_MAX:
        return HEALTH, 0
    return FINE, 0


@kernel
def fault_of_demands(out, n_thrusters):
    """Return (fault, index) of CONTROL_OUTPUT; (FINE, 0) if there is none."""
    if out.direct != 0 and out.direct != 1:
        return DIRECT, 0
    for i in range(3):
        if not -1 <= out.force[i] <= 1:
            return FORCE, i
        if not -1 <= out.torque[i] <= 1:
            return TORQUE, i
    for j in range(out.on.shape[0]):
        if out.on[j] > 1 or (out.on[j] != 0 and j >= n_thrusters):
            return THRUSTER, j
    return FINE, 0


@kernel
def write_estimate(out, estimate):
    """Write NAVIGATION from an output of navigation without a fault; a level that is not reported is nan."""
    if out.valid == 0 or out.state == STARTING:
        mark_invalid(estimate)
        return
    _copy_estimate(out, estimate)
    for i in range(3):
        if estimate.protection_level_m[i] == 0.0:
            estimate.protection_level_m[i] = np.nan
    if estimate.protection_level_rad == 0.0:
        estimate.protection_level_rad = np.nan


@kernel
def write_demands(out, n_thrusters, command):
    """Write the demands of COMMAND, or its thrusters, from an output of control without a fault; boost stays."""
    works = out.state != STARTING
    for i in range(3):
        command.force[i] = out.force[i] if works and out.direct == 0 else 0
        command.torque[i] = out.torque[i] if works and out.direct == 0 else 0
    for j in range(n_thrusters):
        command.on[j] = out.on[j] if works else 0
