"""Virtual IMU: bench paper eq. (1) and (2) with drift and bias as random walks.

Gyro and accelerometer integrate, as fibre-optic gyros and quartz accelerometers do: a sample is the
mean over the step, so a thruster pulse within the step is measured in full. The truth takes one step per sample.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.dynamics import imu_errors, imu_faults
from hil.dynamics import truth as truth_kernels
from hil.dynamics.imu_errors import IMU_ERRORS
from hil.maths import stack
from hil.maths.arrays import copy_into, fill
from hil.maths.record_view import copy_record
from hil.models.faults import FAULTS

IMU_NOISE = 12  # standard normals per sample: gyro, accelerometer, drift, bias

IMU_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("sigma_gyro", "f8"),  # rad/s per sample
        ("sigma_drift", "f8"),  # rad/s^2: drift[k+1] = drift[k] + dt * sigma * n
        ("sigma_accelerometer", "f8"),  # m/s^2 per sample
        ("sigma_bias", "f8"),  # m/s^3
        ("errors", IMU_ERRORS),
        ("faults", FAULTS),
    ],
    align=True,
)


@kernel
def sample(params, truth, noise, imu):
    """Write the sample of the step that ended at ``truth``; advance drift and bias.

    params: IMU_PARAMS. truth: TRUTH. noise: standard normals, (12,). imu: IMU, whose ``drift_C`` and
    ``bias_C`` are the true values that held during the step and on return those of the next one.
    """
    for i in range(3):
        imu.rate_C[i] = truth.mean_rate_C[i] + imu.drift_C[i] + params.sigma_gyro * noise[i]
        imu.force_C[i] = truth.mean_force_C[i] + imu.bias_C[i] + params.sigma_accelerometer * noise[3 + i]
        imu.drift_C[i] += params.dt_s * params.sigma_drift * noise[6 + i]
        imu.bias_C[i] += params.dt_s * params.sigma_bias * noise[9 + i]


@kernel
def sample_with_errors(params, truth, w_before, noise, memory, imu):
    """``sample`` with the sensors' error model and the faults that act at the end of the step.

    w_before: (3,), rad/s, inertial rate at the start of the step. memory: IMU_MEMORY.
    """
    if params.faults.n != 0:
        imu_faults.step_biases(params.faults, memory, truth.t_s, imu)
    if params.errors.enabled != 0:
        imu_errors.wander(params.errors, memory.errors, imu)
    sample(params, truth, noise, imu)
    if params.errors.enabled != 0:
        imu_errors.distort(params.errors, memory.errors, truth, w_before, params.dt_s, imu)
    if params.faults.n != 0:
        imu_faults.distort(
            params.faults, memory, truth.t_s, params.dt_s, params.sigma_gyro, params.sigma_accelerometer, imu
        )


@kernel
def propagate(dss, params, field, memory, truth, on, noise, imu_memory, samples, imu):
    """Propagate ``truth`` by one cycle, in as many equal steps as there are ``samples``, (n,) of IMU, which are filled.

    dss: DSS_PARAMS, params: IMU_PARAMS, both with the step of a sample. field, memory, truth, on: see ``truth.step``.
    noise: (n, 12), see ``sample``. imu_memory: IMU_MEMORY. imu: IMU, on return the mean of the samples; with one sample
    it may be that sample. Means over the last step in ``truth`` become means over the cycle.
    """
    n = samples.shape[0]
    means, fraction, w_before = stack.matrix(4, 3), stack.vector(MAX_THRUSTERS), stack.vector(3)
    if n > 1:
        for row in range(4):
            fill(means[row], 0.0)
        fill(fraction, 0.0)
    for k in range(n):
        copy_into(w_before, truth.w_CI_C)
        truth_kernels.step(dss, field, memory, truth, on)
        sample_with_errors(params, truth, w_before, noise[k], imu_memory, imu)
        copy_record(imu, samples[k])
        if n > 1:
            for i in range(3):
                means[0, i] += imu.rate_C[i] / n
                means[1, i] += imu.force_C[i] / n
                means[2, i] += truth.mean_rate_C[i] / n
                means[3, i] += truth.mean_force_C[i] / n
            for i in range(MAX_THRUSTERS):
                fraction[i] += truth.thrust_fraction[i] / n
    if n > 1:
        copy_into(imu.rate_C, means[0])
        copy_into(imu.force_C, means[1])
        copy_into(truth.mean_rate_C, means[2])
        copy_into(truth.mean_force_C, means[3])
        copy_into(truth.thrust_fraction, fraction)
