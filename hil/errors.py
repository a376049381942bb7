"""Error tree of the package::

    HilError
    ├── BadInput            invalid user input: exit code 2, one line per problem
    ├── CampaignStopped     a campaign cannot continue; completed cases are kept: exit code 3
    └── BenchError          fault of the bench: the run ends with a safe stop, exit code 3
        ├── DeviceError     fault of a device, which it names
        │   ├── LinkLost        the link is lost (closed port, reset connection)
        │   ├── LinkTimeout     nothing, or nothing new, received in time
        │   ├── ProtocolError   received bytes violate the protocol
        │   ├── DriveFault      the device itself reports a fault
        │   └── PlugInError     code of a user's own raised an error, or returned what it may not
        └── SafetyTrip      a limit of the controller was exceeded (device, value, limit)

Any other exception that reaches the command line is an internal error: exit code 4.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

INSTALLED: Final = "; an entry point that was added to a package is seen when pip has installed it again"
"""End of a message about a driver, sensor or part that is not known."""
_LONGEST_LINE: Final = 2000
_EXTRAS: Final = {
    "cv2": "vision", "av": "vision", "matplotlib": "report", "fastapi": "console", "uvicorn": "console",
    "websockets": "console", "pyarrow": "campaign", "distributed": "campaign", "pytest": "dev",
}  # fmt: skip
"""Package that only some capabilities need -> the extra that installs it."""
_SIMILAR_MAX: Final = 3


def one_line(text: str, longest: int = _LONGEST_LINE) -> str:
    """Return ``text`` as one line of printable characters, escaped where it has others, cut after ``longest``.

    Texts of files, clients and devices may contain anything: the result neither commands a terminal nor fails in an
    encoding.
    """
    shown = text[:longest].replace("\n", " ")
    plain = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in shown)
    return plain if len(text) <= longest else f"{plain}..."


def missing_package(error: ModuleNotFoundError) -> str:
    """Return the text for a package that an extra installs, "" for any other module."""
    extra = _EXTRAS.get(error.name or "")
    return f"needs {error.name}, which is not installed: pip install 'hil-bench[{extra}]'" if extra else ""


def did_you_mean(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """Return ``did you mean A or B? `` of the ``known`` names that begin as ``name``, else of the nearest, or "".

    cutoff: least similarity of the nearest one.
    """
    names = list(known)
    close = [each for each in names if name and each.startswith(name)][:_SIMILAR_MAX]
    close = close or difflib.get_close_matches(name, names, n=1, cutoff=cutoff)
    return f"did you mean {' or '.join(close)}? " if close else ""


class HilError(Exception):
    """Base class of all errors of the package."""


@dataclass(frozen=True)
class Problem:
    """One error of an input: its source, its key, and a message with the value and the allowed ones."""

    source: str
    key: str
    message: str

    def __str__(self) -> str:
        where = f"{self.source}: {self.key}" if self.key else self.source
        return one_line(f"{where}: {self.message}")


class BadInput(HilError):
    """Invalid user input; ``problems`` has every error found."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))

    @classmethod
    def single(cls, source: str, key: str, message: str) -> BadInput:
        return cls([Problem(source, key, message)])


class CampaignStopped(HilError):
    """A campaign cannot continue: disk full, scheduler lost. Completed cases are kept."""


class BenchError(HilError):
    """Unrecoverable bench error; the runner performs a safe stop."""


class DeviceError(BenchError):
    """Fault of a device. The text starts with the device's name."""

    def __init__(self, device: str, what: str) -> None:
        self.device = device
        self.what = what
        super().__init__(f"{device}: {what}")


class LinkLost(DeviceError):
    """The link to the device is lost."""


class LinkTimeout(DeviceError):
    """The device has been silent for longer than its time-out."""


class ProtocolError(DeviceError):
    """The device sent bytes that violate its protocol."""


class PlugInError(DeviceError):
    """Code of a user's own raised an error, or returned what it may not."""


class FaultKind(Enum):
    """Kind of a device's fault. Drivers derive it from the fault code, never from its text."""

    OTHER = "other"
    TORQUE_OFF = "torque off"
    """The safety chain has removed the torque of the drive: the cause is elsewhere."""


class DriveFault(DeviceError):
    """The device reports a fault."""

    def __init__(self, device: str, what: str, kind: FaultKind = FaultKind.OTHER) -> None:
        super().__init__(device, what)
        self.kind = kind


class SafetyTrip(BenchError):
    """A monitored quantity exceeded its limit: the error of an alarm."""

    def __init__(self, alarm: Any) -> None:
        self.alarm = alarm
        super().__init__(alarm.text)
