"""Export of a recording's numbers to tables: Parquet or CSV, one column per number."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from hil.core.fields import leaf_fields
from hil.core.files import replaced
from hil.core.messages import CYCLE, CYCLE_FIELDS, MAX_THRUSTERS, with_thrusters
from hil.core.part import part_sinks
from hil.errors import BadInput
from hil.recording import foxglove, schema
from hil.recording.read import Contents, contents, directory

TABLES: Final = {
    "/cycle": "cycles",
    "/vmu/frames": "frames",
    "/imu": "imu",
    "/axes": "axes",
    schema.MANIPULATOR: "manipulator",
    schema.HELD: "axes",
    schema.SENSORS: "sensors",
    foxglove.LOG_TOPIC: "log",
}
"""Topic -> name of its table; the cycles go to the given file, the others next to it."""
_OPTIONAL: Final = ("/imu", "/axes", *schema.OPTIONAL)  # most runs have none of these

_CSV_ROWS: Final = 1000
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r")


def export(path: Path, form: Literal["parquet", "csv"], out: Path) -> list[tuple[Path, int]]:
    """Write the tables of the recording at ``path``; return each file with its number of rows.

    ``out`` has the cycles; frames and log are in ``OUT-frames`` and ``OUT-log`` next to it, rows of parts in tables of
    their own, as ``OUT-portions`` of a docking monitor, samples of IMU and axes that are faster than the cycle in
    ``OUT-imu`` and ``OUT-axes``, the axes of a rig with a rotary manipulator in ``OUT-manipulator``, each group of held
    axes in ``OUT-axes-NAME``, each further sensor in ``OUT-sensor-NAME``. Works on recordings of any version, by the
    layout in their schemas. Raises BadInput.
    """
    if form == "parquet":
        _pyarrow()
    names = TABLES | _tables_of_parts(path)
    recording = contents(path, frozenset(names))
    written = []
    for name, table, units in _tables(recording, names):
        target = out if name == "cycles" else out.with_name(f"{out.stem}-{name}{out.suffix}")
        _write_file(form, table, units, target)
        written.append((target, len(next(iter(table.values())))))
    return written


def _tables_of_parts(path: Path) -> dict[str, str]:
    """Return the table of each topic that a part has added, installed or not: named as its sink, or as the topic."""
    installed = {sink.topic: name for name, sink in part_sinks().items()}
    channels = directory(path)[1].values()
    others = [each.topic for each in channels if each.message_encoding == schema.RECORD_ENCODING]
    return {topic: installed.get(topic, topic.strip("/").replace("/", "-")) for topic in others if topic not in TABLES}


def _tables(recording: Contents, names: dict[str, str]) -> Iterator[tuple[str, dict[str, Any], dict[str, str]]]:
    """Yield name, columns and units of each table that the recording has; of held axes and sensors one per name.

    names: of the tables, by topic.
    """
    for topic, name in names.items():
        if topic == schema.SENSORS:
            yield from _sensor_tables(recording)
        elif topic == schema.HELD:
            yield from _held_tables(recording)
        elif (table := _table(recording, topic)) is not None:
            yield name, table, _units(recording, topic)


def _sensor_tables(recording: Contents) -> Iterator[tuple[str, dict[str, Any], dict[str, str]]]:
    """Yield the table of each further sensor, ``sensor-NAME``, with the columns that its module declares."""
    if not recording.records.get(schema.SENSORS) or schema.SENSORS_FILE not in recording.files:
        return
    for name, table, units in schema.sensor_tables(
        recording.flat(schema.SENSORS), recording.files[schema.SENSORS_FILE]
    ):
        yield f"sensor-{name}", table, units


def _held_tables(recording: Contents) -> Iterator[tuple[str, dict[str, Any], dict[str, str]]]:
    """Yield the table of each group of axes that are held, ``axes-NAME``, with the columns of its axes."""
    if not recording.records.get(schema.HELD) or schema.HELD_FILE not in recording.files:
        return
    flat = recording.flat(schema.HELD)
    for number, (name, group) in enumerate(json.loads(recording.files[schema.HELD_FILE]).items()):
        rows, unit = flat[flat["group"] == number], group["unit"]
        table, units = {"t_s": rows["t_s"], "sampled_s": rows["sampled_s"]}, {"t_s": "s", "sampled_s": "s"}
        for i, axis in enumerate(group["axes"]):
            columns_of_axis = {f"{axis}_setpoint_{unit}": ("setpoint", unit), f"{axis}_{unit}": ("position", unit),
                               f"{axis}_{unit}ps": ("rate", f"{unit}/s")}  # fmt: skip
            for column, (field, its_unit) in columns_of_axis.items():
                table[column], units[column] = rows[field][:, i], its_unit
        yield f"axes-{name}", table, units


def write_cycles(history: np.ndarray, thrusters: int, out: Path) -> None:
    """Write ``history``, (n,) of CYCLE, as Parquet to ``out``: the table of cycles of ``export``. Raises BadInput.

    thrusters: of the vehicle.
    """
    table = dict(schema.columns(with_thrusters(history.view(schema.flat_dtype(CYCLE)), thrusters)))
    units = {f.name: " in ".join(word for word in (f.unit, f.frame) if word) for f in leaf_fields(CYCLE_FIELDS)}
    _write_file("parquet", table, units, out)


def _write_file(form: str, table: dict[str, Any], units: dict[str, str], target: Path) -> None:
    """Write a table to ``target``, completely or not at all. Raises BadInput."""
    try:
        with replaced(target) as partial:
            _write(form, table, units, partial)
    except OSError as error:
        raise BadInput.single(str(target), "", f"cannot be written: {error.strerror or error}") from error


def _table(recording: Contents, topic: str) -> dict[str, Any] | None:
    if (topic in _OPTIONAL or topic not in TABLES) and not recording.records.get(topic):
        return None
    if topic in recording.layouts:
        return dict(schema.columns(with_thrusters(recording.flat(topic), _thrusters_of(recording))))
    if topic == foxglove.LOG_TOPIC and topic in recording.lines:
        names = ("t_s", "bench_s", "cycle", "kind", "name", "message")
        return {name: [line.get(name) for line in recording.lines[topic]] for name in names}
    return None


def _thrusters_of(recording: Contents) -> int:
    """Return the number of thrusters of the recorded vehicle; if it is unknown, that of the places in a record."""
    try:
        return len(json.loads(recording.files["scenario.json"])["chaser"]["thrusters"]["position_m"])
    except (KeyError, ValueError, TypeError):
        return MAX_THRUSTERS


def _units(recording: Contents, topic: str) -> dict[str, str]:
    """Return the unit and frame of each field, by its name, from the recording's schema."""
    if topic not in recording.schemas:
        return {"t_s": "s", "bench_s": "s"}
    fields = json.loads(recording.schemas[topic])["fields"]
    return {f["name"]: " in ".join(word for word in (f.get("unit", ""), f.get("frame", "")) if word) for f in fields}


def _write(form: str, table: dict[str, Any], units: dict[str, str], path: Path) -> None:
    if form == "parquet":
        _write_parquet(table, units, path)
    else:
        _write_csv(table, path)


def _write_csv(table: dict[str, Any], path: Path) -> None:
    """Write the numbers with all digits; nan stays nan.

    A text that a spreadsheet would take for a formula has an apostrophe before it.
    """
    lists = [
        values.tolist() if isinstance(values, np.ndarray) and values.dtype.kind in "biuf" else map(_plain, values)
        for values in table.values()
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(map(_plain, table))
        rows = list(zip(*lists, strict=True))
        for start in range(0, len(rows), _CSV_ROWS):
            writer.writerows(rows[start : start + _CSV_ROWS])


def _plain(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def _write_parquet(table: dict[str, Any], units: dict[str, str], path: Path) -> None:
    arrow, parquet = _pyarrow()
    fields, arrays = [], []
    for name, values in table.items():
        array = arrow.array(np.ascontiguousarray(values) if isinstance(values, np.ndarray) else values)
        unit = units.get(name.partition("[")[0], "")
        fields.append(arrow.field(name, array.type, metadata={"unit": unit} if unit else None))
        arrays.append(array)
    parquet.write_table(arrow.table(arrays, schema=arrow.schema(fields)), path, compression="zstd")


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        text = "needs pyarrow, which is not installed: pip install 'hil-bench[parquet]', or use --format csv"
        raise BadInput.single("--format", "parquet", text) from error
    return pyarrow, parquet
