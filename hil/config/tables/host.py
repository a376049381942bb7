"""Rig files, small tables: the computer of the loop, its clock, console, link to the GNC, recording, telemetry."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.model import ConfigModel, Positive


class ClockConfig(ConfigModel):
    """Synchronisation by PTP: linuxptp's `ptp4l` on this computer."""

    ptp_socket: str = "/var/run/ptp4l"
    """Management socket of `ptp4l`; without that file the computer has no PTP."""
    ptp_domain: Annotated[int, Field(ge=0, le=127)] = 0
    """PTP domain number."""
    ptp_max_offset_us: Positive | None = None
    """Largest offset from the master: a run is rejected beyond it, or without a master. Unless set, reported only."""


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


class RecordingTable(ConfigModel):
    """Images of a recording; their replay is bit-exact with png and image_interval_s = 0 only."""

    images: Literal["none", "jpeg", "png"] = "jpeg"
    """Encoding of rendered images; "none" records none, "png" is lossless."""
    image_interval_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 0.5
    """Shortest time between two images of a camera; 0: every exposure."""


class TelemetryTable(ConfigModel):
    """Rows of a run for those who watch it; a recording has every cycle."""

    rate_hz: Positive | None = None
    """Rows per second for the console's page, for viewers (JSON messages of a recording, Foxglove) and for other
    computers, the cycle's rate divided by a whole number; unless set, one per cycle, and 10 for viewers."""
