"""Methods that estimate the probability of a rare event, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol

from hil.errors import BadInput
from hil.monte_carlo.campaign import CampaignJob, Watch
from hil.monte_carlo.engines import Engine
from hil.monte_carlo.importance_campaign import ImportanceSettings
from hil.monte_carlo.rare_campaign import RareSettings
from hil.monte_carlo.rare_events import RareEvent
from hil.monte_carlo.store import Store


class MethodSettings(Protocol):
    """Event of a campaign, its number of cases, and how it is run."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the cases in addition to those of every campaign."""

    def identity(self) -> dict[str, Any]:
        """Return what distinguishes the folder from those of other campaigns."""

    def run(self, job: CampaignJob, store: Store, engine: Engine, watch: Watch) -> dict[str, Any]:
        """Run the cases that are missing; return the summary, which is also written to the folder."""


_SETTINGS: Final[dict[str, Callable[..., MethodSettings]]] = {"subset": RareSettings, "importance": ImportanceSettings}


def settings_of(method: str, event: RareEvent, runs: int | None) -> MethodSettings:
    """Return the settings of a campaign of ``event``; runs: None for the method's own number. Raises BadInput."""
    if method not in _SETTINGS:
        raise BadInput.single("--method", "", f"{method:.40}: must be {' or '.join(_SETTINGS)}")
    return _SETTINGS[method](event) if runs is None else _SETTINGS[method](event, runs)
