"""NatNet 3.0 to 4.x, as OptiTrack Motive streams it: bytes -> numbers, and the bytes that a client sends.

Sections of a frame: sets of markers, unlabelled markers, rigid bodies, and others that are not read. From 4.1 on the
size of each section follows its count. The last fields are the times of the frame by the server's clock.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from hil.parts.tracker.frames import BodyPose, TrackedFrame

CONNECT, SERVER_INFO, MODEL_REQUEST, MODEL, FRAME, KEEP_ALIVE = 0, 1, 4, 5, 7, 10
ECHO_REQUEST, ECHO, UNRECOGNISED = 12, 13, 100
HEAD: Final = struct.Struct("<HH")
BODY: Final = struct.Struct("<i3f4ffh")
"""Streaming ID, position, quaternion (scalar last) from the body to the capture, mean error of the markers, state."""
TIMES: Final = struct.Struct("<QQQ")
"""Ticks of the middle of the exposure, of the images' arrival and of the sending."""
SIZED: Final = 4, 1
"""First version with sizes of the sections."""
_INFO: Final = struct.Struct("<256s4B4B")
_STREAM: Final = struct.Struct("<QH?4B")  # ticks per second, port of the frames, multicast or not, its group
_LEAST_INFO: Final = HEAD.size + _INFO.size + _STREAM.size
_COUNT: Final = struct.Struct("<i")
_TRACKED: Final = 1
_END: Final = 30  # bytes from the times to the end of a frame; 8 more if the sections have sizes


class NatNetInfo(NamedTuple):
    """What a server states about its stream. group: of the multicast, "" for unicast."""

    version: tuple[int, int]
    ticks_hz: float
    port: int
    group: str


def connect_request() -> bytes:
    """Return the request of a client for a stream of at most 4.1."""
    return HEAD.pack(CONNECT, _INFO.size) + _INFO.pack(b"Ping", 4, 1, 0, 0, 4, 1, 0, 0)


def keep_alive() -> bytes:
    """Return the message by which a client of a unicast stream stays connected."""
    return HEAD.pack(KEEP_ALIVE, 0)


def is_frame(message: bytes) -> bool:
    """Return whether ``message`` is a frame."""
    return message[:2] == FRAME.to_bytes(2, "little")


def is_server_info(message: bytes) -> bool:
    """Return whether ``message`` is the response to a request to connect."""
    return message[:2] == SERVER_INFO.to_bytes(2, "little")


def server_of(message: bytes) -> NatNetInfo:
    """Return what the response to a request to connect states. Raises ValueError."""
    if not is_server_info(message) or len(message) < _LEAST_INFO:
        raise ValueError("no response of a NatNet server of version 3.0 or later")
    *_, major, minor, _, _ = _INFO.unpack_from(message, HEAD.size)
    ticks_hz, port, is_multicast, *group = _STREAM.unpack_from(message, HEAD.size + _INFO.size)
    if major < 3 or not ticks_hz:
        raise ValueError(f"NatNet {major}.{minor}: allowed are 3.0 to 4.x")
    return NatNetInfo((major, minor), float(ticks_hz), port, socket.inet_ntoa(bytes(group)) if is_multicast else "")


def server_info(server: NatNetInfo) -> bytes:
    """Return the response of a server."""
    group = socket.inet_aton(server.group or "0.0.0.0")
    info = _INFO.pack(b"hil", *server.version, 0, 0, *server.version, 0, 0)
    info += _STREAM.pack(int(server.ticks_hz), server.port, bool(server.group), *group)
    return HEAD.pack(SERVER_INFO, len(info)) + info


def bodies_of(message: bytes, version: tuple[int, int]) -> dict[int | str, BodyPose]:
    """Return the rigid bodies of a frame that are tracked, by their streaming IDs. Raises ValueError, struct.error."""
    at, head = 8, 8 if version >= SIZED else 4

    def count() -> int:
        nonlocal at
        (n,) = _COUNT.unpack_from(message, at)
        at += head
        if not 0 <= n <= len(message):
            raise ValueError(f"a section of {n}")
        return int(n)

    for _ in range(count()):  # sets of markers: a name and positions
        at = message.index(b"\0", at) + 1
        at += 4 + 12 * _COUNT.unpack_from(message, at)[0]
    unlabelled = count()
    at += 12 * unlabelled
    tracked: dict[int | str, BodyPose] = {}
    for _ in range(count()):
        number, *pose, error_m, state = BODY.unpack_from(message, at)
        at += BODY.size
        if state & _TRACKED:
            tracked[number] = BodyPose(np.array(pose[:3]), np.array(pose[3:]), error_m)
    return tracked


def frame_of(message: bytes, server: NatNetInfo, received_s: float) -> TrackedFrame:
    """Return a frame, received at bench time ``received_s``. Raises ValueError, struct.error."""
    bodies = bodies_of(message, server.version)
    exposed_s, age_s = times_of(message, server)
    return TrackedFrame(exposed_s, received_s, bodies, age_s)


def times_of(message: bytes, server: NatNetInfo) -> tuple[float, float]:
    """Return the middle of the exposure by the server's clock, and how long it was ago when the frame was sent, s."""
    precise = 8 if server.version >= SIZED else 0  # seconds and their fraction, by another clock
    exposed, _, sent = TIMES.unpack_from(message, len(message) - _END - precise)
    return exposed / server.ticks_hz, (sent - exposed) / server.ticks_hz


def frame_message(
    number: int, bodies: Mapping[int | str, BodyPose], server: NatNetInfo, times_s: tuple[float, float]
) -> bytes:
    """Return the bytes of a frame. times_s: of exposure and sending, by the server's clock."""
    sized = server.version >= SIZED

    def section(n: int, content: bytes = b"") -> bytes:
        return _COUNT.pack(n) + (_COUNT.pack(len(content)) if sized else b"") + content

    rows = b"".join(
        BODY.pack(int(each), *pose.position, *(pose.q if pose.q is not None else (0.0, 0.0, 0.0, 1.0)), pose.error_m, 1)
        for each, pose in bodies.items()
    )
    content = _COUNT.pack(number) + section(0) + section(0) + section(len(bodies), rows) + section(0)
    content += b"".join(section(0) for _ in range(4 if sized else 3))  # assets from 4.1, markers, plates, devices
    ticks = [round(server.ticks_hz * each) for each in (times_s[0], *times_s)]
    content += struct.pack("<IId", 0, 0, times_s[0]) + TIMES.pack(ticks[0], ticks[2], ticks[2])
    content += (bytes(8) if sized else b"") + struct.pack("<hi", 0, 0)
    return HEAD.pack(FRAME, len(content)) + content
