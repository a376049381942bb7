"""Serial ports of the drivers: pyserial's, or those that a bench in lock-step opens, whose bytes are counted."""

from __future__ import annotations

import select
from typing import Any, Final

import serial

from hil.core.clock import BenchClock
from hil.core.part import provided

_HANDLERS: Final = "hil.parts.emulation.serial_urls"


def open_serial(clock: BenchClock, path: str, baud: int, **settings: Any) -> serial.Serial:
    """Return the serial port ``path``, open, without the bytes that were received before.

    settings: further arguments of pyserial; its time-outs are wall time, bench time in lock-step. Raises OSError,
    ValueError or termios.error.
    """
    if is_counted(clock):
        return provided("rig.host.time=lock_step: serial")(clock, path, baud, **settings)
    port = serial.Serial(path, baud, **settings)
    port.reset_input_buffer()
    return port


def is_counted(clock: BenchClock) -> bool:
    """Return whether ``clock`` advances by the bytes of the wires, in lock-step."""
    return bool(getattr(clock, "counts_bytes", False))


def url_of(clock: BenchClock, path: str) -> str:
    """Return the name of a port for a library that opens it by pyserial, in an event loop of ``clock``."""
    if not is_counted(clock):
        return path
    if _HANDLERS not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(_HANDLERS)
    return f"lockstep://{path}"


def wait_readable(port: serial.Serial, wall_s: float) -> bool:
    """Wait at most ``wall_s`` until there is something to read; return whether there is."""
    if (wait := getattr(port, "wait_readable", None)) is not None:
        return bool(wait(wall_s))
    return bool(select.select([port.fileno()], [], [], wall_s)[0])
