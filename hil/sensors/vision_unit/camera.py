"""Stereo camera: two parallel pinhole cameras, and whether all LEDs of a target are in view of both.

The left camera's axes are v (x right, y down, z along its optical axis); the right one is parallel to
it at ``baseline`` along x_v. The principal points are the images' centres; there is no distortion.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack

CAMERA = np.dtype(
    [
        ("focal", "f8"),  # px
        ("width", "f8"),  # px
        ("height", "f8"),  # px
        ("baseline", "f8"),  # m
    ],
    align=True,
)


@kernel
def edge_distance(camera, x, y, z):
    """Return the distance, px, of the image of the point (x, y, z), m in the camera's axes, from the nearest edge.

    Negative outside the image; minus infinity for a point that is not in front of the camera.
    """
    if z <= 0.0:
        return -np.inf
    across = 0.5 * camera.width - abs(camera.focal * x / z)
    down = 0.5 * camera.height - abs(camera.focal * y / z)
    return min(across, down)


@kernel
def view_margin(camera, leds, t_v, q_vt):
    """Return the smallest ``edge_distance``, px, of all LEDs in both images.

    leds: (n, 3), m, in t. t_v: (3,), m, and q_vt: (4,), the pose t -> v, ``p_v = A(q_vt) p_t + t_v``.
    """
    least = np.inf
    p = stack.vector(3)
    for j in range(leds.shape[0]):
        quat.transform_into(q_vt, leds[j], p)
        x, y, z = p[0] + t_v[0], p[1] + t_v[1], p[2] + t_v[2]
        least = min(least, edge_distance(camera, x, y, z), edge_distance(camera, x - camera.baseline, y, z))
    return least
