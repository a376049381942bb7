"""What the cameras of the bench have in view while its axes move."""

from __future__ import annotations

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.maths.camera import view_margin
from hil.maths.jit import kernel
from hil.maths.stations import camera_pose


@kernel
def view_margins(params, stations, camera, leds, rail_m, gimbal_rad, out):
    """Write for each row of ``rail_m`` and ``gimbal_rad`` (n, 3) the least distance of a lamp from an image's edge, px.

    params: BENCH_PARAMS. stations: STATIONS. camera: CAMERA. leds: (m, 3), m, in t. out: (n,).
    """
    r, q = np.empty(3), np.empty(4)
    t_v, q_vt = np.empty(3), np.empty(4)
    for k in range(out.shape[0]):
        pose_of_axes(params, rail_m[k], gimbal_rad[k], r, q)
        camera_pose(stations, r, q, t_v, q_vt)
        out[k] = view_margin(camera, leds, t_v, q_vt)
