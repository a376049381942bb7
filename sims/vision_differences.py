"""Navigation by vision alone as the bench paper may have had it: rates are low-passed differences of poses.

    hil run sims/vision-differences.toml

Each pose gives a rate as its difference to the pose before over the time between them, which a first-order low-pass
smooths; the pose is carried on with that rate, and corrected by each new one through a low-pass. Neither thrust nor
orbital motion is used, so the rates are noisy and late; standard deviations are those of the noise. The built-in one
without an IMU, ``vision_alone``, uses both: scheme 3 flies it.
"""

import math

import hil
from hil.maths import quat, stack

SETTINGS = (
    hil.Setting("position_lag_s", 0.548, "s", 0.0, 10.0, "time constant of the position's correction"),
    hil.Setting("velocity_lag_s", 5.5, "s", 0.0, 30.0, "of the velocity"),
    hil.Setting("attitude_lag_s", 0.4, "s", 0.0, 10.0, "of the attitude"),
    hil.Setting("rate_lag_s", 1.7, "s", 0.0, 30.0, "of the rate"),
)
MEMORY = [
    ("started", "i8"), ("r", "f8", 3), ("v", "f8", 3), ("q", "f8", 4), ("w", "f8", 3),
    ("last_r", "f8", 3), ("last_q", "f8", 4), ("last_s", "f8"),
    ("sigma_r", "f8"), ("sigma_v", "f8"), ("sigma_angle", "f8"),
]  # fmt: skip


@hil.kernel_backend(settings=SETTINGS, memory=MEMORY)
def differences(settings, inp, out, memory):
    """Write the estimate of one cycle."""
    m, dt = memory, inp.setup.step_s
    rotation, aside, moved, measured = stack.vector(3), stack.vector(4), stack.vector(4), stack.vector(3)
    for i in range(3):
        m.r[i] += dt * m.v[i]
        rotation[i] = dt * m.w[i]
    if m.started != 0:
        quat.from_rotation_vector_into(rotation, aside)
        quat.multiply_into(aside, m.q, moved)
        for i in range(4):
            m.q[i] = moved[i]
    for k in range(inp.n_poses):
        pose = inp.poses[k]
        quat.transform_back_into(pose.q_CH, pose.r_TC_C_m, measured)
        elapsed = pose.t_s - m.last_s
        sigma, angle = math.sqrt(pose.covariance_position_m2[0, 0]), math.sqrt(pose.covariance_attitude_rad2[0, 0])
        m.sigma_r = sigma * math.sqrt(0.5 * elapsed / (settings.position_lag_s + elapsed))
        m.sigma_v, m.sigma_angle = sigma / settings.velocity_lag_s, angle
        if m.started == 0:
            m.started = 1
            for i in range(3):
                m.r[i] = m.last_r[i] = -measured[i]
            for i in range(4):
                m.q[i] = m.last_q[i] = pose.q_CH[i]
            m.last_s = pose.t_s
        elif elapsed > 0.0:
            quat.rotation_between(pose.q_CH, m.last_q, rotation)
            for i in range(3):
                rate = (-measured[i] - m.last_r[i]) / elapsed
                m.v[i] += elapsed / (settings.velocity_lag_s + elapsed) * (rate - m.v[i])
                m.r[i] += elapsed / (settings.position_lag_s + elapsed) * (-measured[i] - m.r[i])
                m.w[i] += elapsed / (settings.rate_lag_s + elapsed) * (rotation[i] / elapsed - m.w[i])
                m.last_r[i] = -measured[i]
            quat.rotation_between(pose.q_CH, m.q, rotation)
            for i in range(3):
                rotation[i] *= elapsed / (settings.attitude_lag_s + elapsed)
            quat.from_rotation_vector_into(rotation, aside)
            quat.multiply_into(aside, m.q, moved)
            length = math.sqrt(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2 + moved[3] ** 2)
            for i in range(4):
                m.q[i] = moved[i] / length
                m.last_q[i] = pose.q_CH[i]
            m.last_s = pose.t_s
    out.valid = m.started
    for i in range(3):
        out.r_CT_H[i], out.v_CT_H[i], out.w_CH_C[i] = m.r[i], m.v[i], m.w[i]
        out.sigma_r_m[i], out.sigma_v_mps[i], out.sigma_attitude_rad[i] = m.sigma_r, m.sigma_v, m.sigma_angle
    for i in range(4):
        out.q_CH[i] = m.q[i]
