"""Innovation of a sample against an estimate at another time, by the ``innovate`` of its module."""

from __future__ import annotations

from hil.core.foreign_call import call_address
from hil.core.jit import kernel
from hil.core.sensor_records import COMPONENTS_MAX
from hil.gnc.estimation.target_orbit import frame_attitude
from hil.maths import quat, stack
from hil.maths.arrays import fill, fill_matrix
from hil.maths.record_view import copy_record

_ERROR_SIGMAS = 3.0  # sigmas of a constant error for which the module states no tolerance


@kernel
def innovate(params, slot, state, sample, r_CT_H, v_CT_H, q_CH, w_CH_C, delta_s):
    """Write ``state.innovation`` of ``sample``, which was measured ``delta_s`` after the estimate.

    params: SENSOR_FUSION_PARAMS. slot: SENSOR_SLOT. state: SENSOR_FUSION_STATE. The estimate moves with its own rates,
    ``w_CH_C`` (3,), rad/s.
    """
    estimate, innovation = state.estimate, state.innovation
    turn, rotation = stack.vector(3), stack.vector(4)
    estimate.t_s = sample.t_s
    for i in range(3):
        estimate.r_CT_H[i] = r_CT_H[i] + delta_s * v_CT_H[i]
        estimate.v_CT_H[i] = v_CT_H[i]
        estimate.w_CH_C[i] = w_CH_C[i]
        estimate.sun_I[i] = params.sun_I[i]
        turn[i] = delta_s * w_CH_C[i]
    quat.from_rotation_vector_into(turn, rotation)
    quat.multiply_into(rotation, q_CH, estimate.q_CH)
    frame_attitude(params.orbit, params.q_HI, sample.t_s, estimate.q_HI)
    copy_record(sample, innovation.sample)
    fill(innovation.value, 0.0)
    fill(innovation.tolerance, 0.0)
    fill_matrix(innovation.h, 0.0)
    fill_matrix(innovation.h_errors, 0.0)
    for k in range(slot.errors):
        innovation.h_errors[slot.component[k], k] = 1.0
        innovation.tolerance[slot.component[k]] += _ERROR_SIGMAS * slot.sigma[k]
    for i in range(COMPONENTS_MAX):
        for j in range(COMPONENTS_MAX):
            innovation.noise[i, j] = sample.covariance[i, j]
    call_address(slot.innovate, estimate, innovation, slot)
