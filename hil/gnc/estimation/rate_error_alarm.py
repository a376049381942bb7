"""When an error of the rate of H, as the GNC has it, makes the monitors accuse the vision unit.

The attitude filter takes such an error for drift of the gyros and follows it late: its innovations have a mean. Of the
filter each axis is carried alone, with rotation and drift, with c parallel to H; gate, monitors and doubts are those of
the navigation.
"""

from __future__ import annotations

import math

from hil.core.jit import entry
from hil.gnc.estimation import integrity, parameter_doubts
from hil.maths import quat, stack
from hil.maths.arrays import fill


@entry
def alarm_by_rate_error(akf, params, state, doubts, error, row_s, interval_s, noise, sigma, q_vc):
    """Return when vision is accused, s, nan if never, and the mean NEES of rotation and drift until then, 6 expected.

    akf, params: AKF_PARAMS, INTEGRITY_PARAMS. state, doubts: INTEGRITY_STATE, DOUBTS, zeroed. error: of the rate,
    (n, 3), rad/s, in H, every ``row_s``. interval_s: between two poses. noise: standard normals of the vision unit,
    (m, 6), a row per pose. sigma: of their angles, rad. q_vc: from c to the axes of the camera.
    """
    of_pose, turned, drift, innovation = stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(6)
    p00, p01, p11, gain = stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(3)
    fill(turned, 0.0)
    fill(drift, 0.0)
    fill(innovation, 0.0)
    fill(p01, 0.0)
    for i in range(3):
        p00[i], p11[i] = sigma * sigma, akf.initial_drift_sigma**2 + akf.rate_sigma[i] ** 2
    rejected, square = 0, 0.0
    for pose in range(noise.shape[0]):
        at = min(pose * interval_s / row_s, error.shape[0] - 1.000001)
        row = int(at)
        nis = 0.0
        rate = stack.vector(3)
        quat.transform_back_into(q_vc, noise[pose, 3:6], of_pose)
        for i in range(3):
            rate[i] = error[row, i] + (at - row) * (error[row + 1, i] - error[row, i])
            turned[i] += interval_s * (rate[i] - drift[i])
            p00[i] += interval_s * (2.0 * p01[i] + interval_s * p11[i] + akf.sigma_gyro**2 * akf.dt_s)
            p01[i] += interval_s * p11[i]
            p11[i] += interval_s * akf.dt_s * (akf.sigma_drift**2 + akf.rate_noise[i] ** 2) + doubts.drift**2
            gain[i] = 1.0 / (p00[i] + sigma * sigma)
            innovation[3 + i] = (turned[i] + sigma * of_pose[i]) * math.sqrt(gain[i])
            nis += innovation[3 + i] ** 2
        doubts.drift = 0.0
        rejected += 1
        if nis <= akf.gate:
            rejected = 0
            for i in range(3):
                off, s = innovation[3 + i] / math.sqrt(gain[i]), gain[i]
                turned[i] -= p00[i] * s * off
                drift[i] += p01[i] * s * off
                p11[i] -= p01[i] * s * p01[i]
                p01[i] *= 1.0 - p00[i] * s
                p00[i] *= 1.0 - p00[i] * s
            integrity.monitor(params, state, innovation, 0.0, nis)
            parameter_doubts.doubt_drift(params, state, doubts)
        for i in range(3):
            off = rate[i] - drift[i]
            scale = p00[i] * p11[i] - p01[i] * p01[i]
            square += (p11[i] * turned[i] ** 2 - 2.0 * p01[i] * turned[i] * off + p00[i] * off * off) / scale
        if integrity.vision_health(params, state, 0.0, rejected, 0.0) != 0:
            return pose * interval_s, square / (pose + 1)
    return math.nan, square / noise.shape[0]
