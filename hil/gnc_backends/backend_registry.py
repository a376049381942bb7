"""Backends of navigation and of control that a scenario names, or that the caller gives as Python objects."""

from __future__ import annotations

import importlib
import importlib.util
import re
import sys
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from hil.config.live_tunable import BACKEND_SETTINGS
from hil.config.load import Loaded
from hil.config.scenario import BUILT_IN, Scenario
from hil.core.files import sha256_of
from hil.core.gnc_records import MAX_IMU_SAMPLES
from hil.core.own_code import import_error, module_of_file, require_trust
from hil.core.part import provided
from hil.core.settings import Setting
from hil.errors import BadInput, Problem, did_you_mean
from hil.gnc_backends.backend import PARTS, Backend, Backends, OwnBackends
from hil.gnc_backends.kernel_backend import CompiledKernel, KernelBackend
from hil.gnc_backends.python_backend import PythonBackend

OBJECT: Final = "object"
"""Prefix of the name of a backend that the caller gives as a Python object: ``object:Ekf``."""
NO_BACKENDS: Final = OwnBackends()
_KINDS: Final = "package:name of an entry point, file.py:name, a shared library (.so) or an FMU (.fmu)"


def named(scenario: Loaded[Scenario], own: OwnBackends) -> Loaded[Scenario]:
    """Return ``scenario`` with the names of the caller's backends and every setting that a backend or sensor declares.

    A backend's settings stand in the order of their declaration. Raises BadInput for a backend or sensor that cannot be
    loaded, a setting that it does not have, or one outside its range.
    """
    if scenario.value.sensors:
        from hil.sensors.registry import with_sensor_settings  # of few runs

        scenario = with_sensor_settings(scenario)
    value = scenario.value
    table: dict[str, Any] = {part: getattr(value.gnc, part) for part in PARTS}
    for part in PARTS:
        if (given := getattr(own, part)) is not None:
            replaced, name = table[part], f"{OBJECT}:{_name_of(given)}"
            settings = replaced.settings
            if replaced.backend not in (*BUILT_IN[part], name):  # those of the backend that it replaces mean nothing
                settings = {k: v for k, v in settings.items() if f"gnc.{part}.settings.{k}" in scenario.origin}
            table[part] = replaced.model_copy(update={"backend": name, "settings": settings})
    if table == {part: getattr(value.gnc, part) for part in PARTS} and not value.gnc.foreign:
        _refuse_settings(scenario)
        return scenario
    value = value.model_copy(update={"gnc": value.gnc.model_copy(update=table)})
    problems: list[Problem] = []
    for part, backend in backends_of(value, own, scenario.where).items():
        settings, refused = _settings_of(backend, part, getattr(value.gnc, part).settings, scenario)
        problems += refused
        table[part] = table[part].model_copy(update={"settings": settings})
    if problems:
        raise BadInput(problems)
    value = value.model_copy(update={"gnc": value.gnc.model_copy(update=table)})
    _refuse_undeclared(value, scenario.where("console.adjustable"))
    table = value.model_dump(mode="json", exclude_none=True)
    return scenario.with_table(table)


def digest_of(path: str) -> str:
    """Return the SHA-256 of a backend's file, "" if there is none."""
    try:
        return sha256_of(Path(path))
    except BadInput:
        return ""


def declared_setting(scenario: Scenario, key: str) -> Setting:
    """Return the setting at the dotted ``key`` of a named scenario. Raises BadInput if its backend is not there."""
    _, part, _, name = key.split(".")
    return next(setting for setting in backends_of(scenario)[part].settings if setting.name == name)


def _refuse_undeclared(scenario: Scenario, source: str) -> None:
    """Raise BadInput for a setting that may change during the run, but that no backend declares."""
    settings = {f"gnc.{part}.settings.{name}" for part in PARTS for name in getattr(scenario.gnc, part).settings}
    for key in scenario.console.adjustable:
        if key.startswith(BACKEND_SETTINGS) and key not in settings:
            names = ", ".join(sorted(settings)) or "none"
            text = f'"{key}": no setting of a backend, known here: {names}'
            raise BadInput.single(source, "console.adjustable", text)


def _refuse_settings(scenario: Loaded[Scenario]) -> None:
    """Raise BadInput if a built-in part is given settings of a backend."""
    for part in PARTS:
        for name in getattr(scenario.value.gnc, part).settings:
            key = f"gnc.{part}.settings.{name}"
            text = f'unknown key: gnc.{part}.backend = "{getattr(scenario.value.gnc, part).backend}" declares none'
            raise BadInput.single(scenario.where(key), key, text)
    _refuse_undeclared(scenario.value, scenario.where("console.adjustable"))


def _settings_of(
    backend: Backend, part: str, given: dict[str, float], scenario: Loaded[Scenario]
) -> tuple[dict[str, float], list[Problem]]:
    """Return the value of each declared setting, and the problems of the given ones."""
    problems = []
    declared = {setting.name: setting for setting in backend.settings}
    for name, value in given.items():
        key = f"gnc.{part}.settings.{name}"
        if name not in declared:
            names = ", ".join(declared) or "none"
            hint = did_you_mean(name, declared)
            problems.append(scenario.problem(key, f"unknown key: {hint}known here: {names}"))
        elif text := declared[name].problem(value):
            problems.append(scenario.problem(key, text))
    return {name: given.get(name, setting.default) for name, setting in declared.items()}, problems


def backends_of(
    scenario: Scenario,
    own: OwnBackends = NO_BACKENDS,
    where: Callable[[str], str] = lambda _: "scenario",
    copies: bool = False,
) -> Backends:
    """Return the backends of ``scenario`` that are not built in. Raises BadInput for one that cannot be flown.

    own: given by the caller; copies: an object is copied for each instance. where: returns the source of a key.
    """
    backends: dict[str, Backend] = {}
    for part, name in scenario.gnc.foreign.items():
        key = f"gnc.{part}.backend"

        def refuse(what: str, name: str = name, key: str = key) -> BadInput:
            return BadInput.single(where(key), key, f'"{name}": {what}')

        given = getattr(own, part)
        if name.startswith(f"{OBJECT}:"):
            if given is None:
                was = name.partition(":")[2]
                raise refuse(f"the Python object {was} is needed: give it, {part}={was}, or another backend")
            backends[part] = _of_object(given, part, refuse, copies)
        else:
            backends[part] = _of_name(name, part, refuse)
    if "navigation" in backends and scenario.imu_samples > MAX_IMU_SAMPLES:
        text = (
            f"{scenario.imu.rate_hz:g}: {scenario.imu_samples} samples per cycle, a backend of navigation gets at most"
        )
        raise BadInput.single(where("imu.rate_hz"), "imu.rate_hz", f"{text} {MAX_IMU_SAMPLES}")
    return backends


def backend_file(name: str, part: str) -> str | None:
    """Return the path of the file of the backend ``name`` of ``part``, None if it has none that can be found."""
    where, _, member = name.rpartition(":")
    if where.endswith(".py"):
        return where
    if name.endswith((".so", ".fmu")):
        return name
    if where in ("", OBJECT):
        return None
    modules = [point.module for point in entry_points(group=f"hil.{part}", name=member) if _same(point, where)]
    spec = _spec((modules or [where])[0])
    return None if spec is None else spec.origin


def _spec(module: str) -> ModuleSpec | None:
    """Return the specification of ``module`` without importing the packages that it is in, which data may name."""
    spec, name, folders = None, "", None
    for part in module.split("."):
        name = f"{name}.{part}" if name else part
        finders = (getattr(finder, "find_spec", None) for finder in sys.meta_path)
        specs = (find(name, folders) for find in finders if find is not None)
        if (spec := next((each for each in specs if each is not None), None)) is None:
            break
        folders = spec.submodule_search_locations
    return spec


def _name_of(given: object) -> str:
    kind = given if isinstance(given, type) else type(given)
    return given.name if isinstance(given, KernelBackend) else kind.__name__


def _of_name(name: str, part: str, refuse: Callable[[str], BadInput]) -> Backend:
    if name.endswith(".so"):
        from hil.gnc_backends.shared_library import LibraryBackend  # of few runs

        return LibraryBackend(name, part, refuse)
    if name.endswith(".fmu"):
        backend: Backend = provided("backend in an FMU", f"gnc.{part}.backend")(name, part, refuse)
        return backend
    where, colon, member = name.rpartition(":")
    if not colon or not where or not member:
        names = ", ".join(f'"{each}"' for each in BUILT_IN[part])
        raise refuse(f"no such backend: must be {names}, {_KINDS}")
    if where.endswith(".py"):
        target = _member(module_of_file(where, refuse), member, refuse)
    else:
        target = _of_package(where, member, part, refuse)
    return _of_object(target, part, refuse, copies=True)


def _of_object(given: Any, part: str, refuse: Callable[[str], BadInput], copies: bool) -> Backend:
    if isinstance(given, KernelBackend):
        return CompiledKernel(given, part, refuse)
    return PythonBackend(given, part, refuse, copies)


def _member(module: ModuleType, name: str, refuse: Callable[[str], BadInput]) -> Any:
    if not hasattr(module, name):
        names = ", ".join(sorted(n for n, v in vars(module).items() if isinstance(v, KernelBackend | type)))
        raise refuse(f"has no {name}: its classes and kernels are {names or 'none'}")
    return getattr(module, name)


def _of_package(package: str, name: str, part: str, refuse: Callable[[str], BadInput]) -> Any:
    """Return what the entry point ``name`` of the distribution ``package`` names, or ``name`` of that module."""
    points = list(entry_points(group=f"hil.{part}"))
    mine = [point for point in points if point.name == name and _same(point, package)]
    try:
        if mine:
            return mine[0].load()
        require_trust(f"{package}:{name}", refuse)
        if importlib.util.find_spec(package) is None:
            names = ", ".join(f"{point.dist.name}:{point.name}" for point in points if point.dist) or "none"
            raise refuse(f"no such entry point: those of hil.{part} are {names}; nor a module {package}")
        return _member(importlib.import_module(package), name, refuse)
    except BadInput:
        raise
    except Exception as error:
        raise refuse(f"cannot be imported: {import_error(error)}") from error


def _same(point: EntryPoint, package: str) -> bool:
    def plain(text: str) -> str:
        return re.sub(r"[-_.]+", "-", text).lower()

    return point.dist is not None and plain(point.dist.name) == plain(package)
