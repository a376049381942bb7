"""Conversion of a geometry file to the records of the kernels."""

from __future__ import annotations

import numpy as np

from hil.config.rig import Rig
from hil.config.vmu_geometry import VmuCamera, VmuGeometry
from hil.core.messages import Array
from hil.vmu.kernels.lens import LENS, CameraPair


def lenses(*cameras: VmuCamera) -> np.ndarray:
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
    from scipy.spatial.transform import Rotation  # slow to import

    lens = lenses(geometry.left, geometry.right)
    rotation = np.empty((2, 3, 3))
    rotation[0] = np.eye(3)
    rotation[1] = Rotation.from_rotvec(geometry.right_rotation_rad).as_matrix().T
    translation = np.zeros((2, 3))
    translation[1] = -rotation[1] @ np.array(geometry.baseline_m)
    return CameraPair(lens, rotation, translation)


def led_positions(geometry: VmuGeometry) -> Array:
    """Return the positions of the LEDs in t, (n, 3), m."""
    return np.array(geometry.leds_m, dtype=float)


def geometry_of_rig(rig: Rig) -> VmuGeometry:
    """Return the nominal cameras and LEDs of a rig file: principal points in the middle, no distortion."""
    on_paper = rig.vmu.camera
    camera = VmuCamera(
        fx=on_paper.focal_px,
        fy=on_paper.focal_px,
        cx=0.5 * (on_paper.width_px - 1),
        cy=0.5 * (on_paper.height_px - 1),
        width=on_paper.width_px,
        height=on_paper.height_px,
    )
    return VmuGeometry(leds_m=rig.vmu.leds_m, left=camera, right=camera, baseline_m=(on_paper.baseline_m, 0.0, 0.0))
