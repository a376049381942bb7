"""Rig files, table ``[host]``: the computer that runs the loop."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel, Positive

OnOverrun = Literal["log", "hold", "safe_stop"]


class HostConfig(ConfigModel):
    """Real-time privileges of the loop, and its overrun policy."""

    time: Literal["wall_clock", "lock_step"] = "wall_clock"
    """Time of an emulated rig: in lock-step it advances when all processes have done their part, without deadlines."""
    lock_step_timeout_s: Positive = 60.0
    """Wall time after which a process that does not do its part in lock-step is ended and reported."""
    fifo: bool = True
    """Request SCHED_FIFO 80, for the loop's thread only."""
    cpu: Annotated[int, Field(ge=0)] | None = None
    """CPU affinity of the loop's thread; best an isolated CPU."""
    require_realtime: bool = True
    """Reject a hardware rig without SCHED_FIFO and locked memory."""
    on_overrun: OnOverrun | None = None
    """Reaction to lost periods: count, hold or safe stop. Unless set: safe_stop on hardware, log otherwise."""
    overruns_max: Annotated[int, Field(ge=0)] = 5
    """Lost periods of the cycle that `on_overrun` allows ..."""
    overruns_window_s: Positive = 1.0
    """... within this time (leaky bucket)."""
    late_wakeup_us: Positive = 1000.0
    """A cycle that starts later than this counts as a late wake-up."""
    exchange_max_s: Positive | None = None
    """Limit in reports of the age of an axis' sample and of the acknowledgement of digital lines; unless set, two
    cycles."""
