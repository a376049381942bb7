"""The computer that the loop runs on: part of a rig file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel, Positive

LateCycle = Literal["log", "hold", "safe_stop"]


class HostConfig(ConfigModel):
    """What the loop asks of its computer, and what happens when it does not keep up."""

    fifo: bool = True  # ask for SCHED_FIFO, for the loop's thread alone
    cpu: Annotated[int, Field(ge=0)] | None = None  # keep the loop's thread on this one
    insist_on_realtime: bool = True  # a hardware rig does not run without SCHED_FIFO and locked memory
    late_cycle: LateCycle | None = None  # None: safe_stop on hardware, log otherwise
    late_cycles_max: Annotated[int, Field(ge=0)] = 5  # periods that may be lost ...
    late_cycles_window_s: Positive = 1.0  # ... within this time, before late_cycle comes
    late_wakeup_us: Positive = 1000.0  # a cycle that begins later than this counts as a late wake-up
