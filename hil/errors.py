"""All errors of the product, one tree.

HilError
├── BadInput            what the user gave cannot be used: exit code 2, one line a problem
├── CampaignStopped     a campaign cannot go on; the cases that are done are kept: exit code 3
└── BenchError          something on the bench: the run ends as a safe stop, exit code 3
    ├── DeviceError     names the device
    │   ├── LinkLost        the wire is gone (closed port, reset connection)
    │   ├── LinkTimeout     the wire is there, nothing comes (or nothing new)
    │   ├── ProtocolError   bytes that do not mean what they should
    │   └── DriveFault      the device itself reports a fault
    └── SafetyTrip      a limit of the controller's own was passed (device, value, limit)

Anything else that reaches the command line is a defect of this program: exit code 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum


class HilError(Exception):
    """Root of the tree."""


@dataclass(frozen=True)
class Problem:
    """One fault of one input: where it stands, what stands there, what may stand there."""

    source: str
    key: str
    message: str

    def __str__(self) -> str:
        where = f"{self.source}: {self.key}" if self.key else self.source
        return f"{where}: {self.message}"


class BadInput(HilError):
    """The user's input cannot be used; ``problems`` holds every fault that was found."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))

    @classmethod
    def single(cls, source: str, key: str, message: str) -> BadInput:
        return cls([Problem(source, key, message)])


class RenamedKey(FutureWarning):
    """Warning, not an error: a file or option has keys under earlier names; the text gives the present ones."""


class CampaignStopped(HilError):
    """A campaign cannot go on: its disk is full, its scheduler is gone. What is done is kept."""


class BenchError(HilError):
    """The bench cannot go on; whoever holds it stops it."""


class DeviceError(BenchError):
    """A device failed. The text always starts with the device's name."""

    def __init__(self, device: str, what: str) -> None:
        self.device = device
        self.what = what
        super().__init__(f"{device}: {what}")


class LinkLost(DeviceError):
    """The wire to the device is gone."""


class LinkTimeout(DeviceError):
    """The device has been silent for too long."""


class ProtocolError(DeviceError):
    """The device sent bytes that break its protocol."""


class FaultKind(Enum):
    """What a device's own fault means to the bench. Drivers tell it by the fault's code, never by its text."""

    OTHER = "other"
    TORQUE_OFF = "torque off"
    """The safety chain has taken the torque from the drive: the cause lies elsewhere."""


class DriveFault(DeviceError):
    """The device reports a fault of its own."""

    def __init__(self, device: str, what: str, kind: FaultKind = FaultKind.OTHER) -> None:
        super().__init__(device, what)
        self.kind = kind


class SafetyTrip(BenchError):
    """A supervised quantity left its limit."""

    def __init__(self, device: str, quantity: str, value: str, limit: str) -> None:
        self.device = device
        self.quantity = quantity
        self.value = value
        self.limit = limit
        super().__init__(f"{device}: {quantity} {value}, allowed {limit}")
