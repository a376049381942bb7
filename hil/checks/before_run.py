"""Lines that are printed before a run: what its bench does not show, and what its verdict cannot reach."""

from __future__ import annotations

from typing import NamedTuple

from hil.checks.ephemeris import ephemeris_warnings
from hil.checks.go_level import go_warnings
from hil.checks.observability import observed_by
from hil.checks.unseen import unseen_warnings
from hil.config.rig import Rig
from hil.config.scenario import Scenario


class BeforeRun(NamedTuple):
    """All lines, and those of them about the GNC's orbit, which the summary of a complete run repeats."""

    lines: list[str]
    ephemeris: list[str]


def before_run(scenario: Scenario, rig: Rig, length_s: float, seed: int | None = None) -> BeforeRun:
    """Return the lines before a run of ``length_s``; arguments: see ``ephemeris_limit``."""
    ephemeris = ephemeris_warnings(scenario, rig, length_s, seed)
    return BeforeRun(
        [*observed_by(scenario, rig), *unseen_warnings(scenario, rig), *go_warnings(scenario, rig), *ephemeris],
        ephemeris,
    )
