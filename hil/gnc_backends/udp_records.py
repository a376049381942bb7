"""What comes from the built-in GNC in another process, brought into the records of the cycle."""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths.arrays import copy_into, copy_matrix


@kernel
def take_flight(told, told_command, navigation, command):
    """Write NAVIGATION and COMMAND as the GNC had them, but for the thrusters, which were taken and checked before.

    told, told_command: NAVIGATION and COMMAND as they came. Returns False, with nothing written, where an estimate
    that is said to be valid has a value that is not finite.
    """
    if told.valid != 0 and not (
        np.isfinite(told.r_CT_H).all()
        and np.isfinite(told.v_CT_H).all()
        and np.isfinite(told.q_CH).all()
        and np.isfinite(told.w_CH_C).all()
    ):
        return False
    navigation.valid = told.valid
    copy_into(navigation.r_CT_H, told.r_CT_H)
    copy_into(navigation.v_CT_H, told.v_CT_H)
    copy_into(navigation.q_CH, told.q_CH)
    copy_into(navigation.w_CH_C, told.w_CH_C)
    copy_into(navigation.sigma_r_m, told.sigma_r_m)
    copy_into(navigation.sigma_v_mps, told.sigma_v_mps)
    copy_into(navigation.sigma_attitude_rad, told.sigma_attitude_rad)
    navigation.nis_position = told.nis_position
    navigation.nis_attitude = told.nis_attitude
    copy_into(command.force, told_command.force)
    copy_into(command.torque, told_command.torque)
    copy_into(command.cycles_left, told_command.cycles_left)
    copy_into(command.until_decision, told_command.until_decision)
    copy_into(command.owed, told_command.owed)
    command.boost = told_command.boost
    return True


@kernel
def take_filters(told, filters):
    """Write into ``filters`` (FILTERS) what their consistency needs, from ``told`` (GNC_FILTERS)."""
    copy_into(filters.akf.x, told.attitude_x)
    copy_matrix(filters.akf.p, told.attitude_p)
    copy_into(filters.pkf.x, told.position_x)
    copy_matrix(filters.pkf.p, told.position_p)


@kernel
def tell_filters(cycle, filters, told):
    """Write GNC_FILTERS from ``filters`` (FILTERS)."""
    told.cycle = cycle
    copy_into(told.attitude_x, filters.akf.x)
    copy_matrix(told.attitude_p, filters.akf.p)
    copy_into(told.position_x, filters.pkf.x)
    copy_matrix(told.position_p, filters.pkf.p)


@kernel
def hear_input(told, not_before_s, imu, reference, poses):
    """Write IMU, REFERENCE and the poses (POSE) that came from ``told`` (GNC_INPUT); return how many came.

    Poses exposed before ``not_before_s`` are left out. What the input does not say (true drift and bias, number and
    line of the phase) stays as it is.
    """
    copy_into(imu.rate_C, told.rate_radps)
    copy_into(imu.force_C, told.force_mps2)
    copy_into(reference.r_CT_H, told.reference_r_CT_H_m)
    copy_into(reference.v_CT_H, told.reference_v_CT_H_mps)
    copy_into(reference.a_CT_H, told.reference_a_CT_H_mps2)
    copy_into(reference.q_CH, told.reference_q_CH)
    reference.boost = told.boost
    came = 0
    for i in range(min(max(told.n_poses, 0), poses.shape[0])):
        pose, said = poses[came], told.poses[i]
        if said.t_s < not_before_s:
            continue
        came += 1
        pose.t_s = said.t_s
        copy_into(pose.z_TC_C, said.r_TC_C_m)
        copy_into(pose.q_CH, said.q_CH)
        copy_matrix(pose.covariance_position, said.covariance_position_m2)
        copy_matrix(pose.covariance_attitude, said.covariance_attitude_rad2)
    return came


@kernel
def tell_output(cycle, navigation, command, n_thrusters, out):
    """Write the answer to the input ``cycle`` into ``out`` (GNC_OUTPUT): thrusters, and the estimate where one is."""
    out.cycle = cycle
    out.state = 1
    out.direct = 1
    for i in range(3):
        out.force[i] = command.force[i]
        out.torque[i] = command.torque[i]
    for i in range(out.on.shape[0]):
        out.on[i] = command.on[i] if i < n_thrusters else 0
    out.estimate = navigation.valid
    copy_into(out.r_CT_H_m, navigation.r_CT_H)
    copy_into(out.v_CT_H_mps, navigation.v_CT_H)
    copy_into(out.q_CH, navigation.q_CH)
    copy_into(out.w_CH_C_radps, navigation.w_CH_C)
