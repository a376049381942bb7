"""Export of a recording as a bag of ROS 2: an MCAP file with ROS 2 messages, and its ``metadata.yaml``.

Messages are encoded here (OMG CDR, little-endian), from the definitions of the ROS 2 interfaces. Stamps are the
wall clock at the start of the run plus the time of the run; ``/time_of_run`` has the latter.
"""

from __future__ import annotations

import json
import os
import shutil
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.writer import CompressionType, Writer

from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES
from hil.core.camera_images import LEFT, RIGHT
from hil.errors import BadInput
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
_POSE: Final = "geometry_msgs/msg/PoseWithCovarianceStamped"
_TWIST: Final = "geometry_msgs/msg/TwistStamped"
_JOINTS: Final = "sensor_msgs/msg/JointState"
_IMAGE: Final = "sensor_msgs/msg/CompressedImage"
TOPICS: Final = {
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
"""Topic -> type."""
_AXES: Final = (*RAIL_NAMES, *GIMBAL_NAMES)
_LEVELS: Final = {"alarm": 2, "fault": 2, "order": 1}
_HILL, _CHASER = "H", "chaser"
_NO_COVARIANCE: Final = np.zeros((3, 3))
_METADATA_VERSION: Final = 5
_Message = tuple[str, int, bytes]
"""Topic, stamp in ns, encoded message."""


class _Cdr:
    """A message in the making. Alignment counts from behind the four bytes of the encapsulation."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def put(self, form: str, *values: Any) -> None:
        """Append numbers of one type: ``form`` of ``struct``, its last letter for each."""
        size = struct.calcsize(form[-1])
        self._bytes += bytes(-len(self._bytes) % size)
        self._bytes += struct.pack(f"<{form}", *values)

    def put_all(self, values: Any) -> None:
        """Append the elements of an array of float64, whose length the type fixes."""
        self._bytes += bytes(-len(self._bytes) % 8)
        self._bytes += np.ascontiguousarray(values, "<f8").tobytes()

    def put_list(self, values: Any) -> None:
        """Append a sequence of float64."""
        self.put("I", len(values))
        if len(values):
            self.put_all(values)

    def put_text(self, text: str) -> None:
        encoded = text.encode() + b"\0"
        self.put("I", len(encoded))
        self._bytes += encoded

    def put_block(self, block: bytes) -> None:
        self.put("I", len(block))
        self._bytes += block

    def put_time(self, time_ns: int) -> None:
        self.put("i", time_ns // 1_000_000_000)
        self.put("I", time_ns % 1_000_000_000)

    def put_header(self, time_ns: int, frame: str) -> None:
        self.put_time(time_ns)
        self.put_text(frame)

    def message(self) -> bytes:
        return b"\x00\x01\x00\x00" + bytes(self._bytes)


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
                kind = TOPICS[topic]
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
    """Yield all messages: those of the cycles in the order of time, then the log and the images."""
    zero_ns = start_ns(recorded)
    for row in recorded.cycles:
        yield from _cycle(row, zero_ns)
    for line in recorded.log:
        time_ns = _stamp(line.get("t_s"), zero_ns)
        yield "/diagnostics", time_ns, _diagnostics(line, time_ns)
    for image in recorded_images(recorded.path, LEFT, RIGHT):
        time_ns = _stamp(image.t_s, zero_ns)
        cdr = _Cdr()
        cdr.put_header(time_ns, image.camera)
        cdr.put_text(image.encoding)
        cdr.put_block(image.data)
        yield f"/{image.camera}/image/compressed", time_ns, cdr.message()


def _stamp(t_s: float | None, zero_ns: int) -> int:
    """Return the stamp of ``t_s`` of the run; times before the run, or without one, become its start."""
    return zero_ns + (round(t_s * 1e9) if t_s is not None and t_s > 0.0 else 0)


def _cycle(row: np.void, zero_ns: int) -> Iterator[_Message]:
    """Yield the messages of one row (CYCLE)."""
    t_s = float(row["t_s"])
    time_ns = _stamp(t_s, zero_ns)
    truth, estimate, pose = row["truth"], row["navigation"], row["pose"]
    r, q = truth["r_CT_H"], truth["q_CH"]
    yield "/truth/pose", time_ns, _pose(time_ns, _HILL, r, q, _NO_COVARIANCE, _NO_COVARIANCE)
    yield "/truth/twist", time_ns, _twist(time_ns, truth["v_CT_H"], truth["w_CI_C"], q)
    if estimate["valid"]:
        sigma_r, sigma_q = np.diag(estimate["sigma_r_m"] ** 2), np.diag(estimate["sigma_attitude_rad"] ** 2)
        q_estimate = estimate["q_CH"]
        yield "/navigation/pose", time_ns, _pose(time_ns, _HILL, estimate["r_CT_H"], q_estimate, sigma_r, sigma_q)
        yield "/navigation/twist", time_ns, _twist(time_ns, estimate["v_CT_H"], estimate["w_CH_C"], q_estimate)
    if pose["fresh"] > 0:
        seen_ns = _stamp(float(pose["t_s"]), zero_ns)
        target = pose["q_CH"] * (-1.0, -1.0, -1.0, 1.0)  # of the target in c
        covariances = pose["covariance_position"], pose["covariance_attitude"]
        yield "/vision/pose", time_ns, _pose(seen_ns, _CHASER, pose["z_TC_C"], target, *covariances)
    yield "/imu", time_ns, _imu(row["imu"], time_ns)
    for topic, name in (("/joint_states", "feedback"), ("/joint_setpoints", "setpoint")):
        axes = row[name]
        positions, rates = (np.concatenate([axes[a], axes[b]]) for a, b in _AXIS_FIELDS)
        yield topic, time_ns, _joints(time_ns, _AXES, positions, rates, ())
    on = row["command"]["on"]
    names = [f"thruster_{i + 1}" for i in range(len(on))]
    yield "/thrusters", time_ns, _joints(time_ns, names, truth["thrust_fraction"], (), on.astype(float))
    yield "/tf", time_ns, _transform(time_ns, r, q)
    cdr = _Cdr()
    cdr.put_header(time_ns, "")
    cdr.put_time(round(t_s * 1e9))
    cdr.put_text("time of the run")
    yield "/time_of_run", time_ns, cdr.message()


_AXIS_FIELDS: Final = (("rail_m", "gimbal_rad"), ("rail_mps", "gimbal_radps"))


def _pose(time_ns: int, frame: str, r: Any, q: Any, position: Any, attitude: Any) -> bytes:
    """Return a pose. position, attitude: covariances, (3, 3); those between both are left at zero."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = position, attitude
    cdr = _Cdr()
    cdr.put_header(time_ns, frame)
    cdr.put_all(r)
    cdr.put_all(q)
    cdr.put_all(covariance)
    return cdr.message()


def _twist(time_ns: int, v_H: Any, w_C: Any, q_CH: Any) -> bytes:
    """Return velocity and rate, both in H."""
    cdr = _Cdr()
    cdr.put_header(time_ns, _HILL)
    cdr.put_all(v_H)
    cdr.put_all(in_hill(w_C, q_CH))
    return cdr.message()


def in_hill(vector_C: Any, q_CH: Any) -> Any:
    """Return a vector in c, (3,), as components in H."""
    u, s = q_CH[:3], q_CH[3]
    return vector_C + 2.0 * np.cross(u, np.cross(u, vector_C) + s * vector_C)


def _imu(imu: np.void, time_ns: int) -> bytes:
    unknown = np.zeros(9)
    unknown[0] = -1.0  # no orientation
    cdr = _Cdr()
    cdr.put_header(time_ns, _CHASER)
    cdr.put_all((0.0, 0.0, 0.0, 1.0))
    for values in (unknown, imu["rate_C"], _NO_COVARIANCE, imu["force_C"], _NO_COVARIANCE):
        cdr.put_all(values)
    return cdr.message()


def _joints(time_ns: int, names: Sequence[str], positions: Any, rates: Any, efforts: Any) -> bytes:
    cdr = _Cdr()
    cdr.put_header(time_ns, "")
    cdr.put("I", len(names))
    for name in names:
        cdr.put_text(name)
    for values in (positions, rates, efforts):
        cdr.put_list(values)
    return cdr.message()


def _transform(time_ns: int, r: Any, q: Any) -> bytes:
    cdr = _Cdr()
    cdr.put("I", 1)
    cdr.put_header(time_ns, _HILL)
    cdr.put_text(_CHASER)
    cdr.put_all(r)
    cdr.put_all(q)
    return cdr.message()


def _diagnostics(line: dict[str, Any], time_ns: int) -> bytes:
    """Return an entry of the log. Its values: kind, time of the run, bench time, cycle."""
    values = {key: line.get(key) for key in ("kind", "t_s", "bench_s", "cycle")}
    cdr = _Cdr()
    cdr.put_header(time_ns, "")
    cdr.put("I", 1)
    cdr.put("B", _LEVELS.get(str(line.get("kind")), 0))
    cdr.put_text(str(line.get("name", "")))
    cdr.put_text(str(line.get("message", "")))
    cdr.put_text("")
    cdr.put("I", len(values))
    for key, value in values.items():
        cdr.put_text(key)
        cdr.put_text("" if value is None else str(value))
    return cdr.message()


def definition(kind: str) -> str:
    """Return the definition of ``kind`` with those of all types that it contains."""
    pending, found = [kind], []
    while pending:
        name = pending.pop(0)
        if name in found:
            continue
        found.append(name)
        package = name.split("/")[0]
        for line in _DEFINITIONS[name].splitlines():
            inner = line.split()[0].partition("[")[0]
            full = inner.replace("/", "/msg/") if "/" in inner else f"{package}/msg/{inner}"
            if full in _DEFINITIONS:
                pending.append(full)
    separator = "\n" + "=" * 80 + "\n"
    parts = [_DEFINITIONS[name] for name in found[:1]]
    parts += [f"MSG: {name.replace('/msg/', '/')}\n{_DEFINITIONS[name]}" for name in found[1:]]
    return separator.join(parts)


def _metadata(counts: dict[str, int], name: str, first_ns: int, length_ns: int) -> str:
    """Return ``metadata.yaml``; JSON is YAML."""
    topics = [
        {
            "topic_metadata": {
                "name": topic,
                "type": TOPICS[topic],
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
