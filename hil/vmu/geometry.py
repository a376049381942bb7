"""Conversion of a geometry file to the records of the kernels."""

from __future__ import annotations

import numpy as np

from hil.config.rig import Rig, Vmu
from hil.config.vmu_geometry import Tolerances, VmuCamera, VmuGeometry
from hil.core.messages import Array
from hil.vmu.kernels.chain import COMMON
from hil.vmu.kernels.lens import LENS, CameraPair
from hil.vmu.kernels.records import SHARED


def lenses(*cameras: VmuCamera) -> np.ndarray:
    """Return ``cameras`` as an array of LENS."""
    records = np.zeros(len(cameras), LENS)
    for record, camera in zip(records, cameras, strict=True):
        for name in ("fx", "fy", "cx", "cy", "width", "height"):
            record[name] = getattr(camera, name)
        record["row_s"] = camera.row_time_s or 0.0
        for name, value in zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion, strict=True):
            record[name] = value
    return records


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


EXACT = Tolerances(**dict.fromkeys(Tolerances.model_fields, 0.0))
"""Tolerances of cameras and LEDs without errors, as simulated."""

_FLOORS_PX = (0.017, 0.03, 0.05, 0.08, 0.12, 0.18, 0.26, 0.38)


def led_positions(geometry: VmuGeometry) -> Array:
    """Return the positions of the LEDs in t, (n, 3), m."""
    return np.array(geometry.leds_m, dtype=float)


def considered_covariance(geometry: VmuGeometry) -> Array:
    """Return the covariance of the considered parameters of ``RingScene``, from calibration or tolerances.

    The calibration's is used for the cameras and, if it has estimated it, the layout of the LEDs. Its derivatives by
    the right camera's rotation vector are taken for small rotations: right to 5 % for cameras turned by 6 deg.
    """
    n = len(geometry.leds_m)
    covariance = np.zeros((SHARED + 3 * n, SHARED + 3 * n))
    stated = geometry.tolerances
    for side, camera in enumerate((geometry.left, geometry.right)):
        _add_camera(covariance[9 * side : 9 * side + 9, 9 * side : 9 * side + 9], camera, stated)
    index = np.arange(len(covariance))
    rest = [np.radians(stated.rotation_deg)] * 3 + [stated.baseline_m] * 3 + [stated.led_m] * (3 * n)
    covariance[index[18:], index[18:]] = np.square(rest)
    focal = np.zeros(len(covariance))
    focal[[0, 1, 9, 10]] = geometry.left.fx, geometry.left.fy, geometry.right.fx, geometry.right.fy
    covariance += stated.focal_scale**2 * np.outer(focal, focal)
    leds = led_positions(geometry)
    ring = np.concatenate([np.zeros(SHARED), (leds - leds.mean(axis=0)).ravel()])
    covariance += stated.led_scale**2 * np.outer(ring, ring)
    if geometry.calibration is not None:
        rows = geometry.calibration.covariance
        covered = np.zeros((len(rows), len(rows)))
        for k, row in enumerate(rows):
            covered[k, : k + 1] = covered[: k + 1, k] = row
        kept = np.r_[:SHARED, COMMON : len(rows)]
        size = len(kept)
        if size in (SHARED, len(covariance)):
            covariance[:size, :size] = covered[np.ix_(kept, kept)]
    return covariance


def _add_camera(out: Array, camera: VmuCamera, stated: Tolerances) -> None:
    """Write the covariance of fx fy cx cy k1 k2 p1 p2 k3; both focal lengths have the same relative error."""
    focal = np.array([camera.fx, camera.fy])
    out[:2, :2] = stated.focal_fraction**2 * np.outer(focal, focal)
    out[2, 2] = out[3, 3] = stated.principal_point_px**2
    corner = 0.5 * np.hypot(camera.width, camera.height) / float(focal.mean())
    out[4, 4] = (stated.distortion_px / (float(focal.mean()) * corner**3)) ** 2


def spot_floors(least_px: float) -> Array:
    """Return the floors of a spot's error that are compared, px, ascending from ``least_px``."""
    larger = [floor for floor in _FLOORS_PX if floor > 1.2 * least_px]
    return np.array([max(least_px, 1e-6), *larger])


def geometry_of_rig(rig: Rig) -> VmuGeometry:
    """Return the nominal cameras and LEDs of a rig file."""
    return nominal_geometry(rig.vmu)


def nominal_geometry(vmu: Vmu) -> VmuGeometry:
    """Return the nominal cameras and LEDs of a vision unit, exact: principal points in the middle, no distortion."""
    on_paper = vmu.camera
    camera = VmuCamera(
        fx=on_paper.focal_px,
        fy=on_paper.focal_px,
        cx=0.5 * (on_paper.width_px - 1),
        cy=0.5 * (on_paper.height_px - 1),
        width=on_paper.width_px,
        height=on_paper.height_px,
    )
    return VmuGeometry(
        leds_m=vmu.leds_m,
        left=camera,
        right=camera,
        baseline_m=(on_paper.baseline_m, 0.0, 0.0),
        tolerances=EXACT,
    )
