"""From a geometry file's numbers to what the kernels take."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hil.config.vmu_geometry import Camera, VmuGeometry
from hil.messages import Array
from hil.vmu.kernels.lens import LENS, CameraPair


def lenses(*cameras: Camera) -> np.ndarray:
    """Return ``cameras`` as an array of LENS."""
    found = np.zeros(len(cameras), LENS)
    for record, camera in zip(found, cameras, strict=True):
        for name in ("fx", "fy", "cx", "cy", "width", "height"):
            record[name] = getattr(camera, name)
        for name, value in zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion, strict=True):
            record[name] = value
    return found


def camera_pair(geometry: VmuGeometry) -> CameraPair:
    """Return the two cameras of ``geometry``."""
    lens = lenses(geometry.left, geometry.right)
    rotation = np.empty((2, 3, 3))
    rotation[0] = np.eye(3)
    rotation[1] = Rotation.from_rotvec(geometry.right_rotation_rad).as_matrix().T
    translation = np.zeros((2, 3))
    translation[1] = -rotation[1] @ np.array(geometry.baseline_m)
    return CameraPair(lens, rotation, translation)


def led_positions(geometry: VmuGeometry) -> Array:
    """Return where the LEDs are in t, (n, 3), m."""
    return np.array(geometry.leds_m, dtype=float)
