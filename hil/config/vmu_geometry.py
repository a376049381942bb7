"""Geometry file of a vision unit: LED layout and cameras."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil.config.model import ConfigModel, NotNegative, Positive, Triple
from hil.config.vmu_calibration import Calibration

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


class Sensor(ConfigModel):
    """Noise of the camera sensors; by default the detector estimates it from the image."""

    electrons_per_level: Positive
    """Electrons per grey level."""
    read_noise_levels: NotNegative
    """Read noise, 1 sigma."""


class Tolerances(ConfigModel):
    """Errors of calibration and target, 1 sigma, that the pose's covariance includes.

    By default those of a usual calibration on a chessboard; zeros for cameras and LEDs that are exact (simulation).
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
    sensor: Sensor | None = None
    tolerances: Tolerances = Tolerances()
    calibration: Calibration | None = None
    """Record of ``hil calibrate``."""
