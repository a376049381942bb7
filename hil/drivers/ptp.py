"""Clock synchronisation by PTP: state and offset of linuxptp's ``ptp4l``, read from its management socket.

Management messages of IEEE 1588-2019, clause 15, over a UNIX datagram socket; TIME_STATUS_NP is linuxptp's own.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from hil.core.surroundings import temporary_folder
from hil.errors import LinkLost, LinkTimeout, ProtocolError

NAME: Final = "ptp4l"
PORT_STATES: Final = (
    "unknown", "initializing", "faulty", "disabled", "listening", "pre-master", "master", "passive", "uncalibrated",
    "slave", "grand master",
)  # fmt: skip
"""Of portState, IEEE 1588-2019 table 20; the last one is linuxptp's."""
_LEADS: Final = ("master", "grand master")

_TIMEOUT_WALL_S: Final = 0.5
_MANAGEMENT: Final = 0x0D
_VERSION: Final = 2
_CONTROL: Final = 4
_NO_INTERVAL: Final = 0x7F
_RESPONSE: Final = 2
_TLV_MANAGEMENT: Final = 1
_PORT_DATA_SET, _TIME_STATUS_NP, _CURRENT_DATA_SET = 0x2004, 0xC000, 0x2001
_HEADER: Final = struct.Struct(">BBHBBHq4s8sHHBb")  # IEEE 1588-2019, table 35
_BODY: Final = struct.Struct(">8sHBBBB")  # target port, hops, action
_TLV: Final = struct.Struct(">HHH")
_TLV_AT: Final = _HEADER.size + _BODY.size
_SIZES: Final = {_PORT_DATA_SET: 26, _TIME_STATUS_NP: 50, _CURRENT_DATA_SET: 18}
"""Bytes of the data: sent as zeros in a request, which older versions of linuxptp expect."""
_NANOSECONDS: Final = 1.0 / 65536.0  # nanoseconds per unit of a TimeInterval
_TRIES: Final = 8  # messages that are not the answer


@dataclass(frozen=True, slots=True)
class PtpStatus:
    """State of the port, offset from its master, s, path delay, s, and identity of the grandmaster, "" without one.

    A port that measures its offset without correcting the clock (``free_running``) is "uncalibrated".
    """

    state: str
    offset_s: float
    path_delay_s: float
    grandmaster: str

    def problem(self, offset_max_s: float) -> str:
        """Return why the clock is not within ``offset_max_s`` of its master, "" if it is, or is the master itself."""
        if self.state in _LEADS:
            return ""
        if not self.grandmaster:
            return f"{self.state}, no master"
        if abs(self.offset_s) <= offset_max_s:
            return ""
        return f"{self.state}, offset {1e6 * self.offset_s:.3g} us, allowed {1e6 * offset_max_s:g} us"

    def __str__(self) -> str:
        if self.state in _LEADS or not self.grandmaster:
            return self.state
        return f"{self.state} of {self.grandmaster}, offset {1e6 * self.offset_s:.3g} us"

    def as_json(self) -> dict[str, float | str]:
        """Return the status for JSON."""
        return {
            "state": self.state,
            "offset_us": 1e6 * self.offset_s,
            "path_delay_us": 1e6 * self.path_delay_s,
            "grandmaster": self.grandmaster,
        }


def read_status(path: str, domain: int = 0) -> PtpStatus:
    """Return the status of the ``ptp4l`` whose management socket is at ``path``.

    Raises LinkLost without such a socket, LinkTimeout without an answer, ProtocolError for one that is none.
    """
    with temporary_folder("ptp") as folder, _connected(path, folder) as link:
        port = _ask(link, domain, _PORT_DATA_SET)
        times = _ask(link, domain, _TIME_STATUS_NP)
        current = _ask(link, domain, _CURRENT_DATA_SET)
    state = port[10]
    (offset_ns,) = struct.unpack_from(">q", times)
    (delay,) = struct.unpack_from(">q", current, 10)
    present, grandmaster = struct.unpack_from(">i8s", times, 38)
    return PtpStatus(
        PORT_STATES[state] if state < len(PORT_STATES) else PORT_STATES[0],
        offset_ns * 1e-9 if present else 0.0,
        delay * _NANOSECONDS * 1e-9,
        grandmaster.hex() if present else "",
    )


@contextlib.contextmanager
def _connected(path: str, folder: str) -> Iterator[socket.socket]:
    link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        link.bind(os.path.join(folder, "client"))
        link.settimeout(_TIMEOUT_WALL_S)
        link.connect(path)
        yield link
    except TimeoutError as error:
        raise LinkTimeout(NAME, f"no answer at {path} within {_TIMEOUT_WALL_S:g} s") from error
    except OSError as error:
        raise LinkLost(NAME, f"cannot open {path}: {error.strerror or error}") from error
    finally:
        link.close()


def request(domain: int, what: int) -> bytes:
    """Return the message that asks for the data set ``what``."""
    data = bytes(_SIZES[what])
    size = _TLV_AT + _TLV.size + len(data)
    header = _HEADER.pack(
        _MANAGEMENT, _VERSION, size, domain, 0, 0, 0, bytes(4), b"hilbench", 1, what & 0xFFFF, _CONTROL, _NO_INTERVAL
    )
    return header + _BODY.pack(b"\xff" * 8, 0xFFFF, 0, 0, 0, 0) + _TLV.pack(_TLV_MANAGEMENT, 2 + len(data), what) + data


def data_of(message: bytes, what: int) -> bytes | None:
    """Return the data set ``what`` of a response, None if ``message`` is not that response."""
    if len(message) < _TLV_AT + _TLV.size or message[0] & 0x0F != _MANAGEMENT:
        return None
    action = message[_TLV_AT - 2] & 0x0F
    kind, length, identifier = _TLV.unpack_from(message, _TLV_AT)
    data = message[_TLV_AT + _TLV.size : _TLV_AT + _TLV.size - 2 + length]
    if (action, kind, identifier) != (_RESPONSE, _TLV_MANAGEMENT, what) or len(data) < _SIZES[what]:
        return None
    return data


def _ask(link: socket.socket, domain: int, what: int) -> bytes:
    link.send(request(domain, what))
    for _ in range(_TRIES):
        data = data_of(link.recv(2048), what)
        if data is not None:
            return data
    raise ProtocolError(NAME, f"no response to the request for data set 0x{what:04x}")
