"""Records between the bench and a GNC server: conversion of cycle records to link records and back."""

from __future__ import annotations

import numpy as np

from hil.core.gnc_records import GncState
from hil.core.jit import kernel
from hil.gnc.estimation import joint_filter
from hil.gnc.estimation.error_state import ROTATION, R
from hil.maths.arrays import copy_into, fill_matrix
from hil.maths.record_view import copy_record
from hil.sensors.vision_unit.pose import read_sent

_WORKING = GncState.WORKING.value


@kernel
def read_flight(sent, sent_command, navigation, command):
    """Write NAVIGATION and COMMAND of the GNC server, without the thrusters, which were checked and read before.

    sent, sent_command: NAVIGATION and COMMAND as received. Return False, with nothing written, if an estimate that is
    marked valid is not finite.
    """
    if sent.valid != 0 and not (
        np.isfinite(sent.r_CT_H).all()
        and np.isfinite(sent.v_CT_H).all()
        and np.isfinite(sent.q_CH).all()
        and np.isfinite(sent.w_CH_C).all()
    ):
        return False
    copy_record(sent, navigation)
    copy_into(command.force, sent_command.force)
    copy_into(command.torque, sent_command.torque)
    copy_into(command.cycles_left, sent_command.cycles_left)
    copy_into(command.until_decision, sent_command.until_decision)
    copy_into(command.owed, sent_command.owed)
    command.boost = sent_command.boost
    return True


@kernel
def read_filters(sent, filters):
    """Write estimates and covariances of PKF and AKF, each alone, of ``filters`` from ``sent`` (GNC_FILTERS)."""
    copy_into(filters.akf.x, sent.attitude_x)
    copy_into(filters.pkf.x, sent.position_x)
    for i in range(9):
        for j in range(9):
            filters.p[R + i, R + j] = sent.position_p[i, j]
    for i in range(6):
        for j in range(6):
            filters.p[ROTATION + i, ROTATION + j] = sent.attitude_p[i, j]


@kernel
def write_filters(cycle, fusion, sent):
    """Write GNC_FILTERS from FUSION_STATE ``fusion``; without an IMU the attitude filter has no drift to compare."""
    filters = fusion.filters
    sent.cycle = cycle
    copy_into(sent.attitude_x, filters.akf.x)
    joint_filter.copy_block(filters, ROTATION, sent.attitude_p)
    if fusion.thrust.without_imu != 0:
        fill_matrix(sent.attitude_p, np.nan)
    copy_into(sent.position_x, filters.pkf.x)
    joint_filter.copy_block(filters, R, sent.position_p)


@kernel
def read_input(sent, not_before_s, imu, reference, poses):
    """Write IMU, REFERENCE and the poses (POSE) of ``sent`` (GNC_INPUT); return the number of poses.

    Poses exposed before ``not_before_s`` are discarded. Fields that the input does not have (true drift and bias,
    number and line of the phase) keep their values.
    """
    copy_into(imu.rate_C, sent.rate_radps)
    copy_into(imu.force_C, sent.force_mps2)
    copy_into(reference.r_CT_H, sent.reference_r_CT_H_m)
    copy_into(reference.v_CT_H, sent.reference_v_CT_H_mps)
    copy_into(reference.a_CT_H, sent.reference_a_CT_H_mps2)
    copy_into(reference.q_CH, sent.reference_q_CH)
    reference.boost = sent.boost
    came = 0
    measured = sent.measured
    for i in range(measured.n_poses):
        if not measured.poses[i].t_s < not_before_s:
            read_sent(measured.poses[i], poses[came])
            came += 1
    return came


@kernel
def write_output(cycle, navigation, command, n_thrusters, out):
    """Write the reply to the input ``cycle`` into ``out`` (GNC_OUTPUT): thrusters, and the estimate if it is valid."""
    out.cycle = cycle
    out.state = _WORKING
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
    copy_into(out.protection_level_m, navigation.protection_level_m)
    out.protection_level_rad = navigation.protection_level_rad
    out.health = navigation.health
