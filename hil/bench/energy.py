"""Energy that the axes add to a run: work of the thrusters on the truth less their work on the bench.

The loop closes over the bench's motion, while the thrusters act on the truth. Where the axes are late, the forces do
more work on the truth than on what the sensors see, as if the loop had negative damping: the passivity observer of
Hannaford and Ryu (2002), for the bench as the element between the two.
"""

from __future__ import annotations

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.core.jit import kernel
from hil.maths import quat

TRANSLATION_ADDED, TRANSLATION_WORK, ROTATION_ADDED, ROTATION_WORK = range(4)


@kernel
def _small_rotation(q, q_before, out):
    """Write the small rotation (3,), rad, that takes ``q_before`` to ``q``, in the axes of c."""
    turn = quat.multiply(q, quat.conjugate(q_before))
    sign = 2.0 if turn[3] >= 0.0 else -2.0
    for i in range(3):
        out[i] = sign * turn[i]


@kernel
def add_work(params, force_C, torque_C, rail_m, gimbal_rad, r_CT_H, q_CH, out):
    """Add the work over the given rows to ``out`` (4,), J: indices TRANSLATION_ADDED to ROTATION_WORK.

    params: BENCH_PARAMS. force_C, torque_C: (n, 3), N and N m about the reference point, means over the step that ends
    at a row; the first row's do not count. rail_m, gimbal_rad: (n, 3), where the axes are. r_CT_H (n, 3), m, q_CH
    (n, 4): the truth. Work without sign is the sum of its magnitudes over the steps, to which what is added relates.
    """
    r, q = np.empty(3), np.empty(4)
    error, error_before, turn, turn_before, moved = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(rail_m.shape[0]):
        pose_of_axes(params, rail_m[k], gimbal_rad[k], r, q)
        for i in range(3):
            error[i] = r[i] - r_CT_H[k, i]
        _small_rotation(q, q_CH[k], turn)
        if k > 0:
            force = quat.transform_back(q_CH[k], force_C[k])
            _small_rotation(q_CH[k], q_CH[k - 1], moved)
            work = torque_work = 0.0
            for i in range(3):
                out[TRANSLATION_ADDED] -= force[i] * (error[i] - error_before[i])
                out[ROTATION_ADDED] -= torque_C[k, i] * (turn[i] - turn_before[i])
                work += force[i] * (r_CT_H[k, i] - r_CT_H[k - 1, i])
                torque_work += torque_C[k, i] * moved[i]
            out[TRANSLATION_WORK] += abs(work)
            out[ROTATION_WORK] += abs(torque_work)
        error_before[:] = error
        turn_before[:] = turn
