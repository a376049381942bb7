"""Serial ports of the drivers: pyserial's, or those that a bench in lock-step opens, whose bytes are counted."""

from __future__ import annotations

import select
import termios
from pathlib import Path
from typing import Any, Final

import serial

from hil.core.clock import BenchClock
from hil.core.part import provided

_TTY: Final = Path("/sys/class/tty")
_HANDLERS: Final = "hil.parts.emulation.serial_urls"


def open_serial(clock: BenchClock, path: str, baud: int, **settings: Any) -> serial.Serial:
    """Return the serial port ``path``, open, at low latency, without the bytes that were received before.

    settings: further arguments of pyserial; its time-outs are wall time, bench time in lock-step. Raises OSError or
    ValueError.
    """
    if is_counted(clock):
        return provided("rig.host.time=lock_step: serial")(clock, path, baud, **settings)
    try:
        port = serial.Serial(path, baud, **settings)
        set_low_latency(port)
        port.reset_input_buffer()
    except termios.error as error:  # no OSError; of settings that the line refuses, and of a line that has gone
        raise OSError(*error.args) from error
    return port


def set_low_latency(port: Any) -> bool:
    """Let the adapter of a port pass on each byte at once, FTDI's wait up to 16 ms; return whether its driver can."""
    try:
        port.set_low_latency_mode(True)
    except (AttributeError, OSError, ValueError):
        return False
    return True


def latency_timer_ms(path: str, folder: Path = _TTY) -> int | None:
    """Return the time that the adapter of a port collects bytes for, ms; None for one that does not."""
    try:
        return int((folder / Path(path).resolve().name / "device" / "latency_timer").read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


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
