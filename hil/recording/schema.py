"""Records of a recording, and their schemas, from which any reader gets field, unit and frame.

A record is written as its packed little-endian bytes. The schema of its channel is a JSON text that lists each field
with name, type, shape, offset, unit, frame and meaning, so that a reader does not depend on this program.

Recordings of version 0.1 have earlier names of keys, which are read under the present ones.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Final

import numpy as np

from hil.core.fields import Fields, leaf_fields, record_dtype
from hil.core.files import parse_json
from hil.core.messages import (
    ARRIVAL_FIELDS,
    AXES_SAMPLE_FIELDS,
    CYCLE_FIELDS,
    HELD_SAMPLE_FIELDS,
    IMU_SAMPLE_FIELDS,
    MANIPULATOR_SAMPLE_FIELDS,
)
from hil.core.part import imported, part_sinks
from hil.core.sensor_records import SENSOR_ARRIVAL_FIELDS
from hil.errors import BadInput

VERSION: Final = 4
"""Version of all schemas together, incremented for a change that readers depend on. 2: joint covariance and status of
a pose. 3: protection levels, health and reaction. 4: visible fraction of the Sun."""
READABLE: Final = ("1", "2", "3", "4")
"""Versions of recordings that can be loaded: records are only appended to; fields that a recording lacks have
``Field.absent``."""

RECORD_ENCODING: Final = "hil.record"
"""Message encoding of channels of packed records; their schemas have ``hil.fields`` as encoding."""
FIELDS_ENCODING: Final = "hil.fields"

_PARTS: Final = {"x": 0, "y": 1, "z": 2, "q1": 0, "q2": 1, "q3": 2, "q0": 3}
"""Earlier name of an element -> its index."""
_TYPE: Final = re.compile(r"[fiu][1248]|b1|S[1-9]\d{0,3}")
_SIZE_MAX: Final = 1 << 20

LOG_ENTRY: Final = np.dtype(
    [
        ("t_s", "f8"), ("bench_s", "f8"), ("cycle", "i8"), ("kind", "S16"), ("source", "S48"), ("text", "S888"),
        ("number", "i8"), ("key", "S16"), ("rights", "S16"), ("configuration", "S64"), ("digest", "S64"),
    ]
)  # fmt: skip
"""Entry of the log. t_s: time of the run, nan before it; bench_s: bench time; cycle: the first on which it acts, or
during which it happened, -1 before the run. kind: event, alarm, alarm state, mode, order (command to the GNC), setting,
operator (action at the console), fault (switched on an emulator). number, key, rights, configuration, digest: as in
``audit``."""

SENSORS_FILE: Final = "sensors.json"
"""Attachment: further sensors by name, with kind and the components of a measurement: their names and units."""
HELD_FILE: Final = "held_axes.json"
"""Attachment: groups of axes that are held during a run, by name, with the names of their axes and their unit."""

MANIPULATOR: Final = "/manipulator"
HELD: Final = "/held_axes"
SENSORS: Final = "/sensors"
OPTIONAL: Final = {MANIPULATOR: "manipulator_samples", HELD: "held_samples", SENSORS: "sensor_samples"}
"""Topics that runs without a rotary manipulator, held axes, or further sensors lack, with their sinks."""
RECORDS: Final[dict[str, tuple[str, Fields]]] = {
    "/cycle": ("hil.Cycle", CYCLE_FIELDS),
    "/vmu/frames": ("hil.Arrival", ARRIVAL_FIELDS),
    "/imu": ("hil.ImuSample", IMU_SAMPLE_FIELDS),
    "/axes": ("hil.AxesSample", AXES_SAMPLE_FIELDS),
    MANIPULATOR: ("hil.ManipulatorSample", MANIPULATOR_SAMPLE_FIELDS),
    HELD: ("hil.HeldSample", HELD_SAMPLE_FIELDS),
    SENSORS: ("hil.SensorArrival", SENSOR_ARRIVAL_FIELDS),
}
"""Topic -> name of its schema and fields of its messages, without those of parts."""
PARTS_FILE: Final = "parts.json"
"""Attachment: parts that the run used, by name, with version, package, topics, and tables in scenario and rig."""


@cache
def _records_of_parts() -> dict[str, tuple[str, Fields]]:
    return {sink.topic: (sink.schema, imported(sink.fields)) for sink in part_sinks().values() if sink.topic}


def records() -> dict[str, tuple[str, Fields]]:
    """Return name of the schema and fields of each topic, those of parts included."""
    return RECORDS | _records_of_parts()


def flat_fields(dtype: np.dtype, prefix: str = "", start: int = 0) -> Iterator[dict[str, Any]]:
    """Yield each plain field of ``dtype`` with its dotted name, type, shape and offset in bytes."""
    for name, (inner, offset, *_) in (dtype.fields or {}).items():
        if inner.names:
            yield from flat_fields(inner, f"{prefix}{name}.", start + offset)
        else:
            kind = inner.base.newbyteorder("<").str.lstrip("<|")
            yield {"name": f"{prefix}{name}", "type": kind, "shape": list(inner.shape), "offset": start + offset}


def describe(name: str, fields: Fields) -> bytes:
    """Return the schema, JSON, of a record."""
    dtype = record_dtype(fields)
    table = {
        "title": name,
        "version": VERSION,
        "encoding": "packed record, little-endian; type as in numpy",
        "size": dtype.itemsize,
        "fields": [
            {**entry, "unit": field.unit, "frame": field.frame, "description": field.meaning}
            for entry, field in zip(flat_fields(dtype), leaf_fields(fields), strict=True)
        ],
    }
    return json.dumps(table, indent=1).encode()


def layout_of(schema: bytes, source: str) -> np.dtype:
    """Return the flat dtype, dotted names, that a schema describes. Raises BadInput if it describes none."""
    try:
        table = parse_json(schema)
        unknown = [field["type"] for field in table["fields"] if not _TYPE.fullmatch(field["type"])]
        if unknown or not 0 < table["size"] <= _SIZE_MAX:
            raise ValueError(f"type {unknown[0]!r}" if unknown else f"size {table['size']}")
        return _flat(table["fields"], table["size"])
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError) as error:
        raise BadInput.single(source, "", f"its schema cannot be read: {error}") from error


def flat_dtype(dtype: np.dtype) -> np.dtype:
    """Return ``dtype`` without nesting: dotted names at the same offsets."""
    return _flat(list(flat_fields(dtype)), dtype.itemsize)


def columns(flat: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the columns of ``flat`` (n,): name and values (n,); ``truth.r_CT_H[0]`` for an element of an array."""
    for name in flat.dtype.names or ():
        values = flat[name]
        if values.dtype.kind == "S":
            values = np.char.decode(values, "utf-8", "replace")
        for index in np.ndindex(*values.shape[1:]):
            yield name + "".join(f"[{i}]" for i in index), values[(slice(None), *index)]


def sensor_tables(flat: np.ndarray, about: str) -> Iterator[tuple[str, dict[str, np.ndarray], dict[str, str]]]:
    """Yield name, columns and units of each further sensor.

    flat: (n,) of SENSOR_ARRIVAL with dotted names. about: text of SENSORS_FILE, with the components of each module.
    """
    for number, (name, sensor) in enumerate(json.loads(about).items()):
        rows = flat[flat["sample.sensor"] == number]
        table = {"t_s": rows["sample.t_s"], "received_s": rows["sample.received_s"], "cycle": rows["cycle"],
                 "result": rows["result"], "nis": rows["nis"]}  # fmt: skip
        units = {"t_s": "s", "received_s": "s"}
        for i, component in enumerate(sensor["components"]):
            column = component["name"]
            table[column], units[column] = rows["sample.value"][:, i], component["unit"]
            table[f"sigma_{column}"] = np.sqrt(rows["sample.covariance"][:, i, i])
            units[f"sigma_{column}"] = component["unit"]
            table[f"innovation_{column}"], units[f"innovation_{column}"] = rows["innovation"][:, i], "1"
        yield name, table, units


def present_column(name: str) -> str:
    """Return the present name of a column that was named with ``.x``, ``.q0``, ``.5`` or ``.0.2`` at its end."""
    field, dot, part = name.rpartition(".")
    if part in _PARTS:
        return f"{field}[{_PARTS[part]}]"
    return f"{present_column(field)}[{part}]" if dot and part.isdecimal() else name


def _flat(fields: list[dict[str, Any]], size: int) -> np.dtype:
    return np.dtype(
        {
            "names": [field["name"] for field in fields],
            "formats": [(f"<{field['type']}", tuple(field["shape"])) for field in fields],
            "offsets": [field["offset"] for field in fields],
            "itemsize": size,
        }
    )


Table = dict[str, Any]
Path = tuple[str, ...]

_RENAMED: Final[Mapping[str, Mapping[str, str]]] = {
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
    "VmuGeometry": {
        "calibration.camera_station_m": "calibration.camera_position_m",
        "calibration.target_station_m": "calibration.target_position_m",
    },
}
"""Model -> earlier key -> present key. ``*``: any name. A key stands before its table."""
_VALUES: Final[Mapping[Path, Mapping[str, str]]] = {
    ("monitor", "target"): {"reserve": "backup"},
    ("gnc", "navigation", "backend"): {"vision_imu": "builtin", "vision": "vision_alone"},
}
"""Present key of a scenario -> earlier value -> present value."""
_REMOVED: Final[tuple[Path, ...]] = (("gnc", "vision_only"), ("gnc", "akf", "form"))
_KEYS: Final = ("console", "adjustable")  # a list of keys


def with_present_names(model: str, table: Table) -> Table:
    """Return a recorded ``table`` under the present names of the keys of ``model``."""
    present: Table = {}
    for path, value in leaves(table):
        start = 1 if path[0] == "dispersions" else 0  # it repeats the scenario's tables
        if any(path[start : start + len(gone)] == gone for gone in _REMOVED):
            continue
        *parents, last = (*path[:start], *_renamed(model, path[start:]))
        if (*parents, last) == _KEYS:
            value = [present_key(model, key) for key in value]
        elif model == "Scenario" and isinstance(value, str):
            value = _VALUES.get((*parents, last), {}).get(value, value)
        node = present
        for parent in parents:
            node = node.setdefault(parent, {})
        node[last] = value
    return present


def present_key(model: str, key: str) -> str:
    """Return the present name of the dotted ``key``."""
    return ".".join(_renamed(model, tuple(key.split("."))))


def leaves(table: Table, at: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the path and the value of each key that is not a table, and of each empty table."""
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from leaves(value, (*at, key))
        else:
            yield (*at, key), value


def _renamed(model: str, path: Path) -> Path:
    for old, new in _RENAMED.get(model, {}).items():
        parts = old.split(".")
        own = path[: len(parts)]
        if len(own) == len(parts) and all(part in ("*", name) for part, name in zip(parts, own, strict=True)):
            names = (name if part == "*" else part for part, name in zip(new.split("."), own, strict=True))
            return (*names, *path[len(parts) :])
    return path
