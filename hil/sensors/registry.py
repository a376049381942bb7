"""SensorKind modules by their kind: those of this package, and those of others by entry points.

A package declares the entry point of a module, named as its kind:

    [project.entry-points."hil.sensors"]
    bearing_camera = "acme_bearing:BearingCamera"

A scenario may also name a class in a file: ``kind = "sensors/altimeter.py:Altimeter"``.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final

from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.config.tables.sensors import SensorConfig
from hil.core.own_code import import_error, module_of_file
from hil.core.sensor_records import ERROR_STATES_MAX
from hil.core.settings import Setting
from hil.errors import INSTALLED, BadInput, Problem, did_you_mean
from hil.sensors.module import COMMON, SensorKind, checked

GROUP: Final = "hil.sensors"
SHIPPED: Final = {
    "range_finder": "hil.sensors.range_finder:RangeFinder",
    "relative_gnss": "hil.sensors.relative_gnss:RelativeGnss",
    "lidar": "hil.sensors.lidar:Lidar",
    "star_tracker": "hil.sensors.star_tracker:StarTracker",
    "pose": "hil.sensors.pose:ExternalPose",
    "docking_monitor": "hil.parts.monitor.sensor:DockingMonitorSensor",
}
"""Kind -> module and class."""


def sensor(kind: str, refuse: Callable[[str], BadInput] | None = None) -> SensorKind:
    """Return the sensor module ``kind``. Raises BadInput, by ``refuse``, if it is none or its declaration is wrong."""
    refuse = refuse or (lambda text: BadInput.single("hil sensors", "kind", f"{kind}: {text}"))
    try:
        if ".py:" in kind:
            return checked(_of_file(kind, refuse), Path(kind.rpartition(":")[0]).name)
        if kind in SHIPPED:
            where, _, name = SHIPPED[kind].partition(":")
            return checked(getattr(importlib.import_module(where), name))
        points = _packages()
        if kind not in points:
            names = [*SHIPPED, *points]
            known = f"known are {', '.join(names)}, or a class in a file, FILE.py:NAME{INSTALLED}"
            raise refuse(f"no such sensor: {did_you_mean(kind, names)}{known}")
        point = points[kind]
        return checked(point.load(), point.dist.name if point.dist else "")
    except BadInput:
        raise
    except ValueError as error:
        raise refuse(str(error)) from error
    except Exception as error:
        raise refuse(f"cannot be imported: {import_error(error)}") from error


def kinds() -> dict[str, SensorKind | str]:
    """Return each kind of sensor, or why its module cannot be used."""
    loaded: dict[str, SensorKind | str] = {}
    for kind in (*SHIPPED, *_packages()):
        try:
            loaded[kind] = sensor(kind)
        except BadInput as error:
            loaded[kind] = error.problems[0].message
    return loaded


def with_sensor_settings(scenario: Loaded[Scenario]) -> Loaded[Scenario]:
    """Return ``scenario`` with every setting that the modules of its sensors declare.

    Raises BadInput for a sensor that cannot be loaded, a setting that it does not have, or one outside its range.
    """
    if not scenario.value.sensors:
        return scenario
    problems: list[Problem] = []
    tables: dict[str, Any] = {}
    states = 0
    for name, config in scenario.value.sensors.items():
        key = f"sensors.{name}"
        try:
            kind = sensor(config.kind, lambda text, k=key, c=config: _refusal(scenario, k, c, text))  # type: ignore[misc]
        except BadInput as error:
            problems += error.problems
            continue
        values = _settings_of(kind, key, config, scenario, problems)
        states += sum(1 for error in kind.module.errors if values[error.sigma] > 0.0)
        tables[name] = config.model_dump(mode="json", exclude_none=True) | values
    if states > ERROR_STATES_MAX:
        text = f"{states} errors with a sigma above 0, at most {ERROR_STATES_MAX} are states of the filters"
        problems.append(scenario.problem("sensors", text))
    if problems:
        raise BadInput(problems)
    return scenario.with_table(scenario.value.model_dump(mode="json", exclude_none=True) | {"sensors": tables})


def _refusal(scenario: Loaded[Scenario], key: str, config: SensorConfig, text: str) -> BadInput:
    return BadInput.single(scenario.where(f"{key}.kind"), f"{key}.kind", f'"{config.kind}": {text}')


def _settings_of(
    kind: SensorKind, key: str, config: SensorConfig, scenario: Loaded[Scenario], problems: list[Problem]
) -> dict[str, float]:
    """Return the value of each declared setting; add the problems of the given ones."""
    declared = {setting.name: setting for setting in kind.settings}
    given = config.settings
    for name, value in given.items():
        where, here = scenario.where(f"{key}.{name}"), f"{key}.{name}"
        if name not in declared:
            problems.append(Problem(where, here, _unknown(name, declared)))
        elif isinstance(value, bool) or not isinstance(value, int | float):
            problems.append(Problem(where, here, f"{value!r:.60}: must be a number, {declared[name].allowed}"))
        elif text := declared[name].problem(float(value)):
            problems.append(Problem(where, here, text))
    return {
        name: float(value) if isinstance(value := given.get(name, setting.default), int | float) else setting.default
        for name, setting in declared.items()
    }


def _unknown(name: str, declared: dict[str, Setting]) -> str:
    names = [*declared, *(key for key in COMMON if key not in ("kind", "name"))]
    stem = name.rpartition("_")[0] or name
    return f"unknown key: {did_you_mean(f'{stem}_', names)}known here: {', '.join(names)}"


def _of_file(kind: str, refuse: Callable[[str], BadInput]) -> Any:
    path, _, name = kind.rpartition(":")
    module = module_of_file(path, refuse)
    if not hasattr(module, name):
        raise refuse(f"the file has no {name}")
    return getattr(module, name)


@cache
def _packages() -> dict[str, EntryPoint]:
    """Return the entry points of other packages: looking for them takes milliseconds, and each case asks."""
    return {point.name: point for point in entry_points(group=GROUP) if point.name not in SHIPPED}
