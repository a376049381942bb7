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


def _check_files(turntable: Turntable) -> list[str]:
    if turntable.ascii is None:
        return []
    protocol = load_protocol(turntable.ascii.protocol)
    if protocol.value.gimbals != turntable.axis_names:
        text = f"{', '.join(protocol.value.gimbals)}: the rig has this driver for {', '.join(turntable.axis_names)}"
        raise BadInput.single(protocol.source, "gimbals", text)
    return protocol.value.warnings()


def _setpoints_hz(turntable: Turntable) -> float:
    """Each request waits for the reply to the one before."""
    from hil.drivers.turntable.ascii.protocol import AsciiProtocol  # on use: it is large

    line = turntable.ascii or AsciiTurntableLine()
    if is_tcp(line.port or ""):
        return math.inf
    return line.baud / (_BITS_PER_BYTE * AsciiProtocol(load_protocol(line.protocol).value).exchange_bytes())


def _identity(turntable: Turntable) -> dict[str, str]:
    return {str(name): value for name, value in turntable.ascii.identity.items()} if turntable.ascii else {}


ENTRY: Final = DriverEntry(
    "turntable",
    "ascii",
    driver="hil.drivers.turntable.ascii.driver:AsciiTurntable",
    emulator="hil.parts.emulation.ascii_turntable:AsciiTurntableEmulator",
    wires=[WireKey("ascii.port", "serial")],
    check_files=_check_files,
    identity=_identity,
    axes=range(1, 4),
    setpoints_hz=_setpoints_hz,
    keeps_bench_time=lambda table: True,
)
