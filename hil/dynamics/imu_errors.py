"""Error model of the virtual IMU beyond drift and white noise: scale, misalignment, instability, quantum, lever arm.

Bias instability, flicker noise, is approximated by a first-order Gauss-Markov process (IEEE Std 952, annex B), whose
Allan deviation is greatest, 0.62 of its standard deviation, at 1.9 correlation times.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.dynamics.rigid_body import add_lever_terms
from hil.maths import stack
from hil.models.faults import normal

IMU_ERRORS = np.dtype(
    [
        ("enabled", "i8"),  # 1: any of the errors below
        ("seed", "i8"),
        ("gyro_gain", "f8", (3, 3)),  # sensor axes, scaled, against c, less the unit matrix
        ("accelerometer_gain", "f8", (3, 3)),
        ("sigma_instability", "f8", 2),  # gyro, rad/s, and accelerometer, m/s^2
        ("kept", "f8", 2),  # part of the instability that is left after a sample
        ("quantum", "f8", 2),  # rad/s and m/s^2, 0 for none
        ("lever_arm", "f8", 3),  # m, in c, from the reference point to the accelerometers
    ],
    align=True,
)

IMU_ERROR_MEMORY = np.dtype([("samples", "i8"), ("instability", "f8", (2, 3)), ("remainder", "f8", (2, 3))], align=True)
"""samples: so far. instability: of gyro and accelerometer, rad/s and m/s^2. remainder: not yet read because of the
quantum, likewise."""

_LANE = 4096  # beyond those of the faults


@kernel
def wander(errors, memory, imu):
    """Move the instability on to the next sample; it is a part of the true drift and bias of ``imu`` (IMU)."""
    for sensor in range(2):
        sigma, kept = errors.sigma_instability[sensor], errors.kept[sensor]
        if sigma == 0.0:
            continue
        kept = 0.0 if memory.samples == 0 else kept
        fresh = sigma * math.sqrt(1.0 - kept * kept)
        for i in range(3):
            previous = memory.instability[sensor, i]
            now = kept * previous + fresh * normal(errors.seed, memory.samples, _LANE + 3 * sensor + i)
            memory.instability[sensor, i] = now
            if sensor == 0:
                imu.drift_C[i] += now - previous
            else:
                imu.bias_C[i] += now - previous


@kernel
def _round(quantum, remainder, reading):
    """Round a reading (3,) to the quantum; the remainder (3,) is read later, as an integrating sensor does."""
    for i in range(3):
        exact = reading[i] + remainder[i]
        reading[i] = quantum * math.floor(exact / quantum + 0.5)
        remainder[i] = exact - reading[i]


@kernel
def distort(errors, memory, truth, w_before, dt_s, imu):
    """Apply the errors to the readings of ``imu`` (IMU) of the step that ended at ``truth``.

    memory: IMU_ERROR_MEMORY. w_before: (3,), rad/s, inertial rate at the start of the step. dt_s: its length.
    """
    arm, force = stack.vector(3), stack.vector(3)
    for i in range(3):
        arm[i] = -errors.lever_arm[i]
        force[i] = truth.mean_force_C[i]
    add_lever_terms(arm, w_before, truth.w_CI_C, truth.mean_rate_C, dt_s, force)
    for i in range(3):
        imu.force_C[i] += force[i] - truth.mean_force_C[i]
        for j in range(3):
            imu.rate_C[i] += errors.gyro_gain[i, j] * truth.mean_rate_C[j]
            imu.force_C[i] += errors.accelerometer_gain[i, j] * force[j]
    if errors.quantum[0] > 0.0:
        _round(errors.quantum[0], memory.remainder[0], imu.rate_C)
    if errors.quantum[1] > 0.0:
        _round(errors.quantum[1], memory.remainder[1], imu.force_C)
    memory.samples += 1
