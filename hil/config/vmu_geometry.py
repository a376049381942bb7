"""Geometry file of a vision unit: LED layout, cameras, and the calibration that it comes from."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from hil.config.camera_identity import CameraIdentity
from hil.config.tables.model import ConfigModel, Matrix3, NotNegative, Positive, Triple
from hil.maths import linear

_BASELINE_M, _LED_M, _FOCAL = 10.0, 20.0, (0.05, 200.0)
"""Largest sizes of a bench, and focal lengths in widths of the image."""
OFFICIAL: Final = "official"
OPENCV: Final = "opencv"
LEGACY: Final = "legacy"


class Calibration(ConfigModel):
    """The ``[calibration]`` table of a geometry file, as ``hil calibrate`` writes it."""

    id: str
    """Identity of the calibration."""
    date: str
    """Date."""
    target: str
    """``leds``, or ``board 11x8 30 mm``."""
    views: Annotated[int, Field(ge=1)]
    """Number of views used."""
    rms_px: NotNegative
    """Residuals."""
    noise: Positive
    """Factor of the assumed standard deviations of spots or corners."""
    rail_sigma_m: Positive
    """Given accuracy of the rails."""
    gimbal_sigma_deg: Positive
    """Given accuracy of the gimbals."""
    lever_arm_m: Triple
    """Of the rig."""
    gimbal_order: Literal["zyx", "zxy", "yzx", "yxz", "xyz", "xzy"]
    """Of the rig."""
    camera_position_m: Triple
    """Calibrated mounting."""
    camera_axes: Matrix3
    """Calibrated mounting."""
    target_position_m: Triple
    """Calibrated position of the target."""
    target_axes: Matrix3
    """Calibrated axes of the target."""
    sigma: dict[str, NotNegative] = Field(default_factory=dict)
    """Standard deviation of each number, in the unit of its name."""
    covariance: tuple[tuple[float, ...], ...]
    """Lower triangle: both cameras, stereo, mounting, target, scale, and the layout of LEDs if estimated."""

    @model_validator(mode="after")
    def _covariance_is_a_triangle(self) -> Self:
        if any(len(row) != k + 1 for k, row in enumerate(self.covariance)):
            raise ValueError("covariance: its rows must have 1, 2, 3, ... numbers")
        return self


Pixels = Annotated[int, Field(ge=16, le=16384)]
Distortion = Annotated[tuple[float, float, float, float, float], Field()]


class VmuCamera(ConfigModel):
    """One camera: pinhole and Brown-Conrady distortion; pixel centres at whole numbers."""

    fx: Positive
    """Focal length along u."""
    fy: Positive
    """Focal length along v."""
    cx: float
    """Principal point."""
    cy: float
    """Principal point."""
    width: Pixels
    """Image width."""
    height: Pixels
    """Image height."""
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1 k2 p1 p2 k3, in OpenCV's order."""
    row_time_s: Annotated[float, Field(ge=-1e-3, le=1e-3)] | None = None
    """From the exposure of an image row to that of the next one below, of a rolling shutter; negative if rows are read
    upwards. The time of an image is that of its middle row. Default: a global shutter, of cameras that report no other.
    """
    identity: CameraIdentity | None = None
    """The camera that this was measured of."""


class Sensor(ConfigModel):
    """Noise of the camera sensors; by default the detector estimates it from the image."""

    electrons_per_level: Positive
    """Electrons per grey level."""
    read_noise_levels: NotNegative
    """Read noise, 1 sigma."""


class Tolerances(ConfigModel):
    """Errors of calibration and target, 1 sigma, that the pose's covariance includes.

    Default: a usual calibration on a chessboard; zeros for cameras and LEDs that are exact (simulation).
    The covariance of ``hil calibrate`` takes the place of those that it covers.
    """

    principal_point_px: NotNegative = 0.2
    """Principal point of each camera, along u and v."""
    focal_fraction: NotNegative = 1e-3
    """Focal length of each camera, relative."""
    focal_scale: NotNegative = 1e-3
    """Focal lengths of both cameras alike, relative: a chessboard of another pitch, focus, temperature."""
    distortion_px: NotNegative = 0.2
    """Lens distortion at the image's corner."""
    rotation_deg: NotNegative = 0.02
    """Rotation of the right camera, about each axis."""
    baseline_m: NotNegative = 1e-4
    """Position of the right camera, along each axis."""
    led_m: NotNegative = 1e-4
    """Position of each LED, along each axis."""
    led_scale: NotNegative = 3e-3
    """Size of the ring, relative: all LEDs alike about their centre."""
    spot_px: NotNegative = 0.01
    """Least error of a spot beyond its noise; a larger one is estimated from the residuals."""
    sync_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Time between the exposures of both cameras: 0 with a common trigger."""
    vibration_px: NotNegative = 0.0
    """Vibration of each camera, along u and v, another in each pair of images. A larger one of the cameras against each
    other is learnt from a track, one of both alike is not."""


class VmuGeometry(ConfigModel):
    """Target and cameras of a vision unit."""

    leds_m: Annotated[tuple[Triple, ...], Field(min_length=3, max_length=32)]
    """LEDs in the frame of the ring, t."""
    left: VmuCamera
    """Left camera."""
    right: VmuCamera
    """Right camera."""
    baseline_m: Triple
    """Right camera in the left one's frame."""
    right_rotation_rad: Triple = (0.0, 0.0, 0.0)
    """Rotation vector of the right camera's axes in the left one's: ``p_v = R p_right + baseline_m``."""
    marked_led: Annotated[int, Field(ge=0)] | None = None
    """Index of an LED that is brighter by a factor of at least 1.3."""
    print: Literal["official", "opencv", "legacy"] | None = None
    """Which way a target of `apriltag` or `charuco` is printed. AprilTags: `official`, as by the AprilTag library and
    `hil targets print`, or `opencv`, turned by 180 deg. ChArUco boards: `opencv`, or `legacy`, of OpenCV before 4.6.
    Unless set, it is taken from the places of several tags; poses that it leaves open are `rejected_print`."""
    sensor: Sensor | None = None
    tolerances: Tolerances = Tolerances.model_construct()
    calibration: Calibration | None = None
    """Record of ``hil calibrate``."""

    @property
    def identities(self) -> dict[str, CameraIdentity | None]:
        """Identities of the cameras, by ``left`` and ``right``."""
        return {"left": self.left.identity, "right": self.right.identity}

    @model_validator(mode="after")
    def _sizes_are_of_a_bench(self) -> Self:
        for name, points, largest in (("baseline_m", (self.baseline_m,), _BASELINE_M), ("leds_m", self.leds_m, _LED_M)):
            longest = max(linear.length(point) for point in points)
            if longest > largest:
                raise ValueError(f"{name}: {longest:g} m, allowed {largest:g} m: millimetres?")
        turn = linear.length(self.right_rotation_rad)
        if turn > math.pi + 1e-9:
            raise ValueError(f"right_rotation_rad: {turn:g} rad, allowed 3.1416 rad: degrees?")
        for side in ("left", "right"):
            camera = getattr(self, side)
            fractions = camera.fx / camera.width, camera.fy / camera.width
            if not all(_FOCAL[0] <= each <= _FOCAL[1] for each in fractions):
                text = f"{camera.fx:g}, {camera.fy:g} px of {camera.width} px width: pixels, not millimetres?"
                raise ValueError(f"{side}.fx, fy: {text}")
        return self
