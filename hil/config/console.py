"""Rig files, table ``[console]``: reaction to the loss of the operator."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel

OnLoss = Literal["hold", "continue", "stop"]
Hazardous = Literal["open", "home", "arm", "start", "resume", "park", "reset"]


class ConsoleTable(ConfigModel):
    """Supervision of the operator's page."""

    on_loss: OnLoss = "hold"
    """Reaction of a run to the loss of page, network or console; placing holds unless "stop", other motion stops."""
    lease_s: Annotated[float, Field(ge=0.5, le=60.0)] = 2.0
    """Silence after which the operator counts as lost."""
    second_person: tuple[Hazardous, ...] = ()
    """Commands that another person has to confirm at another page."""
