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
    """px, as fy, cx and cy"""
    fy: Positive
    cx: float
    cy: float
    width: Pixels
    height: Pixels
    distortion: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1 k2 p1 p2 k3, in OpenCV's order"""


class Sensor(ConfigModel):
    """Noise of the camera sensors; by default the detector estimates it from the image."""

    electrons_per_level: Positive
    read_noise_levels: NotNegative


class VmuGeometry(ConfigModel):
    """Target and cameras of a vision unit."""

    leds_m: Annotated[tuple[Triple, ...], Field(min_length=3, max_length=8)]
    """positions in the target's frame t"""
    left: VmuCamera
    right: VmuCamera
    baseline_m: Triple
    """position of the right camera in the left camera's frame"""
    right_rotation_rad: Triple = (0.0, 0.0, 0.0)
    """rotation vector of the right camera's axes in the left one's: ``p_v = R p_right + baseline_m``"""
    marked_led: Annotated[int, Field(ge=0)] | None = None
    """index of the LED that is brighter than the others, if any"""
    sensor: Sensor | None = None
    calibration: Calibration | None = None
    """record of ``hil calibrate``"""
