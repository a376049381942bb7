"""Registry entry of the ASCII turntable controller."""

from __future__ import annotations

import math
from typing import Final

from hil.config.load import load_protocol
from hil.config.rig import AsciiTurntableLine, Turntable
from hil.config.tables.driver_registry import DriverEntry, WireKey
from hil.drivers.tcp_port import is_tcp
from hil.errors import BadInput

_BITS_PER_BYTE: Final = 10


def _check(turntable: Turntable) -> None:
    """Raise ValueError if the command set has other axes; one that cannot be read is reported by ``_check_files``."""
    name = (turntable.ascii or AsciiTurntableLine()).protocol
    try:
        gimbals = load_protocol(name).value.gimbals
    except BadInput:
        return
    if gimbals != turntable.axis_names:
        axes = ", ".join(turntable.axis_names)
        raise ValueError(
            f'ascii.protocol "{name}": drives {", ".join(gimbals)}, here {axes}; allowed: a file for these'
        )


def _check_files(turntable: Turntable) -> list[str]:
    return load_protocol(turntable.ascii.protocol).value.warnings() if turntable.ascii is not None else []


def _setpoints_hz(turntable: Turntable) -> float:
    """Each request waits for the reply to the one before."""
    from hil.drivers.turntable.ascii.protocol import AsciiProtocol  # on use: it is large

    line = turntable.ascii or AsciiTurntableLine()
    if is_tcp(line.port or ""):
        return math.inf
    size, replies = AsciiProtocol(load_protocol(line.protocol).value).exchange_size()
    return 1.0 / (_BITS_PER_BYTE * size / line.baud + replies * line.adapter_latency_s)


def _identity(turntable: Turntable) -> dict[str, str]:
    return {str(name): value for name, value in turntable.ascii.identity.items()} if turntable.ascii else {}


ENTRY: Final = DriverEntry(
    "turntable",
    "ascii",
    driver="hil.drivers.turntable.ascii.driver:AsciiTurntable",
    emulator="hil.parts.emulation.ascii_turntable:AsciiTurntableEmulator",
    wires=[WireKey("ascii.port", "serial")],
    check=_check,
    check_files=_check_files,
    identity=_identity,
    axes=range(1, 4),
    setpoints_hz=_setpoints_hz,
    keeps_bench_time=lambda table: True,
)
