"""Rig files, table ``[host]``: the computer that runs the loop."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel, Positive

OnOverrun = Literal["log", "hold", "safe_stop"]


class HostConfig(ConfigModel):
    """Real-time privileges of the loop, and its overrun policy."""

    fifo: bool = True  # request SCHED_FIFO for the thread of the loop
    cpu: Annotated[int, Field(ge=0)] | None = None  # CPU to which the thread of the loop is pinned
    require_realtime: bool = True  # a hardware rig is refused without SCHED_FIFO and locked memory
    on_overrun: OnOverrun | None = None  # None: safe_stop on hardware, log otherwise
    overruns_max: Annotated[int, Field(ge=0)] = 5  # periods that may be lost ...
    overruns_window_s: Positive = 1.0  # ... within this time, before on_overrun acts
    late_wakeup_us: Positive = 1000.0  # lateness from which a cycle counts as a late wake-up
