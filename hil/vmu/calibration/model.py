"""Model of a calibration: parameters to be estimated, bench kinematics, observations and their projection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from hil.config.rig import UNIT_AXES, BenchGeometry
from hil.config.vmu_geometry import VmuCamera, VmuGeometry
from hil.core.messages import Array
from hil.errors import BadInput
from hil.vmu.kernels import chain
from hil.vmu.kernels.chain import (
    BASELINE,
    CAMERA_POSITION,
    CAMERA_ROTATION,
    COMMON,
    LEFT,
    RIGHT,
    ROTATION,
    SCALE,
    TARGET_POSITION,
    TARGET_ROTATION,
)

_LENS_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_LENS_UNITS = ("px",) * 4 + ("",) * 5
PARTS: Final[dict[str, slice]] = {
    "left": slice(LEFT, RIGHT),
    "right": slice(RIGHT, ROTATION),
    "stereo": slice(ROTATION, CAMERA_ROTATION),
    "mounting": slice(CAMERA_ROTATION, TARGET_ROTATION),
    "target": slice(TARGET_ROTATION, SCALE),
    "scale": slice(SCALE, COMMON),
}
"""Ranges of a vector of COMMON by subject; the layout of the LEDs follows after them."""
SIDES: Final = ("left", "right")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter to be estimated: its name and display unit."""

    name: str
    unit: str
    shown: float  # display units per internal unit


def parameters(points: int = 0) -> list[Parameter]:
    """Return all shared unknowns in order, followed by the layout of ``points`` LEDs."""
    entries = [
        Parameter(f"{side}.{name}", unit, 1.0)
        for side in SIDES
        for name, unit in zip(_LENS_NAMES, _LENS_UNITS, strict=True)
    ]
    for part in ("stereo", "mounting", "target"):
        entries += [Parameter(f"{part}.turn_{axis}", "deg", math.degrees(1.0)) for axis in "xyz"]
        entries += [Parameter(f"{part}.{axis}", "mm", 1e3) for axis in "xyz"]
    entries.append(Parameter("scale", "", 1.0))
    entries += [Parameter(f"led_{led}.{axis}", "mm", 1e3) for led in range(points) for axis in "xyz"]
    return entries


@dataclass(frozen=True, slots=True)
class TurntableModel:
    """Kinematics of the turntable that carries the cameras. lever_arm: (3,), m. order: (3,), outer to inner."""

    lever_arm: Array
    order: Array

    @classmethod
    def of(cls, bench: BenchGeometry) -> TurntableModel:
        """Return the turntable model of a rig file. Raises BadInput if L is not parallel to H."""
        if bench.lab_axes != UNIT_AXES:
            raise BadInput.single("rig", "rig.bench.lab_axes", "cameras are calibrated with L parallel to H")
        return cls(
            np.array(bench.lever_arm_m, dtype=float), np.array(["xyz".index(axis) for axis in bench.gimbal_order])
        )


@dataclass(frozen=True, slots=True)
class Observations:
    """Measured pixels of the target's points in both cameras in n views.

    axes: (n, 6), rails, m, gimbals, rad, from the encoders. pixels: (n, 2, m, 2), NaN for a point that was
    not measured. covariance: (n, 2, m, 2, 2), px^2.
    """

    names: tuple[str, ...]
    axes: Array
    pixels: Array
    covariance: Array

    @property
    def visible(self) -> np.ndarray:
        """Return which points were measured, (n, 2, m)."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1))

    def only(self, views: Sequence[int] | np.ndarray) -> Observations:
        """Return the views of the given indices."""
        chosen = np.asarray(views, dtype=int)
        names = tuple(self.names[k] for k in chosen)
        return Observations(names, self.axes[chosen], self.pixels[chosen], self.covariance[chosen])

    def without(self, points: np.ndarray) -> Observations:
        """Return a copy without the points marked in ``points`` (n, 2, m)."""
        pixels = self.pixels.copy()
        pixels[points] = np.nan
        return replace(self, pixels=pixels)


@dataclass(frozen=True, slots=True)
class Setup:
    """All parameters to be estimated: theta (COMMON,), camera_axes and target_axes (3, 3) of hil/vmu/kernels/chain.py.

    points: (m, 3), m, in the target's axes. sizes: (2, 2), width and height of the images, px.
    The small rotations about camera_axes and target_axes are zero: see ``folded``.
    """

    theta: Array
    camera_axes: Array
    target_axes: Array
    points: Array
    sizes: Array

    @classmethod
    def of(cls, geometry: VmuGeometry, bench: BenchGeometry, points: Array | None = None) -> Setup:
        """Return the nominal setup of the files. points: of a target other than the LEDs."""
        theta = np.zeros(COMMON)
        for first, camera in ((LEFT, geometry.left), (RIGHT, geometry.right)):
            theta[first : first + 9] = lens_numbers(camera)
        theta[ROTATION:BASELINE] = geometry.right_rotation_rad
        theta[BASELINE:CAMERA_ROTATION] = geometry.baseline_m
        theta[CAMERA_POSITION:TARGET_ROTATION] = bench.camera_position_m
        theta[TARGET_POSITION:SCALE] = bench.led_ring_position_m
        theta[SCALE] = 1.0
        sizes = np.array([[c.width, c.height] for c in (geometry.left, geometry.right)], dtype=float)
        leds = np.array(geometry.leds_m, dtype=float)
        target_axes = np.ascontiguousarray(np.array(bench.led_ring_axes).T)
        return cls(theta, np.array(bench.camera_axes), target_axes, leds if points is None else points, sizes)

    def folded(self) -> Setup:
        """Return an equal setup with the small rotations included in the axes, orthonormalised."""
        theta = self.theta.copy()
        camera = chain.rotation_matrix(theta[CAMERA_ROTATION:CAMERA_POSITION]) @ self.camera_axes
        target = chain.rotation_matrix(theta[TARGET_ROTATION:TARGET_POSITION]) @ self.target_axes
        theta[CAMERA_ROTATION:CAMERA_POSITION] = 0.0
        theta[TARGET_ROTATION:TARGET_POSITION] = 0.0
        return replace(self, theta=theta, camera_axes=orthonormal(camera), target_axes=orthonormal(target))

    def moved(self, change: Array, layout: Array | None = None) -> Setup:
        """Return the setup changed by ``change`` (COMMON,) and its points by ``layout`` (m, 3)."""
        points = self.points if layout is None else self.points + layout
        return replace(self, theta=self.theta + change, points=points).folded()


@dataclass(frozen=True, slots=True)
class Projection:
    """Pixels of one view and their derivatives; shapes as in ``chain.project_target``."""

    pixels: Array
    by_common: Array
    by_point: Array
    by_axes: Array


def project_view(setup: Setup, turntable: TurntableModel, axes: Array) -> Projection:
    """Return the pixels in both cameras and their derivatives with the bench's axes at ``axes`` (6,)."""
    m = len(setup.points)
    out = (np.empty((2, m, 2)), np.empty((2, m, 2, COMMON)), np.empty((2, m, 2, 3)), np.empty((2, m, 2, 6)))
    mount = (setup.camera_axes, setup.target_axes, turntable.lever_arm, turntable.order)
    chain.project_target(setup.theta, *mount, np.ascontiguousarray(axes), setup.points, *out)
    return Projection(*out)


def lens_numbers(camera: VmuCamera) -> Array:
    """Return the nine numbers of a camera in the order of COMMON."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])


def orthonormal(matrix: Array) -> Array:
    """Return the rotation nearest to ``matrix`` (3, 3)."""
    u, _, vt = np.linalg.svd(matrix)
    nearest: Array = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.ascontiguousarray(nearest)


def camera_of(theta: Array, side: int, size: Array) -> dict[str, Any]:
    """Return the keys of one camera in a geometry file."""
    numbers = [float(x) for x in theta[9 * side : 9 * side + 9]]
    keys: dict[str, Any] = dict(zip(_LENS_NAMES[:4], numbers[:4], strict=True))
    keys |= {"width": int(size[0]), "height": int(size[1]), "distortion": numbers[4:]}
    return keys
