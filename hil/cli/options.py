"""Options that several commands have, with what is allowed for each, declared with its type."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from typing import Annotated, Any, Final, TypeVar, get_args, get_type_hints

import cyclopts
from cyclopts import Parameter

from hil.cli.output import axes_problem, figure_path_problem, file_path_problem, toml_path_problem
from hil.core.part import provided
from hil.errors import BadInput, Problem

Settings = Annotated[
    tuple[str, ...],
    Parameter(name="--set", negative=(), help="Override a key: gnc.control.deadband_m=0.004 or rig.vmu.timeout_s=0.5."),
]


@dataclass(frozen=True)
class Check:
    """Check of an option that is given, declared with its type. problem: returns what is wrong, "" for nothing."""

    problem: Callable[[Any], str]


def declared_problems(command: Callable[..., Any], given: Mapping[str, Any]) -> list[Problem]:
    """Return a problem for each option of ``given`` that its type, in the signature of ``command``, does not allow."""
    problems = []
    for name, kind in get_type_hints(command, include_extras=True).items():
        value = given.get(name)
        if is_dataclass(value):
            problems += declared_problems(type(value), vars(value))
        elif value is not None:
            texts = [each.problem(value) for each in _checks(kind)]
            problems += [Problem(f"--{name.replace('_', '-')}", "", text) for text in texts if text]
    return problems


def _checks(kind: Any) -> list[Check]:
    """Return the checks of an annotation and of the annotations in it."""
    inner = [check for each in get_args(kind) for check in _checks(each)]
    return [*inner, *(each for each in getattr(kind, "__metadata__", ()) if isinstance(each, Check))]


def one_of(allowed: Sequence[str]) -> Check:
    """Return the check of an option with ``allowed`` values."""
    return Check(lambda value: "" if value in allowed else f"{value}: unknown, allowed: {', '.join(allowed)}")


def bounded(least: int, most: int | None = None) -> Check:
    """Return the check of an integer from ``least`` to ``most``."""

    def problem(value: int) -> str:
        if value < least:
            return f"{value}: must be at least {least}"
        return "" if most is None or value <= most else f"{value}: must be at most {most}"

    return Check(problem)


def within(low: float, high: float) -> Check:
    """Return the check of a number from ``low`` to ``high``."""
    return Check(lambda value: "" if low <= value <= high else f"{value:g}: must be {low:g} to {high:g}")


def above_zero(what: str = "above 0", at_most: float = 1e6) -> Check:
    """Return the check of a number above zero and at most ``at_most``."""
    return Check(lambda value: "" if 0.0 < value <= at_most else f"{value:g}: must be {what}, at most {at_most:g}")


def _integer(_type: object, tokens: Sequence[cyclopts.Token]) -> int:
    """Return an integer; cyclopts by itself would truncate 1.5 to 1."""
    return int(tokens[0].value)


SEED_MAX: Final = 2**63 - 1
RUNS_MAX: Final = 10_000_000
"""Cases of a campaign, runs of a study: the lists of more do not fit into memory."""
_SEED: Final = Check(lambda n: "" if 0 <= n <= SEED_MAX else f"{n}: must not be negative, at most {SEED_MAX}")
_TIME: Final = above_zero("a time above 0 s")

Integer = Annotated[int, Parameter(converter=_integer)]
OptionalInteger = Annotated[int | None, Parameter(converter=_integer)]
Runs = Annotated[Integer, bounded(1, RUNS_MAX)]
OptionalRuns = Annotated[OptionalInteger, bounded(1, RUNS_MAX)]
Workers = Annotated[Integer, bounded(0)]
Seed = Annotated[Integer, _SEED]
OptionalCase = Annotated[OptionalInteger, bounded(0)]
Positive = Annotated[float, above_zero()]
OptionalPositive = Annotated[float | None, above_zero()]
Seconds = Annotated[float, _TIME]
OptionalSeconds = Annotated[float | None, _TIME]
Flag = Annotated[bool, Parameter(negative=())]
Names = Annotated[tuple[str, ...], Parameter(negative=())]
Axes = Annotated[Names, Check(axes_problem)]
"""Axes of the bench, none for all."""
Output = Annotated[str | None, Parameter(allow_leading_hyphen=True)]
File = Annotated[Output, Check(file_path_problem)]
"""File to write, ``-`` for standard output."""
Figure = Annotated[str | None, Check(figure_path_problem)]
TomlFile = Annotated[Output, Check(toml_path_problem)]
"""New rig or scene file to write."""

_T = TypeVar("_T")
Group = Annotated[_T, Parameter(name="*")]
"""A dataclass of options, each of which stands for itself on the command line."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a closed-loop run."""

    seed: Seed = 0
    """Seed of all random numbers: the same seed gives the same run on the mock rig."""
    duration: OptionalSeconds = None
    """Run time in seconds, instead of the scenario's."""
    settings: Settings = ()
    speed: Positive = 1.0
    """Simulation speed relative to real time, on rigs that run in real time."""


def refuse(problems: Sequence[Problem]) -> None:
    """Raise BadInput if there are problems."""
    if problems:
        raise BadInput(problems)


def refuse_wires_in_use(rig: str, settings: Sequence[str]) -> None:
    """Raise BadInput if another controller holds a wire of ``rig``: before the imports of a run, which take seconds."""
    from hil.config.load import load_rig

    loaded = load_rig(rig, settings)
    if loaded.value.kind == "hardware":
        with provided("rig.kind=hardware: locks", loaded.source)(loaded.value):
            pass
