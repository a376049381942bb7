"""Binary frames of a vision unit by a frame file: bytes <-> numbers."""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Callable
from typing import Final

import numpy as np

from hil.config.vmu_frame import FrameField, VmuFrame
from hil.core.messages import POSITION_ONLY, UNKNOWN_ATTITUDE_RAD, Array, PoseFrame
from hil.drivers.checksums import crc16_ccitt, crc16_modbus, sum8, xor8
from hil.drivers.vmu.codec import STATUS_GOOD, STATUS_NO_POSE, Decoded, ReportedIdentity, checked_pose
from hil.maths import elementary, linear, quat

_TYPES: Final = ("u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64")
_STRUCT: Final = dict(zip(_TYPES, "BbHhIiQqfd", strict=True))
_UPPER: Final = np.triu_indices(6)
_COUNTER_BITS: Final = 32
_UNIT_TOLERANCE: Final = 1e-6  # tolerance of a quaternion's length: a unit that computes in float32 passes
_INTEGER_TOLERANCE: Final = 1e-3  # tolerance in scaled integers of 16 bits; the quaternion is normalised
_IDENTITY: Final = struct.Struct("16s16sBB")


_CHECKSUMS: Final[dict[str, tuple[str, Callable[[bytes], int]]]] = {
    "none": ("", lambda data: 0),
    "crc16-ccitt-false": ("H", crc16_ccitt),
    "crc16-xmodem": ("H", lambda data: binascii.crc_hqx(data, 0)),
    "crc16-modbus": ("H", crc16_modbus),
    "crc32": ("I", binascii.crc32),
    "sum8": ("B", sum8),
    "xor8": ("B", xor8),
}


class FrameCodec:
    """Encoder of the frames of a frame file."""

    def __init__(self, frame: VmuFrame) -> None:
        self.frame = frame
        self.sync = bytes.fromhex(frame.sync or "")
        self._names = {field.name for field in frame.fields}
        self._order = "<" if frame.byte_order == "little" else ">"
        self.body = struct.Struct(self._order + "".join(field.count * _STRUCT[field.type] for field in frame.fields))
        letter, self._sum = _CHECKSUMS[frame.checksum.kind]
        self._checksum = struct.Struct(self._order + letter)
        self.size = len(self.sync) + self.body.size + self._checksum.size
        self.identity_sync = bytes.fromhex(frame.identity_sync or "")
        self.identity_size = len(self.identity_sync) + _IDENTITY.size + self._checksum.size

    def encode(self, pose: PoseFrame) -> bytes:
        """Return the bytes of ``pose``; numbers beyond a field's range are limited to it.

        A position alone is a frame without pose if the file has no status for it.
        """
        status = self.frame.status.good
        if pose.status == POSITION_ONLY:
            if self.frame.status.position is None:
                return self.encode_status(pose.counter, pose.t_s, STATUS_NO_POSE)
            status = self.frame.status.position
        q = _with_sense(np.asarray(pose.q_vt, dtype=float), self.frame)
        values: dict[str, object] = {
            "position": pose.t_v,
            "quaternion": q if self.frame.quaternion_order == "xyzw" else np.roll(q, 1),
            "covariance": pose.covariance[_UPPER],
            "leds_left": pose.leds_left,
            "leds_right": pose.leds_right,
        }
        if "covariance" not in self._names:
            sigma = np.sqrt(pose.covariance.diagonal())
            values |= {"sigma_position": sigma[:3], "sigma_angle": sigma[3:]}
        if "euler" in self._names:
            values["euler"] = euler_angles(quat.to_matrix(q).T, self.frame.euler_sequence)
        return self._pack(pose.counter, pose.t_s, values, status)

    def encode_rate(self, counter: int, t_s: float, rate: Array) -> bytes:
        """Return the bytes of an IMU's ``rate``, (3,), rad/s, measured at ``t_s``."""
        return self._pack(counter, t_s, {"rate": rate}, self.frame.status.good)

    def encode_status(self, counter: int, t_s: float, status: int) -> bytes:
        """Return the bytes of a frame without pose; a frame without a field for the status is empty."""
        if "status" not in self._names:
            return b""
        return self._pack(counter, t_s, {}, self.frame.status.no_pose if status == STATUS_NO_POSE else status)

    def encode_identity(self, identity: ReportedIdentity) -> bytes:
        """Return the bytes of the identity frame."""
        major, minor = (int(part) for part in identity.firmware.split("."))
        data = self.identity_sync + _IDENTITY.pack(identity.vendor.encode(), identity.serial.encode(), major, minor)
        return data + self._checksum_of(data)

    def _pack(self, counter: int, t_s: float, values: dict[str, object], status: int) -> bytes:
        return self._bytes_of({"counter": counter, "time": t_s, "status": status} | values)

    def _bytes_of(self, values: dict[str, object]) -> bytes:
        """Return the frame with the SI ``values`` of its fields."""
        numbers: list[float] = []
        for field in self.frame.fields:
            wraps = field.name in ("counter", "time", "leds_left", "leds_right")
            numbers += [_on_wire(value, field.type, wraps) for value in raw_numbers(field, values)]
        data = self.sync + self.body.pack(*numbers)
        return data + self._checksum_of(data)

    def _checksum_of(self, data: bytes) -> bytes:
        if self.frame.checksum.kind == "none":
            return b""
        first = self.frame.checksum.from_byte
        if first is None:
            first = 0 if self.frame.checksum.covers_sync else len(self.sync)
        return self._checksum.pack(self._sum(data[first:]))

    def decoder(self, of_datagrams: bool = False, by_camera: bool = True) -> FrameDecoder:
        """Return a decoder of the frames. of_datagrams: each of which has whole frames. by_camera: ``checked_pose``."""
        return FrameDecoder(self, by_camera)

    def is_intact(self, raw: bytes) -> bool:
        """Return whether the checksum of a frame of ``size`` bytes is right."""
        end = len(raw) - self._checksum.size
        return self._checksum_of(raw[:end]) == raw[end:]


class FrameDecoder:
    """Decodes frames from a byte stream with arbitrary splits and damage; never raises.

    After a wrong checksum the search resumes at the next byte, so that neither a truncated frame nor a sync inside
    other data hides an intact frame.
    """

    def __init__(self, frames: FrameCodec, by_camera: bool = True) -> None:
        self._by_camera = by_camera
        self.crc_errors = 0
        self.skipped_bytes = 0
        self.invalid = 0  # right checksum, impossible content
        self.wrong_length = 0  # sync, but for the length at its end
        self.identity: ReportedIdentity | None = None  # the newest
        self._frames = frames
        self._sizes = {frames.sync: frames.size}
        if frames.identity_sync:
            self._sizes[frames.identity_sync] = frames.identity_size
        self._buffer = bytearray()
        self._counter: int | None = None
        self._number = 0

    def counts(self) -> dict[str, int]:
        """Return what was received besides frames, by kind."""
        return {name: getattr(self, name) for name in ("crc_errors", "skipped_bytes", "invalid", "wrong_length")}

    def feed(self, data: bytes, received_s: float) -> list[Decoded]:
        """Decode ``data``, whose last byte was received at bench time ``received_s``; return the completed frames."""
        self._buffer += data
        frames = []
        start = self._skip(0)
        while start + (size := self._size_at(start)) <= len(self._buffer):
            raw = bytes(self._buffer[start : start + size])
            numbers = None
            if self._sizes.get(raw[: len(self._frames.sync)]) == self._frames.size:
                numbers = self._numbers(raw)
            elif self._is_intact(raw):
                self.identity = self._decode_identity(raw)
                start = self._skip(start + size)
                continue
            if numbers is None:
                self.skipped_bytes += 1
                start = self._skip(start + 1)
                continue
            decoded = self._decode(numbers, received_s)
            if decoded is None:
                self.invalid += 1
            else:
                frames.append(decoded)
            start = self._skip(start + size)
        del self._buffer[:start]
        return frames

    def _size_at(self, start: int) -> int:
        """Return the size of the frame at ``start``; of a pose frame if its sync is incomplete."""
        rest = self._buffer[start:]
        return next((size for sync, size in self._sizes.items() if rest.startswith(sync)), self._frames.size)

    def _skip(self, start: int) -> int:
        """Return the position of the next sync, or of an incomplete one at the end of the buffer."""
        buffer, position, first = self._buffer, start, self._frames.sync[:1]
        while (position := buffer.find(first, position)) >= 0:
            heads = [(sync, bytes(buffer[position : position + len(sync)])) for sync in self._sizes]
            if any(sync.startswith(head) for sync, head in heads):
                break
            is_other = any(head[:-1] == sync[:-1] and len(head) == len(sync) for sync, head in heads)
            self.wrong_length += is_other and self._frames.frame.sync_ends_with_length
            position += 1
        end = position if position >= 0 else len(buffer)
        self.skipped_bytes += end - start
        return end

    def _is_intact(self, raw: bytes) -> bool:
        if self._frames.is_intact(raw):
            return True
        self.crc_errors += 1
        return False

    def _decode_identity(self, raw: bytes) -> ReportedIdentity:
        vendor, serial, major, minor = _IDENTITY.unpack_from(raw, len(self._frames.identity_sync))
        return ReportedIdentity(_text(vendor), _text(serial), f"{major}.{minor}")

    def _numbers(self, raw: bytes) -> dict[str, Array] | None:
        """Return the SI values of each field, None for a frame with another constant or a wrong checksum."""
        frame, k = self._frames.frame, 0
        numbers: dict[str, Array] = {}
        values = self._frames.body.unpack_from(raw, len(self._frames.sync))
        with np.errstate(invalid="ignore"):  # a damaged number may be a signalling NaN
            for field in frame.fields:
                part = values[k : k + field.count]
                k += field.count
                if field.name == "constant" and part[0] != field.value:
                    return None
                numbers[field.name] = si_numbers(np.array(part, dtype=float), field)
        return numbers if self._is_intact(raw) else None

    def _decode(self, values: dict[str, Array], received_s: float) -> Decoded | None:
        frame = self._frames.frame
        counter, t_s = self._counted(int(values["counter"][0])), self._time(float(values["time"][0]), received_s)
        status = int(values["status"][0]) if "status" in values else frame.status.good
        if status == frame.status.no_pose:
            return Decoded(counter, t_s, STATUS_NO_POSE, None)
        if status not in (frame.status.good, frame.status.position):
            return Decoded(counter, t_s, max(status & 0xFF, STATUS_NO_POSE + 1), None)
        if (rate := values.get("rate")) is not None:
            return Decoded(counter, t_s, STATUS_GOOD, None, rate) if np.isfinite(rate).all() else None
        q_vt = self._quaternion(values)
        if q_vt is None:
            return None
        leds = [int(values[name][0]) if name in values else 0 for name in ("leds_left", "leds_right")]
        covariance = self._covariance(values)
        is_pose = status == frame.status.good and frame.rotation != "none"
        quality = STATUS_GOOD if is_pose else POSITION_ONLY
        pose = PoseFrame(counter, t_s, received_s, values["position"], q_vt, covariance, leds[0], leds[1], quality)
        return checked_pose(pose, self._by_camera)

    def _quaternion(self, values: dict[str, Array]) -> Array | None:
        """Return q_vt (4,), None if the numbers are no rotation; of a point that of no rotation."""
        frame = self._frames.frame
        if frame.rotation == "none":
            return np.array([0.0, 0.0, 0.0, 1.0])
        if "euler" in values:
            q = quat.from_matrix(np.ascontiguousarray(rotation_of(values["euler"], frame.euler_sequence).T))
        else:
            q = values["quaternion"] if frame.quaternion_order == "xyzw" else np.roll(values["quaternion"], -1)
            is_float = next(field for field in frame.fields if field.name == "quaternion").type.startswith("f")
            length = linear.length(q)
            if not abs(length - 1.0) <= (_UNIT_TOLERANCE if is_float else _INTEGER_TOLERANCE):
                return None
            q = q if is_float else q / length
        return _with_sense(q, frame)

    def _covariance(self, values: dict[str, Array]) -> Array:
        covariance = np.zeros((6, 6))
        if "covariance" in values:
            covariance[_UPPER] = values["covariance"]
            covariance.T[_UPPER] = values["covariance"]
            return covariance
        frame = self._frames.frame
        for name, default, part in (
            ("sigma_position", frame.sigma_position_m, slice(0, 3)),
            ("sigma_angle", math.radians(frame.sigma_angle_deg or 0.0) or UNKNOWN_ATTITUDE_RAD, slice(3, 6)),
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


def _with_sense(q: Array, frame: VmuFrame) -> Array:
    """Return the quaternion of ``frame`` for q_vt, and back: A(q_vt) is passive, the frame's quaternion active."""
    return q if frame.rotation == "v_to_t" else q * (-1.0, -1.0, -1.0, 1.0)


def raw_numbers(field: FrameField, values: dict[str, object]) -> list[float]:
    """Return the numbers on the wire of the SI ``values`` of a field, not yet rounded; 0 for one without."""
    given = field.value if field.name == "constant" else values.get(field.name, 0)
    each = np.broadcast_to(np.asarray(given, dtype=float), field.count)
    raw: list[float] = (each * field.inverse if field.inverse else each / field.scale).tolist()
    return raw


def si_numbers(numbers: Array, field: FrameField) -> Array:
    """Return the SI values of ``numbers`` on the wire; a decimal scale divides, which rounds once."""
    return numbers / field.inverse if field.inverse else numbers * field.scale


def _text(padded: bytes) -> str:
    return padded.rstrip(b"\0").decode("ascii", "replace")


def _elementary(axis: str, angle: float) -> Array:
    """Return the active rotation (3, 3) about the axis x, y or z by ``angle``, rad."""
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    rotation = np.eye(3)
    rotation[i, i] = rotation[j, j] = elementary.cos(angle)
    rotation[j, i] = elementary.sin(angle)
    rotation[i, j] = -rotation[j, i]
    return rotation


def rotation_of(angles: Array, sequence: str) -> Array:
    """Return the active rotation (3, 3) of Euler ``angles`` (3,), rad; sequence: as in ``VmuFrame``."""
    a, b, c = (_elementary(axis, float(angle)) for axis, angle in zip(sequence.lower(), angles, strict=True))
    first, last = (a, c) if sequence.isupper() else (c, a)
    product: Array = linear.product(linear.product(first, b), last)
    return product


def euler_angles(rotation: Array, sequence: str) -> Array:
    """Return the Euler angles (3,), rad, of an active rotation (3, 3); sequence: as in ``VmuFrame``."""
    from scipy.spatial.transform import Rotation  # slow to import; emulators and tests only

    angles: Array = Rotation.from_matrix(rotation).as_euler(sequence)
    return angles
