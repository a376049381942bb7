"""Faults of the virtual IMU: of its errors before a sample, of its readings after it."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_FAULTS
from hil.dynamics.imu_errors import IMU_ERROR_MEMORY
from hil.maths.limits import to_integer
from hil.models.faults import KIND, OPTION, VALUE, is_active, normal

BIAS_STEP, SCALE_FACTOR, DROPOUT, NOISE_SCALE, STUCK = range(5)
GYRO, ACCELEROMETER = 0.0, 1.0
"""Option of all kinds but DROPOUT."""

IMU_MEMORY = np.dtype(
    [("acts", "i8", MAX_FAULTS), ("rate", "f8", 3), ("force", "f8", 3), ("errors", IMU_ERROR_MEMORY)], align=True
)
"""acts: 1 for each bias step that is in the true errors. rate, force: the last readings, rad/s and m/s^2."""


@kernel
def step_biases(faults, memory, t_s, imu):
    """Add and remove bias steps in the true errors of ``imu`` (IMU), whose sample ends at ``t_s`` of the run."""
    for i in range(faults.n):
        row = faults.row[i]
        if row[KIND] != BIAS_STEP:
            continue
        acts = 1 if is_active(row, t_s) else 0
        change = acts - memory.acts[i]
        memory.acts[i] = acts
        for j in range(3):
            if row[OPTION] == GYRO:
                imu.drift_C[j] += change * row[VALUE + j]
            else:
                imu.bias_C[j] += change * row[VALUE + j]


@kernel
def _distort(faults, i, number, sigma, last, reading):
    """Apply fault ``i`` to a reading (3,) whose noise is ``sigma`` and whose predecessor is ``last``."""
    row = faults.row[i]
    kind = row[KIND]
    if kind == SCALE_FACTOR:
        for j in range(3):
            reading[j] *= row[VALUE]
    elif kind == NOISE_SCALE:
        excess = math.sqrt(row[VALUE] ** 2 - 1.0) * sigma
        for j in range(3):
            reading[j] += excess * normal(faults.seed, number, 8 * i + j)
    elif kind == STUCK:
        for j in range(3):
            reading[j] = last[j]


@kernel
def distort(faults, memory, t_s, dt_s, sigma_gyro, sigma_accelerometer, imu):
    """Apply the faults that act at ``t_s`` of the run, the end of the sample, to the readings of ``imu`` (IMU).

    dt_s: period of the samples. sigma_gyro, sigma_accelerometer: noise of a sample, rad/s and m/s^2.
    """
    number = to_integer(round(t_s / dt_s))
    for i in range(faults.n):
        row = faults.row[i]
        if not is_active(row, t_s):
            continue
        if row[KIND] == DROPOUT:
            for j in range(3):
                imu.rate_C[j] = imu.force_C[j] = 0.0
        elif row[OPTION] == GYRO:
            _distort(faults, i, number, sigma_gyro, memory.rate, imu.rate_C)
        else:
            _distort(faults, i, number, sigma_accelerometer, memory.force, imu.force_C)
    for j in range(3):
        memory.rate[j], memory.force[j] = imu.rate_C[j], imu.force_C[j]
