"""Navigation by vision alone: backend ``vision_alone``, and what is left when the IMU has failed."""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.gnc import integrity, vision_only
from hil.maths.arrays import copy_into, fill


@kernel
def navigate(params, state, poses, n_poses, out):
    """Use the first ``n_poses`` of ``poses`` (POSE); write ``out`` (NAVIGATION), without standard deviations.

    params, state: NAVIGATION_PARAMS, NAVIGATION_STATE.
    """
    if state.vision_only.started != 0:
        vision_only.predict(params.vision_only, state.vision_only)
    for i in range(n_poses):
        if integrity.admits(params.integrity, state.integrity, poses[i]):
            vision_only.update(params.vision_only, state.vision_only, poses[i])
    _write_vision_only(state.vision_only, out)
    age_s = state.t_s - state.vision_only.last_t_s
    out.health = integrity.vision_health(
        params.integrity, state.integrity, age_s, state.vision_only.rejected_in_a_row
    )  # fmt: skip
    out.valid = state.vision_only.started


@kernel
def _write_vision_only(state, out):
    copy_into(out.r_CT_H, state.r_CT_H)
    copy_into(out.v_CT_H, state.v_CT_H)
    copy_into(out.q_CH, state.q_CH)
    copy_into(out.w_CH_C, state.w_CH_C)
    fill(out.sigma_r_m, np.nan)
    fill(out.sigma_v_mps, np.nan)
    fill(out.sigma_attitude_rad, np.nan)
    out.nis_position = np.nan
    out.nis_attitude = np.nan
