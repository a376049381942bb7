"""Faults of a scenario as the kernels' rows, from user units to SI."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.config.faults import TERMS, TimedFault
from hil.config.scenario import Scenario
from hil.core.messages import new
from hil.dynamics import imu_faults, target_faults, thruster_faults
from hil.models import axis_faults
from hil.models.faults import AT, AT_ARRIVAL, FAULTS, KIND, NUMBER, OPTION, SEED_BITS, SIZE, UNTIL, VALUE
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
    found = [fault for fault in scenario.faults if fault.family in (family, *more)]
    table.n = len(found)
    for row, fault in zip(table.row, found, strict=False):
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
