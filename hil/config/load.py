"""Loader of configuration files. Reports all errors of a file, one line per error."""

from __future__ import annotations

import json
import os
import pickle
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, get_origin

from pydantic import BaseModel, ValidationError

from hil.config.rig import Rig, with_fixed_axes
from hil.config.scenario import Scenario
from hil.config.tables.body import CentralBody
from hil.config.tables.dispersions import Dispersions
from hil.config.tables.driver_registry import DeviceTable
from hil.config.tables.fmu_mapping import FmuMapping
from hil.config.tables.limits import RIG_LIMITS, SCENARIO_LIMITS, Kind, Limit, excess
from hil.config.tables.model import ConfigModel
from hil.config.tables.open_table import FileTable, OpenTable, model_of_field
from hil.config.tables.sensors import by_name
from hil.config.tables.units import converted, split
from hil.core.files import CONFIG_BYTES, parse_json, parse_toml, read_text
from hil.core.own_code import note_users
from hil.errors import INSTALLED, BadInput, Problem, did_you_mean

if TYPE_CHECKING:  # models of the files that most runs do not read are imported with the first of them
    from hil.config.protocol import Protocol
    from hil.config.scene import Scene
    from hil.config.vmu_frame import VmuFrame
    from hil.config.vmu_geometry import VmuGeometry

Model = TypeVar("Model", bound=ConfigModel)
Table = dict[str, Any]

_SUFFIXES = {"targets": (".json", ".toml")}  # scenes of other programs are JSON
_WORDS = {"targets": "scene", "geometries": "geometry", "dispersions": "dispersion set", "bodies": "body"}
_FILES_OF_KEYS = {
    "protocol": (".toml",),
    "frames": (".toml",),
    "scene": (".json", ".toml"),
    "library": (".so",),
    "fmu": (".fmu",),
    "fmu_mapping": (".toml",),
    "backend": (".so",),
    "dispersions": (".toml",),
    "body": (".toml",),
}  # values that are names, or paths with these endings
_NEVER = ("\0",)
_DISPERSIONS = "dispersions."
"""Start of the keys of distributions."""

_PROBLEMS_MAX = 20
_DEPTH_MAX = 20
_MISSING_SHOWN = 5
_TYPE_LABEL = re.compile(r"float|int|bool|str|constrained-\w+|[A-Z]\w*|.*\[.*")
"""What pydantic adds to the location of an error in a value of several types: the type that it tried."""
_MUST = "Input should be "
_TOO_FEW = re.compile(r"^\w+ should have (.*?) after validation")


@cache
def configs_folder() -> Path:
    """Return the folder of the shipped configs: next to the package in a checkout, inside it if installed."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def shipped(kind: str) -> list[str]:
    """Return the names of the shipped files of ``kind``: "scenarios", "dispersions", "rigs", "protocols", "frames",
    "targets", "bodies"."""
    return sorted(path.stem for path in (configs_folder() / kind).glob("*.toml"))


@dataclass(frozen=True)
class Loaded(Generic[Model]):
    """Checked configuration: model, source, and the file or option that set each key.

    given: the name and the settings with which it was loaded, () for an object.
    """

    value: Model
    source: str
    origin: Mapping[str, str]
    given: tuple[str, ...] = ()

    def where(self, key: str) -> str:
        """Return the file or option that set ``key``."""
        return _where(key, self.origin, self.source)

    def with_table(self, table: Table) -> Loaded[Model]:
        """Return ``table`` in the place of the content, checked. Raises BadInput."""
        return replace(check_table(table, type(self.value), self.source, dict(self.origin)), given=self.given)

    def problem(self, key: str, message: str) -> Problem:
        """Return a problem of ``key`` in the file or option that set it."""
        return Problem(self.where(key), key, message)


def load_scenario(name: str, settings: Iterable[str] = ()) -> Loaded[Scenario]:
    """Return the scenario ``name`` (shipped, or a path) with ``settings`` applied; raise BadInput."""
    chosen = [text for text in settings if not text.startswith("rig.")]
    loaded = _load(name, "scenarios", Scenario, chosen, prefix="")
    check_limits(loaded, SCENARIO_LIMITS, "mock", "")
    return loaded


def load_rig(name: str, settings: Iterable[str] = ()) -> Loaded[Rig]:
    """Return the rig ``name`` (shipped, or a path) with the ``rig.``-settings applied; raise BadInput."""
    chosen = [text for text in settings if text.startswith("rig.")]
    loaded = _load(name, "rigs", Rig, chosen, prefix="rig.")
    check_wires(loaded)
    check_limits(loaded, RIG_LIMITS, loaded.value.kind, "rig.")
    return loaded


def check_limits(loaded: Loaded[Any], limits: tuple[Limit, ...], kind: Kind, prefix: str) -> None:
    """Raise BadInput if a protective limit is weaker than a rig of ``kind`` accepts. prefix: of their keys."""
    exceeded = excess(limits, loaded.value, kind)
    if exceeded:
        raise BadInput([Problem(loaded.where(key), f"{prefix}{key}", text) for key, text in exceeded])


def check_wires(rig: Loaded[Rig]) -> None:
    """Raise BadInput if a device of a hardware rig has no wire."""
    missing = rig.value.missing_wires() if rig.value.kind == "hardware" else []
    if missing:
        text = "is missing: the wire to the device"
        raise BadInput([Problem(rig.where(key), f"rig.{key}", text) for key in missing])


def load_protocol(name: str) -> Loaded[Protocol]:
    """Return the command set ``name`` (shipped, or a path); raise BadInput."""
    from hil.config.protocol import Protocol

    return _load(name, "protocols", Protocol, (), prefix="")


def load_frame(name: str) -> Loaded[VmuFrame]:
    """Return the pose frame ``name`` of a vision unit (shipped, or a path); raise BadInput."""
    from hil.config.vmu_frame import VmuFrame

    return _load(name, "frames", VmuFrame, (), prefix="")


def load_geometry(path: str) -> Loaded[VmuGeometry]:
    """Return the vision unit's geometry file at ``path``, JSON or TOML as its name ends; raise BadInput."""
    from hil.config.vmu_geometry import VmuGeometry

    origin: dict[str, str] = {}
    table = read_with_bases(Path(path), "geometries", VmuGeometry, origin)
    return check_table(table, VmuGeometry, path, origin)


def load_fmu_mapping(path: str) -> FmuMapping:
    """Return the mapping file of an FMU at ``path``; raise BadInput."""
    origin: dict[str, str] = {}
    table = read_with_bases(Path(path), "mappings", FmuMapping, origin)
    return check_table(table, FmuMapping, path, origin).value


def load_body(name: str) -> Loaded[CentralBody]:
    """Return the central body ``name`` (shipped, or a path); raise BadInput. An unchanged file is not read again."""
    path = _find(name, "bodies")
    stamp = path.stat()
    return _load_body(str(path), stamp.st_mtime_ns, stamp.st_size)


@lru_cache(maxsize=8)
def _load_body(path: str, _changed_ns: int, _size: int) -> Loaded[CentralBody]:
    return _load(path, "bodies", CentralBody, (), prefix="")


def load_scene(name: str) -> Loaded[Scene]:
    """Return the monitor's scene ``name`` (shipped, or the path of a TOML or JSON file); raise BadInput."""
    from hil.config.scene import Scene

    return _load(name, "targets", Scene, (), prefix="")


def _load(name: str, kind: str, model: type[Model], settings: Sequence[str], prefix: str) -> Loaded[Model]:
    path = _find(name, kind)
    origin: dict[str, str] = {}
    table = read_with_bases(path, kind, model, origin)
    apply_settings(table, settings, model, origin, prefix)
    return replace(check_table(table, model, str(path), origin, prefix), given=(name, *settings))


def check_table(
    table: Table, model: type[Model], source: str, origin: Mapping[str, str] | None = None, prefix: str = ""
) -> Loaded[Model]:
    """Return ``table`` as ``model``; raise BadInput with all errors. prefix: of the keys in messages."""
    table = with_fixed_axes(table) if model is Rig else table
    try:
        # via JSON: its strict mode accepts lists for tuples and integers for floats, nothing else
        value = model.model_validate_json(json.dumps(table, default=str))
    except ValidationError as error:
        raise BadInput(_problems(error, model, table, source, origin or {}, prefix)) from error
    return Loaded(value, source, origin or {})


def _find(name: str, kind: str) -> Path:
    shipped_path = configs_folder() / kind / f"{name}.toml"
    if os.path.isfile(shipped_path):  # unlike Path.is_file, also takes a name that is no path
        return shipped_path
    path = Path(name)
    suffixes = _SUFFIXES.get(kind, (".toml",))
    if path.suffix in suffixes and os.path.isfile(path):
        return path
    what = _WORDS.get(kind, kind.removesuffix("s"))
    reason = "no such file" if path.suffix in suffixes else f"unknown {what}"
    names = ", ".join(shipped(kind))
    patterns = ", ".join(f"*{suffix}" for suffix in suffixes)
    raise BadInput.single(
        name, "", f"{reason}: {did_you_mean(name, shipped(kind))}give {names} or the path of a {what} file ({patterns})"
    )


def read_with_bases(
    path: Path,
    kind: str,
    model: type[ConfigModel],
    origin: dict[str, str],
    chain: tuple[Path, ...] = (),
    prefix: str = "",
) -> Table:
    """Return the file's table merged over that of the file it extends; ``origin`` gets the file of each key.

    prefix: of the keys in ``origin``.
    """
    table = _read_table(path)
    _find_files_beside(table, path.parent)
    if model is Scenario and isinstance(table.get("requirements"), list):
        table["requirements"] = {"probabilistic": table["requirements"]}
    if model is Scenario and "sensors" in table:
        table["sensors"] = by_name(table["sensors"], str(path))
    chosen_set = table.pop("dispersions") if _names_dispersion_set(model, table) else None
    base_name = table.pop("extends", None)
    base: Table = {}
    if base_name is not None:
        if not isinstance(base_name, str):
            raise BadInput.single(str(path), "extends", f"{base_name!r}: must be a name or a path in quotes")
        beside = path.parent / base_name
        try:
            base_path = beside if beside.suffix == ".toml" and os.path.isfile(beside) else _find(base_name, kind)
        except BadInput as error:
            text = f"{base_name!r}: {error.problems[0].message}"
            raise BadInput.single(str(path), "extends", text) from error
        if base_path.resolve() in chain or base_path.resolve() == path.resolve():
            raise BadInput.single(str(path), "extends", f"{base_name!r}: the files extend each other in a circle")
        base = read_with_bases(base_path, kind, model, origin, (*chain, path.resolve()), prefix)
    if chosen_set is not None:
        _put_dispersion_set(base, chosen_set, origin)
    merge_tables(base, table, str(path), origin, prefix)
    note_users(table)
    return base


def _names_dispersion_set(model: type[ConfigModel], table: Table) -> bool:
    return model is Scenario and isinstance(table.get("dispersions"), str)


def _put_dispersion_set(table: Table, name: str, origin: dict[str, str]) -> None:
    """Replace the dispersions of a scenario's ``table`` by those of the set ``name``, shipped or a path."""
    path = _find(name, "dispersions")
    origin_of_set: dict[str, str] = {}
    table["dispersions"] = read_with_bases(path, "dispersions", Dispersions, origin_of_set, prefix=_DISPERSIONS)
    if not table["dispersions"]:
        raise BadInput.single(str(path), "", "contains no distribution")
    for stale in [key for key in origin if key == "dispersions" or key.startswith(_DISPERSIONS)]:
        del origin[stale]
    origin["dispersions"] = str(path)
    origin.update(origin_of_set)


def _read_table(path: Path) -> Table:
    """Return the table in the file at ``path``; a shipped file is parsed once."""
    if configs_folder() not in path.parents:
        return _parsed_table(path)
    table: Table = pickle.loads(_shipped_table(path))
    return table


@cache
def _shipped_table(path: Path) -> bytes:
    return pickle.dumps(_parsed_table(path))


def _parsed_table(path: Path) -> Table:
    text, is_json = read_text(path, CONFIG_BYTES), path.suffix == ".json"
    try:
        table = parse_json(text) if is_json else parse_toml(text)
    except ValueError as error:
        raise BadInput.single(str(path), "", f"not {'JSON' if is_json else 'TOML'}: {error}") from error
    if not isinstance(table, dict):
        raise BadInput.single(str(path), "", "must be a table of keys and values")
    return table


def _find_files_beside(table: Table, folder: Path) -> None:
    """Make paths relative to the folder of their file: keys in ``_file``, protocol, frames, scene, library, FMU."""
    for key, value in table.items():
        if isinstance(value, dict):
            _find_files_beside(value, folder)
        elif isinstance(value, str) and _names_a_file(key, value):
            table[key] = str(folder / value)


def _names_a_file(key: str, value: str) -> bool:
    """Return whether ``value`` is a path, or a path and a name in that file: ``law.py:lqr``."""
    if key == "backend" and ".py:" in value:
        return True
    return key.endswith("_file") or value.endswith(_FILES_OF_KEYS.get(key, _NEVER))


def merge_tables(base: Table, table: Table, source: str, origin: dict[str, str], prefix: str = "") -> None:
    """Merge the keys of ``table`` over those of ``base``, table by table; a distribution replaces that of its key."""
    for key, value in table.items():
        dotted, present = f"{prefix}{key}", base.get(key)
        if isinstance(value, dict) and isinstance(present, dict) and not _are_distributions(dotted, value, present):
            origin[dotted] = source  # contradictions within a table are attributed to the last file that changed it
            merge_tables(base[key], value, source, origin, f"{dotted}.")
        else:
            if isinstance(present, dict):
                for stale in [dotted_key for dotted_key in origin if dotted_key.startswith(f"{dotted}.")]:
                    del origin[stale]
            base[key] = value
            _note_origin(value, dotted, source, origin)


def _are_distributions(dotted: str, value: Table, present: Table) -> bool:
    """Return whether the tables at ``dotted`` are distributions of a key: whole, as limits go with their kind only."""
    return dotted.startswith(_DISPERSIONS) and any(isinstance(table.get("kind"), str) for table in (value, present))


def _note_origin(value: Any, dotted: str, source: str, origin: dict[str, str]) -> None:
    origin[dotted] = source
    if isinstance(value, dict):
        for key, inner in value.items():
            _note_origin(inner, f"{dotted}.{key}", source, origin)


def apply_settings(
    table: Table, settings: Sequence[str], model: type[ConfigModel], origin: dict[str, str], prefix: str = ""
) -> None:
    """Put each ``key=value`` of ``settings`` into ``table``, the later over the earlier; raise BadInput.

    prefix: may stand before the keys.
    """
    for text in settings:
        (*parents, last), value = _parse_setting(text, prefix)
        note_users(value)
        node = table
        for name in parents:
            node = node.setdefault(name, {})
            if not isinstance(node, dict):
                raise BadInput.single("--set", text, f"{name} is not a table")
        node[last] = value
        if _names_dispersion_set(model, table):
            _put_dispersion_set(table, table["dispersions"], origin)
        else:
            _note_origin(value, ".".join((*parents, last)), "--set", origin)


def parsed_settings(settings: Sequence[str]) -> dict[str, Any]:
    """Return dotted keys and values of ``key=value`` texts. Raises BadInput."""
    return {".".join(path): value for path, value in (_parse_setting(text, "") for text in settings)}


def _parse_setting(text: str, prefix: str) -> tuple[list[str], Any]:
    """Return the path and the value of ``key=value``; raise BadInput."""
    key, equals, value_text = text.partition("=")
    key = key.strip()
    if not equals or not key:
        raise BadInput.single("--set", text, "must look like gnc.control.deadband_m=0.004 or rig.vmu.timeout_s=0.5")
    try:
        value = parse_toml(f"value = {value_text}")["value"]
    except tomllib.TOMLDecodeError:
        value = value_text.strip()  # a bare word: the shell has removed its quotes
    except ValueError as error:
        raise BadInput.single("--set", text, str(error)) from error
    path = key.removeprefix(prefix).split(".")
    if len(path) > _DEPTH_MAX:
        raise BadInput.single("--set", f"{key[:60]}...", f"{len(path)} levels: allowed up to {_DEPTH_MAX}")
    return path, value


def _problems(
    error: ValidationError, model: type[BaseModel], table: Table, source: str, origin: Mapping[str, str], prefix: str
) -> list[Problem]:
    problems = []
    faults = [*_of_one_type(error.errors(), table), *_unknown_in_open_tables(error, model, table)]
    missing = [".".join(map(str, fault["loc"])) for fault in faults if fault["type"] == "missing"]
    if len(missing) > _MISSING_SHOWN:
        shown = ", ".join(f"{prefix}{key}" for key in missing[:_MISSING_SHOWN])
        shown += f" and {len(missing) - _MISSING_SHOWN} more"
        advice = 'are missing: extends = "..." in its first line gives a file the keys of another'
        problems.append(Problem(source, shown, advice))
        faults = [fault for fault in faults if fault["type"] != "missing"]
    for fault in faults[:_PROBLEMS_MAX]:
        location = _keys_of(fault["loc"], table)
        dotted = ".".join(part for part in location if isinstance(part, str))
        shown = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).removeprefix(".")
        message = _message(fault, model, [part for part in location if isinstance(part, str)], table)
        problems.append(Problem(_where(dotted, origin, source), f"{prefix}{shown}" if dotted else "", message))
    if len(faults) > _PROBLEMS_MAX:
        problems.append(Problem(source, "", f"{len(faults) - _PROBLEMS_MAX} more errors"))
    return problems


def _where(key: str, origin: Mapping[str, str], source: str) -> str:
    """Return the file or option that set ``key``, or all that is in it, or the table that has it; else ``source``."""
    within = {each for name, each in origin.items() if name.startswith(f"{key}.")} if key not in origin else set()
    if len(within) == 1:
        return within.pop()
    while key and key not in origin:
        key = key.rpartition(".")[0]
    return origin.get(key, source)


def _of_one_type(faults: Sequence[Any], table: Table) -> list[Any]:
    """Return ``faults``, of a value that has none of the types of its key only those of the type that fits best."""
    by_place: dict[tuple[str | int, ...], list[Any]] = {}
    for number, fault in enumerate(faults):
        at = _type_label_at(fault["loc"], table)
        location = (number,) if at is None else ("value", *fault["loc"][:at])
        by_place.setdefault(location, []).append(fault)
    best: list[Any] = []
    for location, alike in by_place.items():
        best += alike if location[0] != "value" else _best_of_types(alike, len(location) - 1, table)
    return best


def _best_of_types(faults: Sequence[Any], at: int, table: Table) -> list[Any]:
    """Return the faults of the type that fits best, without its label, which is at ``at`` of their locations."""
    deepest = max(len(fault["loc"]) for fault in faults)
    best = [
        {**fault, "loc": (*fault["loc"][:at], *fault["loc"][at + 1 :])}
        for fault in faults
        if len(fault["loc"]) == deepest
    ]
    if deepest > at + 1:
        return _of_one_type(best, table)
    if special := [fault for fault in best if not fault["msg"].startswith(_MUST)]:
        return special[:1]
    allowed = dict.fromkeys(fault["msg"].removeprefix(_MUST) for fault in best)
    return [{**best[0], "type": "types", "msg": f"{_MUST}{' or '.join(allowed)}"}]


def _type_label_at(location: Sequence[str | int], table: Table) -> int | None:
    """Return the index of the first label of a type in pydantic's ``location``, None without one."""
    node: Any = table
    for at, part in enumerate(location):
        if isinstance(node, dict) and part in node:
            node = node[part]
        elif isinstance(part, str) and _TYPE_LABEL.fullmatch(part):
            return at
        else:
            node = node[part] if isinstance(part, int) and isinstance(node, list) and part < len(node) else None
    return None


def _keys_of(location: Sequence[str | int], table: Table) -> list[str | int]:
    """Return the keys and indices in pydantic's ``location``, which also names alternatives: ``tuple[...]``."""
    keys: list[str | int] = []
    node: Any = table
    for part in location:
        is_key = isinstance(node, dict) and part in node
        if not is_key and isinstance(part, str) and "[" in part:
            continue
        keys.append(part)
        if is_key or (isinstance(part, int) and isinstance(node, list) and part < len(node)):
            node = node[part]
        else:
            node = None
    return keys


def _unknown_in_open_tables(error: ValidationError, model: type[BaseModel], table: Table) -> list[dict[str, Any]]:
    """Return the unknown keys of open tables that pydantic did not reach because of other faults in the table."""
    reported = {fault["loc"] for fault in error.errors()}
    unknown_keys: list[dict[str, Any]] = []
    if issubclass(model, FileTable):
        unknown = model.unknown_keys(table)
        unknown_keys += [{"type": "extra_forbidden", "loc": (key,), "input": table[key]} for key in unknown]
    for device in model.model_fields:
        inner, device_model = table.get(device), model_of_field(model, device)
        if not isinstance(inner, dict) or device_model is None or not issubclass(device_model, DeviceTable):
            continue
        named = get_origin(model.model_fields[device].annotation) is dict
        tables = {(device, name): each for name, each in inner.items()} if named else {(device,): inner}
        for path, each in tables.items():
            unknown = device_model.unknown_keys(each) if isinstance(each, dict) else []
            unknown_keys += [{"type": "extra_forbidden", "loc": (*path, key), "input": each[key]} for key in unknown]
    return [fault for fault in unknown_keys if fault["loc"] not in reported]


def _message(fault: Any, model: type[BaseModel], location: list[str], table: Table) -> str:
    kind = fault["type"]
    if kind == "missing":
        return f"is missing{_expected(model, location)}"
    if kind == "extra_forbidden":
        return _unknown_key(model, location, fault["input"])
    text = str(fault["msg"]).removeprefix("Value error, ")
    if kind == "value_error":
        return text
    text = _TOO_FEW.sub(r"must have \1", text)
    text = text[0].lower() + text[1:]
    value = fault["input"]
    if kind == "finite_number":
        return f"{_shown(value)}: must be a finite number"
    return f"{_shown(value)}: {text.replace('input should', 'must')}"


def _shown(value: Any) -> str:
    text = json.dumps(value, default=str) if not isinstance(value, float) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _expected(model: type[BaseModel], location: list[str]) -> str:
    """Return the expected value, as far as the unit in the name gives it."""
    parent = _model_at(model, location[:-1])
    unit = split(location[-1])[1]
    return f": a value in {unit}" if parent is not None and unit else ""


def _unknown_key(model: type[BaseModel], location: list[str], value: Any) -> str:
    parent = _model_at(model, location[:-1])
    names = sorted(parent.model_fields) if parent is not None else []
    key = location[-1]
    of_part = ""
    if parent is not None and issubclass(parent, FileTable):
        names = sorted([*names, *parent.added_tables()])
        if isinstance(value, dict):
            of_part = f"; or the table of a part that is not installed, see hil list parts{INSTALLED}"
    if meant := converted(key, value, names):
        return f"unknown key: did you mean {meant}?"
    stem = split(key)[0]
    same_stem = [name for name in names if split(name)[0] == stem]
    if same_stem:
        return f"unknown key: the unit is part of the name, here it is {' or '.join(same_stem)}"
    return f"unknown key: {did_you_mean(key, names)}known here: {', '.join(names)}{of_part}"


def _model_at(model: type[BaseModel], location: Sequence[str]) -> type[BaseModel] | None:
    """Return the model of the table at ``location``, None if there is no table."""
    current: type[BaseModel] | None = model
    keys = iter(location)
    for key in keys:
        if current is None:
            return None
        field = current.model_fields.get(key)
        current = current.model_of(key) if issubclass(current, OpenTable) else model_of_field(current, key)
        if field is not None and get_origin(field.annotation) is dict:
            next(keys, None)  # the name that the file gives to one of the tables
    return current
