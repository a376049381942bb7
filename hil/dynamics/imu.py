"""Virtual IMU: bench paper eq. (1) and (2) with drift and bias as random walks.

Gyro and accelerometer integrate, as fibre-optic gyros and quartz accelerometers do: a sample is the
mean over the step, so a thruster pulse within the step is measured in full.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.dynamics import imu_faults
from hil.models.faults import FAULTS

IMU_NOISE = 12  # standard normals per sample: gyro, accelerometer, drift, bias

IMU_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("sigma_gyro", "f8"),  # rad/s per sample
        ("sigma_drift", "f8"),  # rad/s^2: drift[k+1] = drift[k] + dt * sigma * n
        ("sigma_accelerometer", "f8"),  # m/s^2 per sample
        ("sigma_bias", "f8"),  # m/s^3
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
def sample_with_faults(params, truth, noise, memory, imu):
    """``sample`` with the faults that act at the end of the step. memory: IMU_MEMORY."""
    if params.faults.n == 0:
        sample(params, truth, noise, imu)
        return
    imu_faults.step_biases(params.faults, memory, truth.t_s, imu)
    sample(params, truth, noise, imu)
    imu_faults.distort(
        params.faults, memory, truth.t_s, params.dt_s, params.sigma_gyro, params.sigma_accelerometer, imu
    )
