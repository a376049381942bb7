"""What the console may do and what happens when its operator is lost: part of a rig file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel

OnLoss = Literal["hold", "continue", "stop"]


class ConsoleTable(ConfigModel):
    """The rig's word on its console."""

    on_loss: OnLoss = "hold"  # of the operator's page, the network or the console, while the bench moves
    lease_s: Annotated[float, Field(ge=0.5, le=60.0)] = 2.0  # silence after which the operator counts as lost
