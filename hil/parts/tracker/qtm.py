"""Real-time protocol of Qualisys Track Manager, 1.2x, little endian: bytes <-> numbers.

Packets are their size, a type and a content. A client sends commands as text; frames come as data packets of one
component, "6D residual": position in mm, rotation matrix by its columns, and the residual of its markers in mm; "6D"
is read as well, which has no residual.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Final
from xml.etree import ElementTree  # of a server in the lab's network, and of a bounded size

import numpy as np

from hil.maths import quat
from hil.parts.tracker.frames import BodyPose, TrackedFrame

ERROR, COMMAND, XML, DATA, NO_MORE_DATA, EVENT = 0, 1, 2, 3, 4, 6
PORT: Final = 22223
VERSION: Final = "1.20"
HEAD: Final = struct.Struct("<II")
_LONGEST: Final = 1 << 20
_FRAME: Final = struct.Struct("<qII")  # time, us, number, components
_COMPONENT: Final = struct.Struct("<II")
_BODIES: Final = struct.Struct("<Ihh")  # number of bodies, drop rate, out-of-sync rate
_SIX_D, _SIX_D_RESIDUAL = 5, 11
_BODY: Final = {_SIX_D: struct.Struct("<3f9f"), _SIX_D_RESIDUAL: struct.Struct("<3f9ff")}
_MM: Final = 1e-3


def packet(kind: int, content: bytes) -> bytes:
    """Return a packet."""
    return HEAD.pack(HEAD.size + len(content), kind) + content


def command(text: str) -> bytes:
    """Return the packet of a command, or of the response to one."""
    return packet(COMMAND, text.encode() + b"\0")


class PacketSplitter:
    """Splits a stream of bytes into packets."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield type and content of each packet that ``data`` completes. Raises OSError for a size that is none."""
        self._buffer += data
        while len(self._buffer) >= HEAD.size:
            size, kind = HEAD.unpack_from(self._buffer)
            if not HEAD.size <= size <= _LONGEST:
                raise ConnectionError(f"a packet of {size} bytes")
            if len(self._buffer) < size:
                return
            content, self._buffer = self._buffer[HEAD.size : size], self._buffer[size:]
            yield kind, content


def names_of(content: bytes) -> list[str]:
    """Return the names of the bodies in their order, of the response to ``GetParameters 6D``. Raises ValueError."""
    text = content.rstrip(b"\0").decode("utf-8", "replace")
    if "<!" in text:
        raise ValueError("parameters with declarations")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"parameters: {error}") from error
    return [(body.findtext("Name") or "").strip() for body in root.iter("Body")]


def parameters(names: Sequence[str]) -> bytes:
    """Return the response to ``getparameters 6d``."""
    bodies = "".join(f"<Body><Name>{name}</Name></Body>" for name in names)
    root = f"QTM_Parameters_Ver_{VERSION}"
    text = f"<{root}><The_6D><Bodies>{len(names)}</Bodies>{bodies}</The_6D></{root}>"
    return packet(XML, text.encode() + b"\0")


def frame_of(content: bytes, names: Sequence[str], received_s: float) -> TrackedFrame:
    """Return a data packet as a frame; bodies that are not tracked are left out. Raises ValueError, struct.error."""
    time_us, _, components = _FRAME.unpack_from(content)
    at, bodies = _FRAME.size, dict[int | str, BodyPose]()
    for _ in range(components):
        size, kind = _COMPONENT.unpack_from(content, at)
        if kind in _BODY:
            bodies = dict(_bodies(content, at + _COMPONENT.size, _BODY[kind], names))
        if size < _COMPONENT.size:
            raise ValueError(f"a component of {size} bytes")
        at += size
    return TrackedFrame(1e-6 * time_us, received_s, bodies)


def _bodies(content: bytes, at: int, body: struct.Struct, names: Sequence[str]) -> Iterator[tuple[int | str, BodyPose]]:
    n, _, _ = _BODIES.unpack_from(content, at)
    at += _BODIES.size
    for number in range(min(n, len(names))):
        numbers = np.array(body.unpack_from(content, at + number * body.size))
        if np.isfinite(numbers[:12]).all():
            # by columns R of v_W = R v_b: by rows it is A of v_b = A v_W
            q = quat.from_matrix(numbers[3:12].reshape(3, 3))
            yield names[number], BodyPose(_MM * numbers[:3], q, _MM * float(np.nan_to_num(numbers[12:]).sum()))


def frame_message(number: int, stamp_s: float, names: Sequence[str], bodies: Mapping[int | str, BodyPose]) -> bytes:
    """Return the data packet of ``bodies``; those of ``names`` that are missing are not tracked."""
    rows, row = b"", _BODY[_SIX_D_RESIDUAL]
    for name in names:
        pose = bodies.get(name)
        if pose is None or pose.q is None:
            rows += row.pack(*[np.nan] * 13)
        else:
            rows += row.pack(*pose.position / _MM, *quat.to_matrix(pose.q).reshape(9), pose.error_m / _MM)
    body = _BODIES.pack(len(names), 0, 0) + rows
    component = _COMPONENT.pack(_COMPONENT.size + len(body), _SIX_D_RESIDUAL) + body
    return packet(DATA, _FRAME.pack(round(1e6 * stamp_s), number, 1) + component)
