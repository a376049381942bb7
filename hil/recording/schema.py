"""What stands in a recording: its records, and the schemas by which any reader finds field, unit and frame.

A record is written as its packed little-endian bytes. The schema of its channel is a JSON text that lists
each field with name, type, shape, offset, unit, frame and meaning, so that a reader needs nothing of this program.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from hil.core.fields import Fields, leaf_fields, record_dtype
from hil.core.messages import ARRIVAL_FIELDS, CYCLE_FIELDS
from hil.errors import BadInput
from hil.monitor.results import PORTION_FIELDS

VERSION: Final = 1
"""Of all schemas together; goes up when a record of CYCLE or ARRIVAL gets another layout."""

RECORD_ENCODING: Final = "hil.record"
"""Message encoding of channels of packed records; their schemas have ``hil.fields`` as encoding."""
FIELDS_ENCODING: Final = "hil.fields"

NOTE: Final = np.dtype(
    [("t_s", "f8"), ("bench_s", "f8"), ("cycle", "i8"), ("kind", "S16"), ("source", "S48"), ("text", "S888")]
)
"""Something worth a line. t_s: time of the run, nan before it; bench_s: bench time; cycle: the first that it acts on,
or during which it happened, -1 before the run. kind: event, alarm, mode, order (what the GNC was told to do), setting,
operator (who did what at the console), fault (switched on an emulator)."""

GEOMETRY_FILE, SCENE_FILE = "vmu_geometry.json", "monitor_scene.json"
"""Attachments: what vision unit and docking monitor take their cameras and targets for."""

RECORDS: Final[dict[str, tuple[str, Fields]]] = {
    "/cycle": ("hil.Cycle", CYCLE_FIELDS),
    "/vmu/frames": ("hil.Arrival", ARRIVAL_FIELDS),
    "/monitor/portions": ("hil.Portion", PORTION_FIELDS),
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
    """Return the flat dtype, dotted names, that a schema tells of. Raises BadInput for one that is none."""
    try:
        table = json.loads(schema)
        fields = table["fields"]
        return np.dtype(
            {
                "names": [field["name"] for field in fields],
                "formats": [(f"<{field['type']}", tuple(field["shape"])) for field in fields],
                "offsets": [field["offset"] for field in fields],
                "itemsize": table["size"],
            }
        )
    except (ValueError, LookupError, TypeError) as error:
        raise BadInput.single(source, "", f"its schema cannot be read: {error}") from error


def same_layout(found: np.dtype, dtype: np.dtype) -> bool:
    """Return whether records of the flat ``found`` have the very bytes of ``dtype``."""
    return found.itemsize == dtype.itemsize and list(flat_fields(found)) == list(flat_fields(dtype))
