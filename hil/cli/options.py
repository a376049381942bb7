"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final, TypeVar

import cyclopts
from cyclopts import Parameter

from hil.errors import BadInput, Problem

Settings = Annotated[
    tuple[str, ...],
    Parameter(name="--set", negative=(), help="Override a key: gnc.control.deadband_m=0.004 or rig.vmu.timeout_s=0.5."),
]


def _integer(_type: object, tokens: Sequence[cyclopts.Token]) -> int:
    """Return an integer; cyclopts by itself would truncate 1.5 to 1."""
    return int(tokens[0].value)


Integer = Annotated[int, Parameter(converter=_integer)]
OptionalInteger = Annotated[int | None, Parameter(converter=_integer)]
Flag = Annotated[bool, Parameter(negative=())]
Names = Annotated[tuple[str, ...], Parameter(negative=())]
Output = Annotated[str | None, Parameter(allow_leading_hyphen=True)]

SEED_MAX = 2**63 - 1
_LONGEST_S = 1e6

_T = TypeVar("_T")
Group = Annotated[_T, Parameter(name="*")]
"""A dataclass of options, each of which stands for itself on the command line."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a closed-loop run."""

    seed: Integer = 0
    """Seed of all random numbers: the same seed gives the same run on the mock rig."""
    duration: float | None = None
    """Run time in seconds, instead of the scenario's."""
    settings: Settings = ()
    speed: float = 1.0
    """Simulation speed relative to real time, on rigs that run in real time."""

    def problems(self) -> list[Problem]:
        """Return a problem for each option that is out of range."""
        found = []
        if not 0 <= self.seed <= SEED_MAX:
            found.append(Problem("--seed", "", f"{self.seed}: must not be negative, at most {SEED_MAX}"))
        return found + duration_problems(self.duration) + above_zero("--speed", self.speed)


def above_zero(option: str, value: float | None, what: str = "above 0", at_most: float = 1e6) -> list[Problem]:
    """Return a problem if ``value`` is not a number above zero and ``at_most``; None is one."""
    if value is None or 0.0 < value <= at_most:
        return []
    return [Problem(option, "", f"{value:g}: must be {what}, at most {at_most:g}")]


def duration_problems(duration_s: float | None) -> list[Problem]:
    """Return a problem if ``--duration`` is out of range."""
    return above_zero("--duration", duration_s, "a time above 0 s", _LONGEST_S)


def wait_problems(wait_s: float) -> list[Problem]:
    """Return a problem if ``--wait`` is out of range."""
    return above_zero("--wait", wait_s, "a time above 0 s", _LONGEST_S)


RUNS_MAX: Final = 10_000_000
"""Cases of a campaign, runs of a study: the lists of more do not fit into memory."""


def at_least(**options: tuple[int, int]) -> list[Problem]:
    """Return a problem for each option, given as name=(value, least), that is less than allowed."""
    return [
        Problem(f"--{name}", "", f"{value}: must be at least {least}")
        for name, (value, least) in options.items()
        if value < least
    ]


def at_most(**options: tuple[int, int]) -> list[Problem]:
    """Return a problem for each option, given as name=(value, most), that is more than allowed."""
    return [
        Problem(f"--{name}", "", f"{value}: must be at most {most}")
        for name, (value, most) in options.items()
        if value > most
    ]


def refuse(problems: Sequence[Problem]) -> None:
    """Raise BadInput if there are problems."""
    if problems:
        raise BadInput(problems)


def refuse_wires_in_use(rig: str, settings: Sequence[str]) -> None:
    """Raise BadInput if another controller holds a wire of ``rig``: before the imports of a run, which take seconds."""
    from hil.config.load import load_rig
    from hil.drivers.wire_lock import locked_wires

    with locked_wires(load_rig(rig, settings).value):
        pass
