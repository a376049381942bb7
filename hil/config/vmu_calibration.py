"""Calibration record in a geometry file: identity, quality, and the reference of later drift checks."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hil.config.model import ConfigModel, Matrix3, NotNegative, Positive, Triple


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
