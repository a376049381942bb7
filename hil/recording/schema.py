"""Records of a recording, and their schemas, from which any reader gets field, unit and frame.

A record is written as its packed little-endian bytes. The schema of its channel is a JSON text that lists each field
with name, type, shape, offset, unit, frame and meaning, so that a reader does not depend on this program.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from hil.core.fields import Fields, leaf_fields, record_dtype
from hil.core.files import parse_json
from hil.core.manipulator_records import HELD_SAMPLE_FIELDS, MANIPULATOR_SAMPLE_FIELDS
from hil.core.messages import ARRIVAL_FIELDS, AXES_SAMPLE_FIELDS, CYCLE_FIELDS, IMU_SAMPLE_FIELDS
from hil.core.sensor_records import SENSOR_ARRIVAL_FIELDS
from hil.errors import BadInput
from hil.monitor.results import PORTION_FIELDS

VERSION: Final = 4
"""Version of all schemas together, incremented when a record is extended. 2: joint covariance and status of a pose.
3: protection levels, health and reaction. 4: visible fraction of the Sun."""
READABLE: Final = ("1", "2", "3", "4")
"""Versions of recordings that can be loaded: records are only appended to; fields that a recording lacks have
``Field.absent``."""

RECORD_ENCODING: Final = "hil.record"
"""Message encoding of channels of packed records; their schemas have ``hil.fields`` as encoding."""
FIELDS_ENCODING: Final = "hil.fields"

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
operator (action at the console), fault (switched on an emulator). number, key, rights, configuration, digest: as of
``audit``."""

GEOMETRY_FILE, SCENE_FILE, SENSORS_FILE = "vmu_geometry.json", "monitor_scene.json", "sensors.json"
"""Attachments: cameras and targets as assumed by vision unit and docking monitor; further sensors by name, with kind
and the components of a measurement: their names and units."""
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
    "/monitor/portions": ("hil.Portion", PORTION_FIELDS),
    "/imu": ("hil.ImuSample", IMU_SAMPLE_FIELDS),
    "/axes": ("hil.AxesSample", AXES_SAMPLE_FIELDS),
    MANIPULATOR: ("hil.ManipulatorSample", MANIPULATOR_SAMPLE_FIELDS),
    HELD: ("hil.HeldSample", HELD_SAMPLE_FIELDS),
    SENSORS: ("hil.SensorArrival", SENSOR_ARRIVAL_FIELDS),
}
"""Topic -> name of its schema and fields of its messages."""


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
            {**place, "unit": field.unit, "frame": field.frame, "description": field.meaning}
            for place, field in zip(flat_fields(dtype), leaf_fields(fields), strict=True)
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


def _flat(fields: list[dict[str, Any]], size: int) -> np.dtype:
    return np.dtype(
        {
            "names": [field["name"] for field in fields],
            "formats": [(f"<{field['type']}", tuple(field["shape"])) for field in fields],
            "offsets": [field["offset"] for field in fields],
            "itemsize": size,
        }
    )
