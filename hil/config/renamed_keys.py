"""Renamed keys of configuration files: earlier names are read, with one warning per file that gives the new name.

The renaming acts on raw tables, before validation: files, ``--set``, dispersions, adjustable settings, recordings and
campaign folders. The models have the new names only.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from pydantic import BaseModel
from pydantic_core import to_json

from hil.errors import BadInput, Problem, RenamedKey

Table = dict[str, Any]
Path = tuple[str, ...]

RENAMED: Final[Mapping[str, Mapping[str, str]]] = {
    "Scenario": {
        "vmu.duplicate_share": "vmu.duplicate_probability",
        "vmu.loss_share": "vmu.loss_probability",
        "vmu.pictures": "vmu.images",
        "gnc.navigation.sensors": "gnc.navigation.backend",
        "gnc.guidance.phases.*.until_s": "gnc.guidance.phases.*.end_time_s",
        "gnc.control.caution": "gnc.control.deadband_sigmas",
        "gnc.control.attitude_caution": "gnc.control.attitude_deadband_sigmas",
        "reach.corridor_share": "reachability.corridor_fraction",
        "reach.catch_up_s": "reachability.startup_lag_s",
        "reach": "reachability",
        "monitor.camera_station_m": "monitor.camera_position_m",
        "monitor.target_station_m": "monitor.target_position_m",
        "orbit.moon_rotation_deg": "orbit.body_rotation_deg",
    },
    "Rig": {
        "bench.camera_station_m": "bench.camera_position_m",
        "bench.ring_station_m": "bench.led_ring_position_m",
        "bench.ring_axes": "bench.led_ring_axes",
        "rails.lost_packets_forget_s": "rails.lost_packets_window_s",
        "turntable.lost_packets_forget_s": "turntable.lost_packets_window_s",
        "target_manipulator.lost_packets_forget_s": "target_manipulator.lost_packets_window_s",
        "vmu.lost_packets_forget_s": "vmu.lost_packets_window_s",
        "host.insist_on_realtime": "host.require_realtime",
        "host.late_cycle": "host.on_overrun",
        "host.late_cycles_max": "host.overruns_max",
        "host.late_cycles_window_s": "host.overruns_window_s",
        "gnc_link.answer_share": "gnc_link.reply_timeout_fraction",
        "gnc_link.rejoin_s": "gnc_link.reconnect_timeout_s",
        "flight_computer.words": "flight_computer.command_words",
        "recording.pictures": "recording.images",
        "recording.picture_each_s": "recording.image_interval_s",
    },
    "Scene": {"reserve": "backup"},
    "FmuMapping": {},
    "CentralBody": {},
    "Protocol": {"emulator.torque_off": "faults.torque_off"},
    "VmuGeometry": {
        "calibration.camera_station_m": "calibration.camera_position_m",
        "calibration.target_station_m": "calibration.target_position_m",
    },
}
"""Model of a file -> earlier key -> present key. ``*``: any name. A more specific key stands before its table."""

REMOVED: Final[Mapping[str, tuple[str, ...]]] = {"Scenario": ("gnc.vision_only",)}
"""Model of a file -> tables and keys that nothing reads any more; they are dropped with a warning."""

RENAMED_VALUES: Final[Mapping[str, Mapping[str, Mapping[str, str]]]] = {
    "Scenario": {
        "monitor.target": {"reserve": "backup"},
        "gnc.navigation.backend": {"vision_imu": "builtin", "vision": "vision_alone"},
    },
}
"""Model of a file -> present key -> earlier value -> present value."""

_LISTS_OF_KEYS: Final = {("console", "adjustable")}
_PREFIXES: Final = {"dispersions"}  # tables that repeat the scenario's own
_PREFIX: Final = {"Rig": "rig."}  # of a model's keys in messages


_DIGESTED: Final = object()
_NOT_DIGESTED: Final = {("rails", "map", "torque_off"), ("target_manipulator", "map", "torque_off")}
"""Keys that have been added since digests are written, and that only classify a fault."""
_NOT_DIGESTED_LEAVES: Final[Mapping[Path, Any]] = {("gnc", "control", "backend"): "builtin"}
"""Keys that have been added since digests are written -> value with which nothing changes."""

_NOT_DIGESTED_DEFAULTS: Final[Mapping[str, Any]] = {
    "gravity_loaded": False,
    "counterweight": False,
    "brake": None,
    "brakes_released": None,
    "brakes_closed": None,
    "local_enable": None,
    "warning": None,
    "warning_s": 2.0,
    "parking_rate_fraction": 0.25,
    "jog_rate_fraction": 0.1,
    "speed_mismatch_max_mps": 0.05,
    "speed_mismatch_max_degps": 5.0,
    "torque_delay_s": 0.0,
    "fmu": None,
    "fmu_mapping": None,
    "fmu_parameters": {},
    "fmu_process": False,
    "fmu_timeout_s": 0.5,
    "body": "moon",
    "eclipse": False,
    "drag": False,
    "density_scale": 1.0,
    "target_ballistic_kgpm2": 100.0,
    "chaser_ballistic_kgpm2": 100.0,
    "third_bodies": False,
    "along_track_error_m": 0.0,
    "settings": {},
    "required_parts": None,
}
"""Last names of keys that have been added since digests are written -> value with which nothing changes."""


def with_present_names(model: str, table: Table, source: str, named_at_most: int | None = None) -> Table:
    """Return ``table`` under the present names of ``model``'s keys, and warn of the earlier ones in one line.

    model: name of the configuration model of the whole file. named_at_most: renamings that the line gives, None for
    all. Raises BadInput with each key that is given under both names.
    """
    found: dict[str, str] = {}
    problems: list[Problem] = []
    leaves = list(_leaves(table))
    given = {path for path, _ in leaves}
    renamed: list[tuple[Path, Any]] = []
    removed = dict.fromkeys(key for path, _ in leaves for key in REMOVED.get(model, ()) if _is_in(path, key))
    for path, value in leaves:
        if any(_is_in(path, key) for key in removed):
            continue
        new, length = _renamed(path, RENAMED.get(model, {}))
        if length:
            old_key, new_key = (_PREFIX.get(model, "") + ".".join(each[:length]) for each in (path, new))
            found[old_key] = new_key
            if any(_overlap(new, other) for other in given):
                problems.append(Problem(source, old_key, f"is now {new_key}, and both are given"))
        renamed.append((new, _present_value(model, new, value, found)))
    if problems:
        raise BadInput(list(dict.fromkeys(problems)))
    if not found and not removed:
        return table
    texts = [f"{old} is now {new}" for old, new in found.items()] + [f"{key} is no longer used" for key in removed]
    shown = texts[:named_at_most]
    more = f" ({len(texts) - len(shown)} more)" if len(texts) > len(shown) else ""
    warnings.warn(f"{source}: {', '.join(shown)}{more}", RenamedKey, stacklevel=2)
    return _table_of(renamed)


def _is_in(path: Path, key: str) -> bool:
    """Return whether ``path``, in dispersions as well, is the dotted ``key`` or in its table."""
    names = tuple(key.split("."))
    own = path[1:] if path[:1] and path[0] in _PREFIXES else path
    return own[: len(names)] == names


def first_names_json(model: BaseModel) -> str:
    """Return a configuration as JSON under the keys' first names, for digests that outlast a renaming."""
    return to_json(with_first_names(type(model).__name__, model.model_dump(mode="json"))).decode()


def with_first_names(model: str, table: Table) -> Table:
    """Return a model's whole table under the keys' first names, in the same order, without keys that have been
    added since and change nothing."""
    back = {new: old for old, new in RENAMED[model].items()}
    values = {key: {new: old for old, new in names.items()} for key, names in RENAMED_VALUES.get(model, {}).items()}
    leaves: list[tuple[Path, Any]] = []
    for path, value in _leaves(table):
        if path in _NOT_DIGESTED or value == _NOT_DIGESTED_LEAVES.get(path, _DIGESTED):
            continue
        if value == _NOT_DIGESTED_DEFAULTS.get(path[-1], _DIGESTED):
            continue
        if path in _LISTS_OF_KEYS:
            value = [_renamed_key(item, back) for item in value]
        elif isinstance(value, str):
            value = values.get(".".join(path), {}).get(value, value)
        leaves.append((_renamed(path, back)[0], value))
    return _table_of(leaves)


def present_key(model: str, key: str) -> str:
    """Return the present name of the dotted ``key``."""
    return _renamed_key(key, RENAMED[model])


def present_setting(model: str, setting: str) -> str:
    """Return ``key=value`` with the present name of its key."""
    key, equals, value = setting.partition("=")
    return f"{present_key(model, key.strip())}{equals}{value}"


def _renamed_key(key: str, names: Mapping[str, str]) -> str:
    return ".".join(_renamed(tuple(key.split(".")), names)[0])


def _leaves(table: Table, at: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the path and the value of each key that is not a table, and of each empty table."""
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, (*at, key))
        else:
            yield (*at, key), value


def _table_of(leaves: Iterable[tuple[Path, Any]]) -> Table:
    table: Table = {}
    for (*parents, last), value in leaves:
        place = table
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value
    return table


def _renamed(path: Path, names: Mapping[str, str]) -> tuple[Path, int]:
    """Return ``path`` with the first of ``names`` that it begins with replaced, and the length of the renamed part."""
    skipped = 1 if path[0] in _PREFIXES else 0
    for old, new in names.items():
        parts = old.split(".")
        end = skipped + len(parts)
        own = path[skipped:end]
        if len(own) == len(parts) and all(part in ("*", name) for part, name in zip(parts, own, strict=True)):
            replaced = (name if part == "*" else part for part, name in zip(new.split("."), own, strict=True))
            return (*path[:skipped], *replaced, *path[end:]), end
    return path, 0


def _overlap(one: Path, other: Path) -> bool:
    return all(a == b for a, b in zip(one, other, strict=False))


def _present_value(model: str, path: Path, value: Any, found: dict[str, str]) -> Any:
    """Return ``value`` with the keys or the word that it consists of under their present names; note them."""
    key = ".".join(path)
    if path in _LISTS_OF_KEYS and isinstance(value, list):
        present = [present_key(model, item) if isinstance(item, str) else item for item in value]
        found.update({str(old): new for old, new in zip(value, present, strict=True) if old != new})
        return present
    names = RENAMED_VALUES.get(model, {}).get(key, {})
    if isinstance(value, str) and value in names:
        found[f'{key} = "{value}"'] = f'"{names[value]}"'
        return names[value]
    return value
