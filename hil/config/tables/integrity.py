"""Alert limits: errors of the navigation that must not stay unnoticed."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil.config.tables.model import ConfigModel, NotNegative, Positive


class Integrity(ConfigModel):
    """Alert limits of the navigation, and the time in which a larger error must be noticed."""

    alert_axial_m: Positive = 0.06
    """Along the docking axis at range 0; at most the distance to the keep-out after braking."""
    alert_axial_per_range_scale: NotNegative = 0.1
    """Its increase per metre of range."""
    alert_corridor_fraction: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    """Across the docking axis, of the corridor's radius."""
    alert_attitude_deg: Positive = 1.0
    """Of the attitude."""
    time_to_alert_s: NotNegative = 1.0
    """Longest time for which an error beyond its alert limit may stay unnoticed."""
