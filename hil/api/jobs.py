"""Inputs of the API: scenarios, rigs and overrides as given by the caller, checked and joined to a job."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, TypeVar, Unpack

import numpy as np

from hil.config import load
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.model import ConfigModel
from hil.core.files import parse_toml
from hil.core.public import public
from hil.errors import BadInput, Problem
from hil.gnc_backends.backend import PARTS, OwnBackends
from hil.gnc_backends.backend_registry import NO_BACKENDS
from hil.gnc_backends.kernel_backend import KernelBackend
from hil.gnc_backends.library import key_of
from hil.gnc_backends.python_backend import PythonGnc, class_name
from hil.session.assembly import Job

Overrides = Mapping[str, Any]
Settings = Sequence[str]
Faults = Sequence[Mapping[str, Any]]


class BackendArguments(TypedDict, total=False):
    """Backends in place of the scenario's: a name as in the scenario, a path, or a class, an object or a kernel."""

    navigation: Any
    control: Any


_Model = TypeVar("_Model", bound=ConfigModel)

IN_LOCK_STEP: tuple[str, ...] = ('rig.host.time="lock_step"',)
"""Setting of a rig in lock-step."""
_ARGUMENTS = {"set": "overrides", "duration": "duration_s"}  # options of other names


@public
def load_scenario(name: str | Path | Scenario, overrides: Overrides | None = None) -> Scenario:
    """Return a checked scenario.

    name: shipped (``scheme-1``, ``scheme-2``, ``scheme-3``), the path of a TOML file, or a scenario to be overridden.
    overrides: dotted keys or nested tables to values, as ``{"gnc.control.deadband_m": 0.004}``; the rules are those of
    ``hil run --set``. Raises BadInput with one line per error: file or argument, key, value and what is allowed.
    """
    with named_as_argument():
        return loaded_scenario(name, settings_of(overrides)).value


@public
def load_rig(name: str | Path | Rig, overrides: Overrides | None = None) -> Rig:
    """Return a checked rig.

    name: shipped (``mock``, ``emulated``), the path of a TOML file, or a rig to be overridden. overrides: as for
    ``load_scenario``; the keys begin with ``rig.``. Raises BadInput.
    """
    with named_as_argument():
        return loaded_rig(name, settings_of(overrides)).value


def loaded_scenario(scenario: str | Path | Scenario, settings: Settings) -> Loaded[Scenario]:
    """Return the scenario with its ``key=value`` settings, and where each key was set. Raises BadInput."""
    if isinstance(scenario, Scenario):
        own = [text for text in settings if not text.startswith("rig.")]
        return _overridden(scenario, own, "")
    return load.load_scenario(_path("scenario", scenario), settings)


def loaded_rig(rig: str | Path | Rig, settings: Settings) -> Loaded[Rig]:
    """Return the rig with its ``rig.key=value`` settings, and where each key was set. Raises BadInput."""
    if isinstance(rig, Rig):
        loaded = _overridden(rig, [text for text in settings if text.startswith("rig.")], "rig.")
        load.check_wires(loaded)
        return loaded
    return load.load_rig(_path("rig", rig), settings)


def _overridden(model: _Model, settings: Settings, prefix: str) -> Loaded[_Model]:
    """Return ``model`` with settings, checked again: copies of a model are not."""
    table = model.model_dump(mode="json", exclude_none=True)
    origin: dict[str, str] = {}
    load.apply_settings(table, settings, type(model), origin, prefix)
    return load.check_table(table, type(model), f"{type(model).__name__} object", origin, prefix)


def _path(argument: str, value: object) -> str:
    if not isinstance(value, str | os.PathLike):
        raise BadInput.single(argument, "", f"{value!r:.60}: must be a name, a path or a {argument.title()} object")
    return os.fspath(value)


def rig_name(rig: str | Path | Rig) -> str:
    """Return the name of a rig in reports: as given, or the object's name."""
    return rig.name if isinstance(rig, Rig) else str(rig)


def job_of(
    scenario: str | Path | Scenario,
    rig: str | Path | Rig,
    overrides: Overrides | Settings | None,
    seed: int = 0,
    duration_s: float | None = None,
    speed: float = 1.0,
    gnc: PythonGnc | None = None,
    faults: Faults | None = None,
    **backends: Unpack[BackendArguments],
) -> Job:
    """Return the job of a run from the arguments of ``hil.run``; a tuple of overrides is of texts. Raises BadInput."""
    named, own = own_backends(**backends)
    settings = (*settings_of(overrides), *named)
    loaded = with_faults(loaded_scenario(scenario, settings), faults or ())
    origin = dict(loaded.origin) | {f"gnc.{part}.backend": part for part in backends if backends.get(part) is not None}
    return make_job(replace(loaded, origin=origin), loaded_rig(rig, settings), seed, duration_s, speed, gnc, own)


def own_backends(navigation: Any = None, control: Any = None) -> tuple[Settings, OwnBackends]:
    """Return the settings that name backends, and the backends that are Python objects."""
    given = dict(zip(PARTS, (navigation, control), strict=True))
    names = {part: os.fspath(each) for part, each in given.items() if isinstance(each, str | os.PathLike)}
    for part, each in given.items():
        known = part in names or each is None or isinstance(each, KernelBackend)
        if not (known or callable(getattr(each, "step", None))):
            raise BadInput.single(part, "", f"{class_name(each)}: must be a class or an object with a method step(inp)")
    own = OwnBackends(**{part: each for part, each in given.items() if part not in names})
    return [f"gnc.{part}.backend={_toml(name, part)}" for part, name in names.items()], own


def with_faults(scenario: Loaded[Scenario], faults: Faults) -> Loaded[Scenario]:
    """Return ``scenario`` with ``faults`` after its own."""
    if not faults:
        return scenario
    if isinstance(faults, Mapping | str) or not all(isinstance(fault, Mapping) for fault in faults):
        raise BadInput.single("faults", "", f"{faults!r:.60}: must be a list of tables")
    table = scenario.value.model_dump(mode="json", exclude_none=True)
    given = parse_toml(f"faults = {_toml(list(faults), 'faults')}")["faults"]
    table["faults"] = [*table["faults"], *given]
    return load.check_table(table, Scenario, scenario.source, {**scenario.origin, "faults": "faults"})


def make_job(
    scenario: Loaded[Scenario],
    rig: Loaded[Rig],
    seed: int = 0,
    duration_s: float | None = None,
    speed: float = 1.0,
    gnc: PythonGnc | None = None,
    own: OwnBackends = NO_BACKENDS,
) -> Job:
    """Return the job of a run. duration_s: None for the scenario's. gnc: replaces the scenario's. Raises BadInput.

    own: backends of navigation and control that are Python objects.
    """
    problems = []
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        problems.append(Problem("seed", "", f"{seed!r:.60}: must be an integer, not negative"))
    for name, value in (("duration_s", duration_s), ("speed", speed)):
        if value is not None and not is_positive(value):
            problems.append(Problem(name, "", f"{value!r:.60}: must be a number above 0"))
    if gnc is not None:
        problems += _gnc_problems(gnc, scenario, rig)
        problems += [Problem(part, "", "another GNC is given: gnc") for part in PARTS if getattr(own, part) is not None]
    if problems:
        raise BadInput(problems)
    length_s = scenario.value.duration_s if duration_s is None else float(duration_s)
    return Job(scenario, rig, int(seed), length_s, float(speed), own=own._replace(gnc=gnc))


def _gnc_problems(gnc: object, scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    if not callable(getattr(gnc, "step", None)):
        return [Problem("gnc", "", f"{class_name(gnc)}: must be an object with a method step(input)")]
    return [Problem("gnc", "", str(problem)) for problem in other_gnc_problems(scenario, rig)]


def other_gnc_problems(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each key of scenario and rig that a GNC of the caller's own rules out."""
    problems = []
    if (binary := scenario.value.gnc.binary) is not None:
        key = key_of(scenario.value.gnc)
        problems.append(scenario.problem(key, f'"{binary}": another GNC is given'))
    for part, name in scenario.value.gnc.foreign.items():
        problems.append(scenario.problem(f"gnc.{part}.backend", f'"{name}": another GNC is given'))
    key = "flight_computer.command_words"
    if (wire := rig.value.flight_computer.command_words) != "none":
        problems.append(Problem(rig.where(key), f"rig.{key}", f'"{wire}": another GNC is given'))
    return problems


def is_positive(value: object) -> bool:
    """Return whether ``value`` is a finite number above zero."""
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and value > 0.0  # type: ignore[arg-type, operator]


@contextmanager
def named_as_argument() -> Iterator[None]:
    """Name the arguments in errors, ``overrides`` and others, not the options of the command line."""
    try:
        yield
    except BadInput as error:
        problems = [replace(p, source=_as_argument(p.source), message=_as_argument(p.message)) for p in error.problems]
        raise BadInput(problems) from error.__cause__


def _as_argument(text: str) -> str:
    """Return ``text`` with arguments in the place of options, but for one that has a command."""

    def name(option: re.Match[str]) -> str:
        argument = option[1].replace("-", "_")
        return _ARGUMENTS.get(argument, argument)

    return text if re.search(r"\bhil [a-z]", text) else re.sub(r"(?<!\S)--([a-z][a-z-]*)", name, text)


def settings_of(overrides: Overrides | Settings | None) -> tuple[str, ...]:
    """Return overrides as ``key=value`` texts, values in TOML. Raises BadInput for a value that TOML does not have."""
    if overrides is None or isinstance(overrides, tuple):
        return overrides or ()
    if not isinstance(overrides, Mapping):
        raise BadInput.single("overrides", "", f"{overrides!r:.60}: must be a dict of dotted keys")
    return tuple(f"{key}={_toml(value, key)}" for key, value in _flat(overrides, ""))


def _flat(table: Overrides, prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if not isinstance(key, str) or not key.strip() or "=" in key:
            raise BadInput.single("overrides", f"{prefix}{key}", "keys must be dotted names")
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _toml(value: Any, key: str) -> str:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(item, key) for item in value)}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{json.dumps(name)} = {_toml(item, key)}' for name, item in value.items())}}}"
    raise BadInput.single("overrides", key, f"{value!r:.60}: must be a number, text, bool, list or dict")
