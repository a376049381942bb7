"""Pose frames of the vision unit: bytes <-> numbers.

One frame is 161 bytes, little endian:

====== ===== ============== ====================================================================
offset bytes type           content
====== ===== ============== ====================================================================
0      2     bytes          sync, EB 90
2      1     u8             version (high nibble, 1) and type (low nibble, 1 = pose)
3      1     u8             length of the following bytes up to the CRC, 155
4      4     u32            frame counter, wraps
8      8     u64            bench time of the exposure, microseconds
16     24    3 x float64    t_v, m: ring centre from the left camera, in v
40     32    4 x float64    q_vt, t to v, scalar last, unit length
72     84    21 x float32   upper triangle of the covariance, row by row, of (t_v, small rotation e
                            about v's axes): m^2, m rad, rad^2
156    1     u8             LEDs used in the left image, bit n = LED n
157    1     u8             LEDs used in the right image
158    1     u8             status: 0 good, 1 no pose (offsets 16 to 157 void), else a fault code
159    2     u16            CRC-16/CCITT-FALSE of offsets 2 to 158
====== ===== ============== ====================================================================

An identity frame, 40 bytes, is sent when the unit starts and once per second:

====== ===== ============== ====================================================================
0      2     bytes          sync, EB 90
2      1     u8             version (high nibble, 1) and type (low nibble, 2 = identity)
3      1     u8             length of the following bytes up to the CRC, 34
4      16    ASCII          vendor, filled up with zeros
20     16    ASCII          serial number, filled up with zeros
36     2     2 x u8         firmware, major and minor
38     2     u16            CRC-16/CCITT-FALSE of offsets 2 to 37
====== ===== ============== ====================================================================
"""

from __future__ import annotations

import binascii
import math
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array, PoseFrame

STATUS_GOOD: Final = 0
STATUS_NO_POSE: Final = 1

_BODY: Final = struct.Struct("<IQ3d4d21f3B")
_CRC: Final = struct.Struct("<H")
_SYNC: Final = b"\xeb\x90"
_POSE_VERSION_1: Final = 0x11
_IDENTITY_VERSION_1: Final = 0x12
# Type and length are constant and part of the searched header: a received length is never trusted.
HEADER: Final = _SYNC + bytes([_POSE_VERSION_1, _BODY.size])
FRAME_BYTES: Final = len(HEADER) + _BODY.size + _CRC.size
_IDENTITY_BODY: Final = struct.Struct("<16s16sBB")
IDENTITY_HEADER: Final = _SYNC + bytes([_IDENTITY_VERSION_1, _IDENTITY_BODY.size])
IDENTITY_BYTES: Final = len(IDENTITY_HEADER) + _IDENTITY_BODY.size + _CRC.size
_SIZES: Final = {HEADER: FRAME_BYTES, IDENTITY_HEADER: IDENTITY_BYTES}
_TYPES: Final = (_POSE_VERSION_1, _IDENTITY_VERSION_1)

_UPPER: Final = np.triu_indices(6)
_UNIT_TOLERANCE: Final = 1e-6  # a unit that computes in float32 passes
RANGE_MAX_M: Final = 100.0
"""A pose farther from the cameras is none."""
SIGMA_MAX: Final = (10.0, 10.0, 10.0, math.pi, math.pi, math.pi)
"""A pose with a larger standard deviation, m and rad, is none."""
_SIGMA_MIN: Final = 1e-9
_EIGENVALUE_TOLERANCE: Final = 1e-5  # of the correlations: the wire has float32
_VOID: Final = (0.0,) * 28


@dataclass(frozen=True, slots=True)
class Decoded:
    """An intact frame. t_s: exposure, s of bench time; ``pose`` is None unless status is good."""

    counter: int
    t_s: float
    status: int
    pose: PoseFrame | None


@dataclass(frozen=True, slots=True)
class ReportedIdentity:
    """Identity that a unit reports; vendor and serial number up to 16 ASCII characters."""

    vendor: str
    serial: str
    firmware: str
    """Major and minor number, ``1.4``."""


def crc16(data: bytes) -> int:
    """Return CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, not reflected) of ``data``."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode(frame: PoseFrame) -> bytes:
    """Return the bytes of ``frame`` with status good; ``received_s`` is not on the wire."""
    numbers = (*frame.t_v, *frame.q_vt, *frame.covariance[_UPPER])
    return _frame(frame.counter, frame.t_s, numbers, frame.leds_left, frame.leds_right, STATUS_GOOD)


def encode_status(counter: int, t_s: float, status: int) -> bytes:
    """Return the bytes of a frame that carries no pose, only ``status``."""
    return _frame(counter, t_s, _VOID, 0, 0, status)


def encode_identity(identity: ReportedIdentity) -> bytes:
    """Return the bytes of the identity frame."""
    major, minor = (int(part) for part in identity.firmware.split("."))
    frame = IDENTITY_HEADER + _IDENTITY_BODY.pack(identity.vendor.encode(), identity.serial.encode(), major, minor)
    return frame + _CRC.pack(crc16(frame[len(_SYNC) :]))


def _frame(counter: int, t_s: float, numbers: tuple[float, ...], left: int, right: int, status: int) -> bytes:
    frame = HEADER + _BODY.pack(counter, round(t_s * 1e6), *numbers, left, right, status)
    return frame + _CRC.pack(crc16(frame[len(_SYNC) :]))


class PoseDecoder:
    """Decodes frames from a byte stream with arbitrary splits and damage; never raises.

    After a CRC error the search resumes after the sync, so that neither a truncated frame nor a header inside other
    data hides an intact frame.
    """

    def __init__(self) -> None:
        self.crc_errors = 0
        self.skipped_bytes = 0
        self.invalid = 0  # right CRC, impossible content
        self.wrong_length = 0  # sync and a known type, but not the length that this type has
        self.identity: ReportedIdentity | None = None  # the newest
        self._buffer = bytearray()

    def feed(self, data: bytes, received_s: float) -> list[Decoded]:
        """Decode ``data``, whose last byte was received at bench time ``received_s``; return the completed frames."""
        self._buffer += data
        frames = []
        start = self._skip_to_header(0)
        while start + (size := self._size_at(start)) <= len(self._buffer):
            raw = bytes(self._buffer[start : start + size])
            if _CRC.unpack_from(raw, size - _CRC.size)[0] != crc16(raw[len(_SYNC) : -_CRC.size]):
                self.crc_errors += 1
                self.skipped_bytes += len(_SYNC)
                start = self._skip_to_header(start + len(_SYNC))
                continue
            start += size
            if size == IDENTITY_BYTES:
                self.identity = _decode_identity(raw)
            elif (decoded := _decode(raw, received_s)) is None:
                self.invalid += 1
            else:
                frames.append(decoded)
            start = self._skip_to_header(start)
        del self._buffer[:start]
        return frames

    def _size_at(self, start: int) -> int:
        """Return the size of the frame at ``start``; that of a pose frame if its header is incomplete."""
        return _SIZES.get(bytes(self._buffer[start : start + len(HEADER)]), FRAME_BYTES)

    def _skip_to_header(self, start: int) -> int:
        """Return the position of the next header, or of an incomplete one at the end of the buffer."""
        buffer, place = self._buffer, start
        while (place := buffer.find(_SYNC[:1], place)) >= 0:
            head = bytes(buffer[place : place + len(HEADER)])
            if any(header.startswith(head) for header in _SIZES):
                break
            if len(head) == len(HEADER) and head.startswith(_SYNC) and head[2] in _TYPES:
                self.wrong_length += 1
            place += 1
        found = place if place >= 0 else len(buffer)
        self.skipped_bytes += found - start
        return found


def _decode_identity(raw: bytes) -> ReportedIdentity:
    vendor, serial, major, minor = _IDENTITY_BODY.unpack_from(raw, len(IDENTITY_HEADER))
    return ReportedIdentity(_text(vendor), _text(serial), f"{major}.{minor}")


def _text(padded: bytes) -> str:
    return padded.rstrip(b"\0").decode("ascii", "replace")


def _is_covariance(covariance: Array) -> bool:
    """Return whether ``covariance`` (6, 6), finite and symmetric, is one, up to the wire's resolution."""
    variance = covariance.diagonal()
    if not all(_SIGMA_MIN**2 <= variance[i] <= SIGMA_MAX[i] ** 2 for i in range(6)):
        return False
    sigma = np.sqrt(variance)
    return bool(np.linalg.eigvalsh(covariance / np.outer(sigma, sigma))[0] > -_EIGENVALUE_TOLERANCE)


def _decode(raw: bytes, received_s: float) -> Decoded | None:
    """Return the content of a frame with correct CRC, None for an impossible pose with good status."""
    counter, t_us, *numbers, left, right, status = _BODY.unpack_from(raw, len(HEADER))
    t_s = t_us / 1e6
    if status != STATUS_GOOD:
        return Decoded(counter, t_s, status, None)
    t_v, q_vt, upper = numbers[:3], numbers[3:7], numbers[7:]
    if not all(map(math.isfinite, numbers)) or abs(math.hypot(*q_vt) - 1.0) > _UNIT_TOLERANCE:
        return None
    covariance = np.zeros((6, 6))
    covariance[_UPPER] = upper
    covariance.T[_UPPER] = upper
    return checked_pose(PoseFrame(counter, t_s, received_s, np.array(t_v), np.array(q_vt), covariance, left, right))


def checked_pose(pose: PoseFrame) -> Decoded | None:
    """Return ``pose`` as the content of an intact frame, None for an impossible one; its quaternion is a unit one."""
    if not all(np.isfinite(part).all() for part in (pose.t_v, pose.q_vt, pose.covariance)):
        return None
    if not 0.0 < pose.t_v[2] <= RANGE_MAX_M or math.hypot(*pose.t_v) > RANGE_MAX_M:
        return None  # behind the cameras or farther than any bench is long
    if not _is_covariance(pose.covariance):
        return None
    return Decoded(pose.counter, pose.t_s, STATUS_GOOD, pose)
