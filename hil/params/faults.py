"""Faults and error models of a scenario as records of the kernels, from user units to SI."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.config.scenario import Scenario
from hil.config.tables.faults import TERMS, TimedFault
from hil.config.tables.model import Triple
from hil.core.messages import Array, new
from hil.dynamics import imu_faults, target_faults, thruster_faults
from hil.dynamics.imu_errors import IMU_ERRORS
from hil.dynamics.thruster_faults import THRUSTER_ERRORS
from hil.maths import elementary, quat
from hil.models import axis_faults
from hil.models.faults import AT, AT_ARRIVAL, FAULTS, KIND, NUMBER, OPTION, SEED_BITS, SIZE, UNTIL, VALUE
from hil.models.plume import PLUME_PARAMS
from hil.sensors import measurement
from hil.sensors.vision_unit import faults as vmu_faults
from hil.sensors.vision_unit.parameters import least_light

_KERNELS: Final = {
    "vmu": vmu_faults,
    "imu": imu_faults,
    "thruster": thruster_faults,
    "axis": axis_faults,
    "monitor": measurement,
    "sensor": measurement,
    "target": target_faults,
}
CODES: Final = {
    family: {kind: getattr(_KERNELS[family], kind.upper()) for kind in kinds} for family, kinds in TERMS.items()
}
"""Kind of device -> kind of fault -> its number in the kernels."""


def fault_rows(scenario: Scenario, family: str, seed: int = 0, *more: str) -> np.record:
    """Return FAULTS of the kind of device ``family`` and ``more``. seed: of the run, for kinds with random numbers."""
    table = new(FAULTS)
    table.seed = seed & SEED_BITS
    faults = [fault for fault in scenario.faults if fault.family in (family, *more)]
    table.n = len(faults)
    for row, fault in zip(table.row, faults, strict=False):
        row[KIND], row[NUMBER] = CODES[fault.family][fault.kind], fault.number
        row[AT], row[UNTIL] = fault.at_s, fault.end_s
        values = np.array(fault.values) * _si_per_unit(fault)
        row[VALUE : VALUE + len(values)] = values
        row[SIZE] = least_light(scenario) if fault.kind == "dimmed" else fault.size_m or 0.0
        row[OPTION] = _option(fault)
    return table


def _option(fault: TimedFault) -> float:
    if fault.sensor == "accelerometer":
        return imu_faults.ACCELEROMETER
    return AT_ARRIVAL if fault.stamp == "arrival" else 0.0


def _si_per_unit(fault: TimedFault) -> np.ndarray | float:
    """Return the factor of each component of the value."""
    if fault.family == "imu" and fault.kind == "bias_step" and fault.sensor != "accelerometer":
        return math.radians(1.0)
    if fault.device.startswith("turntable."):
        if fault.kind == "offset":
            return math.radians(1.0)
        if fault.kind == "oscillation":
            return np.array([math.radians(1.0), 1.0])
    return 1.0


_PLUME_SPAN_S: Final = 0.02


def imu_errors(scenario: Scenario, seed: int = 0) -> np.record:
    """Return IMU_ERRORS. seed: of the run."""
    given, params = scenario.imu.errors, new(IMU_ERRORS)
    params.seed = seed & SEED_BITS
    params.gyro_gain = _gain(given.gyro_scale_error, given.gyro_misalignment_deg)
    params.accelerometer_gain = _gain(given.accelerometer_scale_error, given.accelerometer_misalignment_deg)
    params.sigma_instability = math.radians(given.gyro_instability_degps), given.accelerometer_instability_mps2
    times = np.array([given.gyro_instability_time_s, given.accelerometer_instability_time_s])
    params.kept = elementary.each(elementary.exp, -scenario.sample_s / times)
    params.quantum = math.radians(given.gyro_quantum_degps), given.accelerometer_quantum_mps2
    params.lever_arm = given.lever_arm_m
    sizes = (params.gyro_gain, params.accelerometer_gain, params.sigma_instability, params.quantum, params.lever_arm)
    params.enabled = any(np.any(size) for size in sizes)
    return params


def thruster_errors(scenario: Scenario, seed: int = 0) -> np.record:
    """Return THRUSTER_ERRORS. seed: of the run."""
    given, params = scenario.chaser.thrusters.errors, new(THRUSTER_ERRORS)
    params.seed = seed & SEED_BITS
    params.delay_s, params.rise_s, params.tail_off_s = given.delay_s, given.rise_s, given.tail_off_s
    params.impulse_scatter = given.impulse_scatter_sigma
    params.half_pressure_kg = given.half_pressure_kg or 0.0
    params.mass_full_kg = scenario.chaser.mass_kg
    delays = (given.delay_s, given.rise_s, given.tail_off_s)
    params.enabled = any(delays) or given.impulse_scatter_sigma > 0.0 or given.half_pressure_kg is not None
    return params


def plume(scenario: Scenario) -> np.record:
    """Return PLUME_PARAMS."""
    thrusters, params = scenario.chaser.thrusters, new(PLUME_PARAMS)
    given = thrusters.errors
    params.radius, params.target_mass = given.plume_target_radius_m, given.plume_target_mass_kg
    params.exponent, params.thrust = given.plume_exponent, thrusters.force_n
    params.dimming, params.least_light = given.plume_dimming_fraction, least_light(scenario)
    params.span_s = max(_PLUME_SPAN_S, scenario.sample_s)
    return params


def _gain(scale_error: Triple, misalignment_deg: Triple) -> Array:
    """Return scaled sensor axes against c, less the unit matrix, (3, 3)."""
    if not any(scale_error) and not any(misalignment_deg):
        return np.zeros((3, 3))
    axes = quat.to_matrix(quat.from_rotation_vector(np.radians(misalignment_deg)))
    gain: Array = (1.0 + np.array(scale_error))[:, None] * axes - np.eye(3)
    return gain
