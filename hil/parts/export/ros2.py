"""Export of a recording as a bag of ROS 2: an MCAP file with ROS 2 messages, and its ``metadata.yaml``.

Messages are encoded here (OMG CDR, little-endian), from the definitions of the ROS 2 interfaces. Stamps are the
wall clock at the start of the run plus the time of the run; ``/time_of_run`` has the latter.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import struct
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.writer import CompressionType, Writer

from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES
from hil.core.camera_images import LEFT, RIGHT
from hil.core.fields import Fields
from hil.core.messages import CYCLE_FIELDS
from hil.errors import BadInput
from hil.recording import schema
from hil.recording.images import recorded_images
from hil.recording.read import Recorded, load

_VECTOR: Final = "geometry_msgs/msg/Vector3"
_DEFINITIONS: Final = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    _VECTOR: "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/msg/Pose": "Point position\nQuaternion orientation",
    "geometry_msgs/msg/PoseWithCovariance": "Pose pose\nfloat64[36] covariance",
    "geometry_msgs/msg/Twist": "Vector3 linear\nVector3 angular",
    "geometry_msgs/msg/Transform": "Vector3 translation\nQuaternion rotation",
    "geometry_msgs/msg/TransformStamped": "std_msgs/Header header\nstring child_frame_id\nTransform transform",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "std_msgs/Header header\nPoseWithCovariance pose",
    "geometry_msgs/msg/TwistStamped": "std_msgs/Header header\nTwist twist",
    "sensor_msgs/msg/Imu": "std_msgs/Header header\n"
    "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance",
    "sensor_msgs/msg/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
    "float64[] effort",
    "sensor_msgs/msg/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/msg/TimeReference": "std_msgs/Header header\nbuiltin_interfaces/Time time_ref\nstring source",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
    "diagnostic_msgs/msg/DiagnosticStatus": "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
    "byte level\nstring name\nstring message\nstring hardware_id\nKeyValue[] values",
    "diagnostic_msgs/msg/DiagnosticArray": "std_msgs/Header header\nDiagnosticStatus[] status",
}
"""Type -> its definition, as in the common interfaces of ROS 2."""
_CYCLE: Final = "hil_msgs/msg/Cycle"
_NUMBERS: Final = {"f8": "float64", "i8": "int64"}


def _definition_of(fields: Fields) -> str:
    """Return the definition of a message with the fields of a record, in lower case, as ROS 2 requires.

    A nested message has the name of its field.
    """
    lines = []
    for field in fields:
        kind = _NUMBERS[field.type] if isinstance(field.type, str) else f"hil_msgs/{field.name.capitalize()}"
        size = math.prod(np.atleast_1d(field.shape)) if field.shape != () else 0
        lines.append(f"{kind}[{int(size)}] {field.name.lower()}" if size else f"{kind} {field.name.lower()}")
    return "\n".join(lines)


_DEFINITIONS[_CYCLE] = _definition_of(CYCLE_FIELDS)
for _field in CYCLE_FIELDS:
    if not isinstance(_field.type, str):
        _DEFINITIONS[f"hil_msgs/msg/{_field.name.capitalize()}"] = _definition_of(_field.type)
_POSE: Final = "geometry_msgs/msg/PoseWithCovarianceStamped"
_TWIST: Final = "geometry_msgs/msg/TwistStamped"
_JOINTS: Final = "sensor_msgs/msg/JointState"
_IMAGE: Final = "sensor_msgs/msg/CompressedImage"
TOPICS: Final = {
    "/cycle": _CYCLE,
    "/truth/pose": _POSE,
    "/truth/twist": _TWIST,
    "/navigation/pose": _POSE,
    "/navigation/twist": _TWIST,
    "/vision/pose": _POSE,
    "/imu": "sensor_msgs/msg/Imu",
    "/joint_states": _JOINTS,
    "/joint_setpoints": _JOINTS,
    "/thrusters": _JOINTS,
    "/tf": "tf2_msgs/msg/TFMessage",
    "/time_of_run": "sensor_msgs/msg/TimeReference",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    f"/{LEFT}/image/compressed": _IMAGE,
    f"/{RIGHT}/image/compressed": _IMAGE,
}
"""Topic -> type; those of further sensors and held axes, ``/sensors/NAME``, ``/held_axes/NAME``, are JointState."""
_AXES: Final = (*RAIL_NAMES, *GIMBAL_NAMES)
_LEVELS: Final = {"alarm": 2, "fault": 2, "order": 1}
_HILL, _CHASER = "H", "chaser"
_NO_COVARIANCE: Final = np.zeros((3, 3))
_NONE: Final = _NO_COVARIANCE.ravel()
_NO_ORIENTATION: Final = np.array([-1.0] + [0.0] * 8)
_METADATA_VERSION: Final = 5
_Message = tuple[str, int, bytes]
"""Topic, stamp in ns, encoded message."""


_FORMS: Final = {"int32": "i", "uint32": "I", "byte": "B", "uint8": "B", "float64": "d"}
"""Number of ROS 2 -> its form in ``struct``."""


@cache
def _fields(kind: str) -> tuple[tuple[str, int | None], ...]:
    """Return type and length of each field of ``kind``: None for a single value, 0 for a sequence of any length."""
    fields: list[tuple[str, int | None]] = []
    for line in _DEFINITIONS[kind].splitlines():
        name, bracket, length = line.split()[0].partition("[")
        if "=" not in line:  # of a constant
            fields.append((_full_name(kind, name), int(length.rstrip("]") or 0) if bracket else None))
    return tuple(fields)


def _full_name(kind: str, name: str) -> str:
    """Return the name of a type as a definition of ``kind`` has it, in full if it is no number or text."""
    full = name.replace("/", "/msg/") if "/" in name else f"{kind.split('/')[0]}/msg/{name}"
    return full if full in _DEFINITIONS else name


@cache
def _is_numbers(kind: str) -> bool:
    """Return whether ``kind`` consists of numbers of type float64."""
    return kind in _DEFINITIONS and all(field == ("float64", None) for field in _fields(kind))


def type_of(topic: str) -> str:
    """Return the type of the messages of ``topic``."""
    return _JOINTS if topic.startswith(("/sensors/", "/held_axes/")) else TOPICS[topic]


_ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""Begin of a message: CDR, little-endian."""


class _Cdr:
    """A message in the making. Alignment counts from behind the four bytes of the encapsulation."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def put(self, kind: str, value: Any) -> None:
        """Append ``value`` of the type ``kind``; that of a message has the values of its fields, in their order."""
        if kind == "string":
            encoded = value.encode() + b"\0"
            self.put("uint32", len(encoded))
            self._bytes += encoded
        elif kind in _FORMS:
            form = _FORMS[kind]
            self._bytes += bytes(-len(self._bytes) % struct.calcsize(form)) + struct.pack(f"<{form}", value)
        elif _is_numbers(kind):
            self._put_numbers(value)
        else:
            for (field, length), inner in zip(_fields(kind), value, strict=True):
                self._put_all(field, length, inner)

    def message(self) -> bytes:
        return _ENCAPSULATION + bytes(self._bytes)

    def _put_all(self, kind: str, length: int | None, value: Any) -> None:
        if length is None:
            self.put(kind, value)
            return
        if length == 0:
            self.put("uint32", len(value))
        if kind == "uint8":
            self._bytes += value
        elif kind == "float64":
            self._put_numbers(value)
        else:
            for each in value:
                self.put(kind, each)

    def _put_numbers(self, values: Any) -> None:
        if len(values):
            self._bytes += bytes(-len(self._bytes) % 8) + np.ascontiguousarray(values, "<f8").tobytes()


def encoded(kind: str, value: Any) -> bytes:
    """Return a message of type ``kind``, in CDR; value: the values of its fields, in their order."""
    cdr = _Cdr()
    cdr.put(kind, value)
    return cdr.message()


def export_ros2(path: Path, out: Path) -> dict[str, int]:
    """Write the recording at ``path`` as a bag in the new folder ``out``; return the number of messages per topic.

    Raises BadInput, and leaves nothing behind then.
    """
    if out.exists():
        raise BadInput.single("--out", "", f"{out} exists: give the name of a new folder")
    recorded = load(path)
    part = out.with_name(f"{out.name}.part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        counts = _write_bag(recorded, part, f"{out.name}_0.mcap")
        os.replace(part, out)
    except OSError as error:
        raise BadInput.single("--out", "", f"{out}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return counts


def _write_bag(recorded: Recorded, folder: Path, name: str) -> dict[str, int]:
    counts: Counter[str] = Counter()
    first_ns = last_ns = start_ns(recorded)
    with (folder / name).open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="hil")
        channels: dict[str, int] = {}
        schemas: dict[str, int] = {}
        for topic, time_ns, data in _messages(recorded):
            if topic not in channels:
                kind = type_of(topic)
                if kind not in schemas:
                    schemas[kind] = writer.register_schema(kind, "ros2msg", definition(kind).encode())
                channels[topic] = writer.register_channel(topic, "cdr", schemas[kind], {"offered_qos_profiles": ""})
            writer.add_message(channels[topic], time_ns, data, time_ns)
            counts[topic] += 1
            first_ns, last_ns = min(first_ns, time_ns), max(last_ns, time_ns)
        writer.finish()
    (folder / "metadata.yaml").write_text(_metadata(counts, name, first_ns, last_ns - first_ns), encoding="utf-8")
    return dict(counts)


def start_ns(recorded: Recorded) -> int:
    """Return the wall clock at the start of the run, ns since 1970."""
    moment = datetime.fromisoformat(recorded.run["started_utc"])
    return round(moment.replace(microsecond=0, tzinfo=UTC).timestamp()) * 1_000_000_000 + moment.microsecond * 1_000


def _messages(recorded: Recorded) -> Iterator[_Message]:
    """Yield all messages: those of the cycles in the order of time, then further sensors, log and images."""
    for topic, time_ns, value in _values(recorded):
        yield topic, time_ns, value if isinstance(value, bytes) else encoded(type_of(topic), value)


def _values(recorded: Recorded) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, stamp and value of all messages; the value of a whole cycle is its message."""
    zero_ns, n = start_ns(recorded), len(recorded.scenario.chaser.thrusters.position_m)
    for row in recorded.cycles:
        time_ns = _stamp(float(row["t_s"]), zero_ns)
        yield "/cycle", time_ns, _ENCAPSULATION + row.tobytes()  # numbers of 8 bytes: CDR aligns them as the record
        for topic, value in _cycle(row, time_ns, zero_ns, n):
            yield topic, time_ns, value
    yield from _samples(recorded, zero_ns)
    yield from _held_axes(recorded, zero_ns)
    for line in recorded.log:
        time_ns = _stamp(line.get("t_s"), zero_ns)
        values = [(key, _text(line.get(key))) for key in ("kind", "t_s", "bench_s", "cycle")]
        level = _LEVELS.get(str(line.get("kind")), 0)
        status = (level, str(line.get("name", "")), str(line.get("message", "")), "", values)
        yield "/diagnostics", time_ns, (_header(time_ns, ""), [status])
    for image in recorded_images(recorded.path, LEFT, RIGHT):
        time_ns = _stamp(image.t_s, zero_ns)
        yield f"/{image.camera}/image/compressed", time_ns, (_header(time_ns, image.camera), image.encoding, image.data)


def _samples(recorded: Recorded, zero_ns: int) -> Iterator[tuple[str, int, Any]]:
    """Yield the measurements of further sensors at their times: components as positions, their sigmas as efforts."""
    if not len(recorded.sensor_arrivals):
        return
    sensors = list(json.loads(recorded.files[schema.SENSORS_FILE]).items())
    for sample in recorded.sensor_arrivals["sample"]:
        name, declared = sensors[int(sample["sensor"])]
        names, time_ns = [each["name"] for each in declared["components"]], _stamp(float(sample["t_s"]), zero_ns)
        n = len(names)
        sigmas = np.sqrt(np.diagonal(sample["covariance"])[:n])
        yield f"/sensors/{name}", time_ns, (_header(time_ns, name), names, sample["value"][:n], (), sigmas)


def _held_axes(recorded: Recorded, zero_ns: int) -> Iterator[tuple[str, int, Any]]:
    """Yield the encoder values of the axes that are held, by groups, at the times of the cycles."""
    groups = list(json.loads(recorded.files.get(schema.HELD_FILE, "{}")).items())
    for sample in recorded.held_samples:
        name, group = groups[int(sample["group"])]
        n, time_ns = len(group["axes"]), _stamp(float(sample["t_s"]), zero_ns)
        values = sample["position"][:n], sample["rate"][:n]
        yield f"/held_axes/{name}", time_ns, (_header(time_ns, ""), group["axes"], *values, ())


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _time(time_ns: int) -> tuple[int, int]:
    return divmod(time_ns, 1_000_000_000)


def _header(time_ns: int, frame: str) -> tuple[tuple[int, int], str]:
    return _time(time_ns), frame


def _stamp(t_s: float | None, zero_ns: int) -> int:
    """Return the stamp of ``t_s`` of the run; times before the run, or without one, become its start."""
    return zero_ns + (round(t_s * 1e9) if t_s is not None and t_s > 0.0 else 0)


def _cycle(row: np.void, time_ns: int, zero_ns: int, thrusters: int) -> Iterator[tuple[str, Any]]:
    """Yield topic and value of the messages of one row (CYCLE). thrusters: of the vehicle."""
    truth, estimate, pose, imu = row["truth"], row["navigation"], row["pose"], row["imu"]
    r, q = truth["r_CT_H"], truth["q_CH"]
    here, unnamed = _header(time_ns, _HILL), _header(time_ns, "")
    yield "/truth/pose", (here, ((r, q), _covariance(_NO_COVARIANCE, _NO_COVARIANCE)))
    yield "/truth/twist", (here, (truth["v_CT_H"], in_hill(truth["w_CI_C"], q)))
    if estimate["valid"]:
        sigma_r, sigma_q = np.diag(estimate["sigma_r_m"] ** 2), np.diag(estimate["sigma_attitude_rad"] ** 2)
        q_estimate = estimate["q_CH"]
        yield "/navigation/pose", (here, ((estimate["r_CT_H"], q_estimate), _covariance(sigma_r, sigma_q)))
        yield "/navigation/twist", (here, (estimate["v_CT_H"], in_hill(estimate["w_CH_C"], q_estimate)))
    if pose["fresh"] > 0:
        seen = _header(_stamp(float(pose["t_s"]), zero_ns), _CHASER)
        target = pose["q_CH"] * (-1.0, -1.0, -1.0, 1.0)  # of the target in c
        covariance = _covariance(pose["covariance_position"], pose["covariance_attitude"])
        yield "/vision/pose", (seen, ((pose["z_TC_C"], target), covariance))
    turn = ((0.0, 0.0, 0.0, 1.0), _NO_ORIENTATION)
    yield "/imu", (_header(time_ns, _CHASER), *turn, imu["rate_C"], _NONE, imu["force_C"], _NONE)
    for topic, name in (("/joint_states", "feedback"), ("/joint_setpoints", "setpoint")):
        axes = row[name]
        positions, rates = (np.concatenate([axes[a], axes[b]]) for a, b in _AXIS_FIELDS)
        yield topic, (unnamed, _AXES, positions, rates, ())
    names = [f"thruster_{number}" for number in range(1, thrusters + 1)]
    on = row["command"]["on"][:thrusters].astype(float)
    yield "/thrusters", (unnamed, names, truth["thrust_fraction"][:thrusters], (), on)
    yield "/tf", ([(here, _CHASER, (r, q))],)
    yield "/time_of_run", (unnamed, _time(round(float(row["t_s"]) * 1e9)), "time of the run")


_AXIS_FIELDS: Final = (("rail_m", "gimbal_rad"), ("rail_mps", "gimbal_radps"))


def _covariance(position: Any, attitude: Any) -> Any:
    """Return the covariance (36,) of a pose from its parts', (3, 3); the cross-covariances are zero."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = position, attitude
    return covariance.ravel()


def in_hill(vector_C: Any, q_CH: Any) -> Any:
    """Return a vector in c, (3,), as components in H."""
    u, s = q_CH[:3], q_CH[3]
    return vector_C + 2.0 * np.cross(u, np.cross(u, vector_C) + s * vector_C)


def definition(kind: str) -> str:
    """Return the definition of ``kind`` and of all types that it contains."""
    pending, names = [kind], []
    while pending:
        name = pending.pop(0)
        if name in names:
            continue
        names.append(name)
        pending += [inner for inner, _ in _fields(name) if inner in _DEFINITIONS]
    separator = "\n" + "=" * 80 + "\n"
    parts = [_DEFINITIONS[name] for name in names[:1]]
    parts += [f"MSG: {name.replace('/msg/', '/')}\n{_DEFINITIONS[name]}" for name in names[1:]]
    return separator.join(parts)


def _metadata(counts: dict[str, int], name: str, first_ns: int, length_ns: int) -> str:
    """Return ``metadata.yaml``; JSON is YAML."""
    topics = [
        {
            "topic_metadata": {
                "name": topic,
                "type": type_of(topic),
                "serialization_format": "cdr",
                "offered_qos_profiles": "",
            },
            "message_count": count,
        }
        for topic, count in counts.items()
    ]
    start, length = {"nanoseconds_since_epoch": first_ns}, {"nanoseconds": length_ns}
    total = sum(counts.values())
    content = {
        "version": _METADATA_VERSION,
        "storage_identifier": "mcap",
        "relative_file_paths": [name],
        "duration": length,
        "starting_time": start,
        "message_count": total,
        "compression_format": "",
        "compression_mode": "",
        "topics_with_message_count": topics,
        "files": [{"path": name, "starting_time": start, "duration": length, "message_count": total}],
    }
    return json.dumps({"rosbag2_bagfile_information": content}, indent=1) + "\n"
