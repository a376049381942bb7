"""What the driver will use of a CiA 402 drive, by its data sheet alone."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from hil.config.rig import Cia402
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.eds import Eds
from hil.drivers.turntable.cia402.units import counts_per_shaft_turn, velocity_per_radps

Finding = tuple[str, str, str]
"""Name, text and advice of a finding."""
_ASK: Final = "the connected drive is asked"


def describe(path: Path) -> list[Finding]:
    """Return mode, units, watchdog and what is missing. Raises BadInput for a drive that cannot be used."""
    eds = Eds(path)
    names = " or ".join(codec.MODE_NAMES[mode] for mode in eds.streams)
    by = "0x6502" if eds.default(*codec.SUPPORTED_MODES) else "its objects; 0x6502 of the connected drive decides"
    watchdogs = eds.watchdogs()
    homes = all(eds.can_write(*key) for key in codec.HOMING_OBJECTS)
    period = next((name for key, name in _PERIODS.items() if eds.can_write(*key)), "")
    return [
        ("setpoints", f"{names}, by {by}", ""),
        ("position unit", *_position_unit(eds)),
        ("velocity unit", *_velocity_unit(eds)),
        ("interpolation", *((f"{period} is set to the time between setpoints", "") if period else _NO_PERIOD)),
        ("watchdog", " and ".join(watchdogs) or "none", ""),
        (
            "homing",
            "by the drive" if homes else "none: 0x6098, 0x6099",
            "" if homes else "an absolute encoder is needed",
        ),
        *(("missing", line, "") for line in eds.losses()),
        *(("illegible", note, "") for note in eds.notes),
    ]


_PERIODS: Final = {(codec.INTERPOLATION_PERIOD, 1): "0x60C2", (codec.CYCLE_PERIOD, 0): "0x1006"}
_NO_PERIOD: Final = (
    "0x60C2 and 0x1006 are missing: the drive interpolates over a time of its own",
    "set that time to the one between setpoints with the tool of the maker",
)


def _position_unit(eds: Eds) -> tuple[str, str]:
    counts, source = counts_per_shaft_turn(eds.default)
    if counts is None:
        return "not declared", "enter cia402.counts_per_turn by the manual, and let a witness confirm the first motion"
    return (
        f"1 turn of the shaft = {counts:.9g} increments by {source}, as delivered",
        f"{_ASK} and must agree with the rig",
    )


def _velocity_unit(eds: Eds) -> tuple[str, str]:
    try:
        velocity = velocity_per_radps(Cia402(), eds.default(codec.VELOCITY_UNIT) or 0)
    except ValueError as error:
        return str(error), ""
    if velocity is None:
        return (
            "0x60A9 is missing or empty",
            "no velocity is sent, rates are those of the positions; homing needs the unit",
        )
    return f"0x60A9 = 0x{eds.default(codec.VELOCITY_UNIT):08X}, as delivered", _ASK
