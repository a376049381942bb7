"""Table `[floating]` of a rig: a vehicle that floats on a level floor, and its simulation."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.tables.model import ConfigModel, NotNegative, Positive

Slope = Annotated[float, Field(ge=-5.0, le=5.0)]


class Floating(ConfigModel):
    """A vehicle that floats in the x-z plane of H. The truth is the pose that is measured, no axis has a drive, and the
    thruster lines of `[io]` fire its thrusters."""

    pose: Literal["vmu"] = "vmu"
    """Device that measures the pose: the vision unit, or the tracker that sends in its place."""
    pose_lost_s: Positive = 0.5
    """Longest time without a pose: then the bench stops and closes all valves."""
    rate_window_s: Annotated[float, Field(gt=0.0, le=5.0)] = 1.0
    """Poses to which the velocity and the rate of the truth are fitted; half of it is their delay."""
    start_error_max_m: Positive = 0.2
    """Largest distance of the first pose from the start of the plan."""
    start_error_max_deg: Positive = 10.0
    """The same of the attitude."""
    tilt_deg: tuple[Slope, Slope] = (0.0, 0.0)
    """Simulated floor: slope along x and z of H, downwards."""
    friction_mps2: NotNegative = 0.0
    """Simulated floor: deceleration by friction."""
