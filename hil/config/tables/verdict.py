"""Parts of the verdict on a run, and the alert limits of its navigation.

A part that is added to the table can be required by a scenario, counts for ``passed_all_parts`` and ``accepted``, and
is a column of campaigns. What judges it and its line of text are in ``hil/report``, under the same name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Final

from pydantic import Field

from hil.config.tables.model import ConfigModel, NotNegative, Positive

PART_COLUMNS: Final[Mapping[str, str]] = {
    "control_precision": "passed",
    "security": "security_passed",
    "energy": "energy_passed",
    "field_of_view": "view_passed",
    "integrity": "integrity_passed",
    "decision": "decision_passed",
}
"""Part, by its key in the JSON of a run -> flag of a campaign's case."""


def required_parts(chosen: Iterable[str] | None, judged: Iterable[str]) -> list[str]:
    """Return the parts that a run must pass: those ``chosen`` by its scenario, or all that were ``judged``."""
    parts = set(judged if chosen is None else chosen)
    return [name for name in PART_COLUMNS if name in parts]


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
