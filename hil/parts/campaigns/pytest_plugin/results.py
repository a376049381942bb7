"""Results of the tests of a test campaign."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"


@dataclass(frozen=True)
class CampaignRun:
    """One run of a test. numbers: label and text of each key number. alarms: bench time, priority and text.

    recording: from the folder of the day, "" without one.
    """

    scenario: str
    seed: int
    accepted: bool
    stop: str
    numbers: dict[str, str]
    alarms: list[dict[str, Any]]
    recording: str
    scenario_digest: str


@dataclass(frozen=True)
class CampaignTest:
    """Result of a test on a rig. rig: its label. kind: mock, emulated, hardware. digest: of what it depends on.

    message: why it has failed or was omitted. evidence: rows of requirements, by the keys of ``requirements.json``.
    """

    test: str
    text: str
    rig: str
    kind: str
    outcome: str
    message: str
    started_utc: str
    wall_s: float
    digest: str
    runs: list[CampaignRun] = field(default_factory=list)
    evidence: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def of_json(cls, table: dict[str, Any]) -> CampaignTest:
        """Return the result that ``as_json`` has written."""
        return cls(**{**table, "runs": [CampaignRun(**run) for run in table["runs"]]})

    def as_json(self) -> dict[str, Any]:
        """Return the result as numbers, texts, lists and tables."""
        return asdict(self)
