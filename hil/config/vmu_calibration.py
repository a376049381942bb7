"""Calibration record in a geometry file: identity, quality, and the reference of later drift checks."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hil.config.model import ConfigModel, Matrix3, NotNegative, Positive, Triple


class Calibration(ConfigModel):
    """The ``[calibration]`` table of a geometry file, as ``hil calibrate`` writes it."""

    id: str
    date: str
    target: str
    """``leds``, or ``board 11x8 30 mm``"""
    views: Annotated[int, Field(ge=1)]
    rms_px: NotNegative
    noise: Positive
    """factor of the assumed standard deviations of spots or corners"""
    rail_sigma_m: Positive
    gimbal_sigma_deg: Positive
    lever_arm_m: Triple
    """of the rig, as ``gimbal_order`` and the next four: hil/config/rig.py"""
    gimbal_order: Literal["zyx", "zxy", "yzx", "yxz", "xyz", "xzy"]
    camera_position_m: Triple
    camera_axes: Matrix3
    target_position_m: Triple
    target_axes: Matrix3
    sigma: dict[str, NotNegative] = Field(default_factory=dict)
    """standard deviation of each number, in the unit of its name"""
    covariance: tuple[tuple[float, ...], ...]
    """lower triangle: both cameras, stereo, mounting, target, scale, and the layout of LEDs if estimated"""

    @model_validator(mode="after")
    def _covariance_is_a_triangle(self) -> Self:
        if any(len(row) != k + 1 for k, row in enumerate(self.covariance)):
            raise ValueError("covariance: its rows must have 1, 2, 3, ... numbers")
        return self
