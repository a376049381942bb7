"""Parts of the verdict on a run.

A part that is added to the table can be required by a scenario, counts for ``passed_all_parts`` and ``accepted``, and
is a column of campaigns. What judges it and its line of text are in ``hil/report``, under the same name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

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
