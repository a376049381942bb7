"""Rig files, table ``[gnc_link]``: link to a GNC on another computer or in another process."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hil.config.model import ConfigModel, Positive


class GncLink(ConfigModel):
    """Reaction to late or missing replies of the GNC."""

    coast_cycles: Annotated[int, Field(ge=0, le=50)] = 1
    """Cycles without a reply in which the last command is held; then all thrusters are closed."""
    timeout_cycles: Annotated[int, Field(ge=1, le=10_000)] = 3
    """Consecutive cycles without a reply after which the GNC is lost."""
    on_loss: Literal["hold", "stop"] = "stop"
    """Safe stop, or hold until the GNC is back."""
    reconnect_timeout_s: Positive = 300.0
    """Longest hold for a lost GNC, real time."""
    reply_timeout_fraction: Annotated[float, Field(gt=0.0, le=0.8)] = 0.5
    """Lock-step on a paced rig: fraction of a cycle to wait for a reply."""

    @model_validator(mode="after")
    def _coasting_ends_before_the_timeout(self) -> Self:
        if self.coast_cycles > self.timeout_cycles:
            raise ValueError(f"coast_cycles = {self.coast_cycles}: must not exceed timeout_cycles")
        return self
