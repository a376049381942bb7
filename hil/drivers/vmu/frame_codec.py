"""Pose frames of a vision unit by a frame file: bytes <-> numbers."""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Callable
from typing import Final, Protocol

import numpy as np

from hil.config.load import load_frame
from hil.config.vmu_frame import BUILT_IN, VmuFrame
from hil.core.messages import Array, PoseFrame
from hil.drivers.vmu import codec
from hil.drivers.vmu.codec import STATUS_GOOD, STATUS_NO_POSE, Decoded, ReportedIdentity, checked_pose
from hil.maths import quat

_TYPES: Final = ("u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64")
_STRUCT: Final = dict(zip(_TYPES, "BbHhIiQqfd", strict=True))
_UPPER: Final = np.triu_indices(6)
_COUNTER_BITS: Final = 32
_QUATERNION_TOLERANCE: Final = 1e-3  # scaled integers of 16 bits


def _modbus(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


def _xor(data: bytes) -> int:
    result = 0
    for byte in data:
        result ^= byte
    return result


_CHECKSUMS: Final[dict[str, tuple[str, Callable[[bytes], int]]]] = {
    "none": ("", lambda data: 0),
    "crc16-ccitt-false": ("H", codec.crc16),
    "crc16-xmodem": ("H", lambda data: binascii.crc_hqx(data, 0)),
    "crc16-modbus": ("H", _modbus),
    "crc32": ("I", binascii.crc32),
    "sum8": ("B", lambda data: sum(data) & 0xFF),
    "xor8": ("B", _xor),
}


class FrameDecoder(Protocol):
    """Decoder of a byte stream; see ``codec.PoseDecoder``."""

    crc_errors: int
    skipped_bytes: int
    invalid: int
    wrong_length: int
    identity: ReportedIdentity | None

    def feed(self, data: bytes, received_s: float) -> list[Decoded]: ...


class FrameCodec:
    """Frames of a frame file: encoder, and maker of decoders."""

    def __init__(self, frame: VmuFrame) -> None:
        self.frame = frame
        self.sync = bytes.fromhex(frame.sync)
        self._order = "<" if frame.byte_order == "little" else ">"
        self.body = struct.Struct(self._order + "".join(field.count * _STRUCT[field.type] for field in frame.fields))
        letter, self._sum = _CHECKSUMS[frame.checksum.kind]
        self._checksum = struct.Struct(self._order + letter)
        self.size = len(self.sync) + self.body.size + self._checksum.size

    def encode(self, pose: PoseFrame) -> bytes:
        """Return the bytes of ``pose``; numbers beyond a field's range are limited to it."""
        sigma = np.sqrt(pose.covariance.diagonal())
        rotation = quat.to_matrix(np.asarray(pose.q_vt, dtype=float))  # p_v = A(q_vt) p_t
        if self.frame.rotation == "v_to_t":
            rotation = rotation.T
        q = quat.from_matrix(np.ascontiguousarray(rotation.T))  # A(q) is passive, the frame's quaternion active
        values: dict[str, object] = {
            "position": pose.t_v,
            "quaternion": q if self.frame.quaternion_order == "xyzw" else np.roll(q, 1),
            "euler": euler_angles(rotation, self.frame.euler_sequence),
            "covariance": pose.covariance[_UPPER],
            "sigma_position": sigma[:3],
            "sigma_angle": sigma[3:],
            "leds_left": pose.leds_left,
            "leds_right": pose.leds_right,
        }
        return self._pack(pose.counter, pose.t_s, values, self.frame.status.good)

    def encode_status(self, counter: int, t_s: float, status: int) -> bytes:
        """Return the bytes of a frame without pose; a frame without a field for the status is empty."""
        if "status" not in [field.name for field in self.frame.fields]:
            return b""
        return self._pack(counter, t_s, {}, self.frame.status.no_pose if status == STATUS_NO_POSE else status)

    def _pack(self, counter: int, t_s: float, values: dict[str, object], status: int) -> bytes:
        values = {"counter": counter, "time": t_s, "status": status} | values
        numbers: list[float] = []
        for field in self.frame.fields:
            given = field.value if field.name == "constant" else values.get(field.name, 0)
            wraps = field.name in ("counter", "time")
            each = np.broadcast_to(np.asarray(given, dtype=float), field.count) / field.scale
            numbers += [_on_wire(float(value), field.type, wraps) for value in each]
        data = self.sync + self.body.pack(*numbers)
        return data + self._checksum_of(data)

    def _checksum_of(self, data: bytes) -> bytes:
        if self.frame.checksum.kind == "none":
            return b""
        covered = data if self.frame.checksum.covers_sync else data[len(self.sync) :]
        return self._checksum.pack(self._sum(covered))

    def is_intact(self, raw: bytes) -> bool:
        """Return whether the checksum of a frame of ``size`` bytes is right."""
        end = len(raw) - self._checksum.size
        return self._checksum_of(raw[:end]) == raw[end:]

    def decoder(self) -> FrameDecoder:
        """Return a new decoder of a byte stream."""
        return FileFrameDecoder(self)


class BuiltInCodec:
    """The frames of ``codec``."""

    size = codec.FRAME_BYTES
    encode = staticmethod(codec.encode)
    encode_status = staticmethod(codec.encode_status)

    def decoder(self) -> FrameDecoder:
        """Return a new decoder of a byte stream."""
        return codec.PoseDecoder()


class FileFrameDecoder:
    """Decodes frames from a byte stream with arbitrary splits and damage; never raises."""

    def __init__(self, frames: FrameCodec) -> None:
        self.crc_errors = 0
        self.skipped_bytes = 0
        self.invalid = 0
        self.wrong_length = 0
        self.identity: ReportedIdentity | None = None
        self._frames = frames
        self._buffer = bytearray()
        self._counter: int | None = None
        self._number = 0

    def feed(self, data: bytes, received_s: float) -> list[Decoded]:
        """Decode ``data``, whose last byte was received at bench time ``received_s``; return the completed frames."""
        self._buffer += data
        frames, sync, size = [], self._frames.sync, self._frames.size
        start = self._skip(0)
        while start + size <= len(self._buffer):
            raw = bytes(self._buffer[start : start + size])
            numbers = self._numbers(raw)
            if numbers is None:
                self.skipped_bytes += len(sync)
                start = self._skip(start + len(sync))
                continue
            decoded = self._decode(numbers, received_s)
            if decoded is None:
                self.invalid += 1
            else:
                frames.append(decoded)
            start = self._skip(start + size)
        del self._buffer[:start]
        return frames

    def _skip(self, start: int) -> int:
        """Return the position of the next sync, or of an incomplete one at the end of the buffer."""
        buffer, sync = self._buffer, self._frames.sync
        place = start
        while (place := buffer.find(sync[:1], place)) >= 0:
            head = bytes(buffer[place : place + len(sync)])
            if sync.startswith(head):
                break
            place += 1
        found = place if place >= 0 else len(buffer)
        self.skipped_bytes += found - start
        return found

    def _numbers(self, raw: bytes) -> dict[str, Array] | None:
        """Return the SI values of each field, None for a frame with another constant or a wrong checksum."""
        frame, k = self._frames.frame, 0
        found: dict[str, Array] = {}
        values = self._frames.body.unpack_from(raw, len(self._frames.sync))
        for field in frame.fields:
            part = values[k : k + field.count]
            k += field.count
            if field.name == "constant" and part[0] != field.value:
                return None
            found[field.name] = np.array(part, dtype=float) * field.scale
        if not self._frames.is_intact(raw):
            self.crc_errors += 1
            return None
        return found

    def _decode(self, values: dict[str, Array], received_s: float) -> Decoded | None:
        frame = self._frames.frame
        counter, t_s = self._counted(int(values["counter"][0])), self._time(float(values["time"][0]), received_s)
        status = int(values["status"][0]) if "status" in values else frame.status.good
        if status == frame.status.no_pose:
            return Decoded(counter, t_s, STATUS_NO_POSE, None)
        if status != frame.status.good:
            return Decoded(counter, t_s, max(status & 0xFF, STATUS_NO_POSE + 1), None)
        rotation = self._rotation(values)
        if rotation is None:
            return None
        leds = [int(values[name][0]) & 0xFF if name in values else 0 for name in ("leds_left", "leds_right")]
        q_vt, covariance = quat.from_matrix(rotation), self._covariance(values)
        return checked_pose(
            PoseFrame(counter, t_s, received_s, values["position"], q_vt, covariance, leds[0], leds[1], STATUS_GOOD)
        )

    def _rotation(self, values: dict[str, Array]) -> Array | None:
        """Return R (3, 3), t to v, None if the numbers are no rotation."""
        frame = self._frames.frame
        if "euler" in values:
            rotation = rotation_of(values["euler"], frame.euler_sequence)
        else:
            q = values["quaternion"] if frame.quaternion_order == "xyzw" else np.roll(values["quaternion"], -1)
            length = float(np.linalg.norm(q))
            if not abs(length - 1.0) <= _QUATERNION_TOLERANCE:
                return None
            rotation = quat.to_matrix(q / length).T  # A(q) is passive
        return rotation if frame.rotation == "t_to_v" else np.ascontiguousarray(rotation.T)

    def _covariance(self, values: dict[str, Array]) -> Array:
        covariance = np.zeros((6, 6))
        if "covariance" in values:
            covariance[_UPPER] = values["covariance"]
            covariance.T[_UPPER] = values["covariance"]
            return covariance
        frame = self._frames.frame
        for name, default, part in (
            ("sigma_position", frame.sigma_position_m, slice(0, 3)),
            ("sigma_angle", math.radians(frame.sigma_angle_deg or 0.0), slice(3, 6)),
        ):
            covariance[part, part] = np.diag(np.square(values[name] if name in values else np.full(3, default)))
        return covariance

    def _counted(self, raw: int) -> int:
        """Return the frame's number of 32 bits, from a counter that wraps at fewer."""
        bits = 8 * struct.calcsize(_STRUCT[next(f.type for f in self._frames.frame.fields if f.name == "counter")])
        if bits >= _COUNTER_BITS:
            return raw & 0xFFFF_FFFF
        if self._counter is None:
            self._number = raw
        else:
            half = 1 << (bits - 1)
            self._number += (raw - self._counter + half) % (1 << bits) - half
        self._counter = raw
        return self._number & 0xFFFF_FFFF

    def _time(self, stamp_s: float, received_s: float) -> float:
        """Return the time of exposure, from a time stamp that may wrap: the one nearest to its reception."""
        field = next(field for field in self._frames.frame.fields if field.name == "time")
        if field.type not in ("u8", "u16", "u32"):
            return stamp_s
        period_s = field.scale * 2.0 ** (8 * struct.calcsize(_STRUCT[field.type]))
        return stamp_s + period_s * round((received_s - stamp_s) / period_s)


def _on_wire(number: float, kind: str, wraps: bool) -> float:
    """Return ``number`` as the type ``kind`` has it: rounded, and wrapped or limited to its range."""
    if kind.startswith("f"):
        return number
    bits = int(kind[1:])
    whole = round(number)
    if wraps and kind.startswith("u"):
        return whole % (1 << bits)
    low, high = (0, (1 << bits) - 1) if kind.startswith("u") else (-(1 << (bits - 1)), (1 << (bits - 1)) - 1)
    return min(max(whole, low), high)


def _elementary(axis: str, angle: float) -> Array:
    """Return the active rotation (3, 3) about the axis x, y or z by ``angle``, rad."""
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    rotation = np.eye(3)
    rotation[i, i] = rotation[j, j] = math.cos(angle)
    rotation[j, i] = math.sin(angle)
    rotation[i, j] = -rotation[j, i]
    return rotation


def rotation_of(angles: Array, sequence: str) -> Array:
    """Return the active rotation (3, 3) of Euler ``angles`` (3,), rad; sequence: as in ``VmuFrame``."""
    a, b, c = (_elementary(axis, float(angle)) for axis, angle in zip(sequence.lower(), angles, strict=True))
    product: Array = a @ b @ c if sequence.isupper() else c @ b @ a
    return product


def euler_angles(rotation: Array, sequence: str) -> Array:
    """Return the Euler angles (3,), rad, of an active rotation (3, 3); sequence: as in ``VmuFrame``."""
    from scipy.spatial.transform import Rotation  # slow to import; emulators and tests only

    found: Array = Rotation.from_matrix(rotation).as_euler(sequence)
    return found


def frame_codec(name: str) -> FrameCodec | BuiltInCodec:
    """Return the codec of the frames ``name``, as in ``VmuLine``. Raises BadInput."""
    return BuiltInCodec() if name == BUILT_IN else FrameCodec(load_frame(name).value)
