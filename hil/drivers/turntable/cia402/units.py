"""Units of a CiA 402 drive: increments and velocity units per turn of the axis, as drive and rig file declare them.

Sources: CiA 402-2 (0x608F to 0x6093, 0x60A8, 0x60A9), CiA 303-2 (codes of units and prefixes).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from hil.config.rig import Cia402
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.eds import ReadObject

_TURN: Final = 0xB4
_INCREMENT: Final = 0xB5
_ANGLES: Final = {
    0x10: 1.0, 0x41: math.pi / 180.0, 0x42: math.pi / 10_800.0, 0x43: math.pi / 648_000.0, _TURN: math.tau
}  # fmt: skip
"""Unit of an angle, rad, by its code."""
_TIMES_S: Final = {0x03: 1.0, 0x47: 60.0, 0x48: 3600.0}
_COARSEST_RADPS: Final = math.radians(0.05)  # unit of velocity
_TOLERANCE: Final = 1e-6  # of a scale; beyond it drive and rig file contradict each other


@dataclass(frozen=True, slots=True)
class Units:
    """Units of a drive per rad and per rad/s of the axis. velocity: None if neither drive nor rig file declares it.

    declared: whether the drive confirms ``position``.
    """

    position: float
    velocity: float | None
    declared: bool = True

    def counts(self, angle_rad: float) -> int:
        """Return an angle in whole position units."""
        return round(angle_rad * self.position)

    def speed(self, rate_radps: float) -> int:
        """Return a rate in whole velocity units; 0 if their size is unknown."""
        return round(rate_radps * self.velocity) if self.velocity else 0

    @property
    def has_rates(self) -> bool:
        """Whether velocities are fine enough for feed-forward and feedback."""
        return self.velocity is not None and self.velocity >= 1.0 / _COARSEST_RADPS

    def __str__(self) -> str:
        degree = math.pi / 180.0
        source = "" if self.declared else " (of the rig file; the drive declares none)"
        velocity = "velocity unit not declared"
        if self.velocity is not None:
            velocity = f"1 deg/s = {self.velocity * degree:.9g} velocity units"
        if not self.has_rates:
            velocity += ": no velocity is sent, rates are those of the positions"
        return f"1 deg = {self.position * degree:.9g} increments{source}, {velocity}"


def units_of(config: Cia402, read: ReadObject) -> Units:
    """Return the units of a drive whose objects ``read`` returns.

    Raises ValueError, one line, if they contradict the rig file, or have a unit that is not known.
    """
    shaft, source = counts_per_shaft_turn(read)
    expected = config.counts_per_turn / config.gear_ratio
    if shaft is not None and not math.isclose(shaft, expected, rel_tol=_TOLERANCE):
        given = f"counts_per_turn = {config.counts_per_turn}" + (
            f" / gear_ratio = {config.gear_ratio:g}" if config.gear_ratio != 1.0 else ""
        )
        raise ValueError(
            f"{source} declares {shaft:.9g} position units per turn of the drive's shaft, the rig file has {given}: "
            "correct the wrong one, or set cia402.gear_ratio, turns of the shaft per turn of the axis"
        )
    velocity = velocity_per_radps(config, read(codec.VELOCITY_UNIT, 0) or 0)
    of_file = config.velocity_units_per_degps
    if of_file is not None:
        of_file *= 180.0 / math.pi
        if velocity is not None and not math.isclose(velocity, of_file, rel_tol=_TOLERANCE):
            raise ValueError(
                f"0x60A9 declares {velocity * math.pi / 180.0:.9g} velocity units per deg/s of the axis, "
                f"cia402.velocity_units_per_degps = {config.velocity_units_per_degps:g}: correct the wrong one"
            )
        velocity = of_file
    return Units(config.counts_per_turn / math.tau, velocity, shaft is not None)


def _split(unit: int) -> tuple[float, int, int]:
    """Return factor, numerator and denominator of a unit."""
    prefix = (unit >> 24) & 0xFF
    return codec.power_of_ten(prefix - 256 if prefix > 127 else prefix), (unit >> 16) & 0xFF, (unit >> 8) & 0xFF


def _ratio(read: ReadObject, index: int) -> float | None:
    """Return the quotient of the two entries of an object."""
    numerator, divisor = read(index, 1), read(index, 2)
    return numerator / (divisor or 1) if numerator else None


def counts_per_shaft_turn(read: ReadObject) -> tuple[float | None, str]:
    """Return position units per turn of the drive's shaft, and the objects that declare them.

    Objects that are all 1 scale nothing: the drive counts increments without a declared number per revolution.
    """
    unit = read(codec.POSITION_UNIT, 0) or 0
    factor, numerator, _ = _split(unit)
    if numerator in _ANGLES:
        return math.tau / (factor * _ANGLES[numerator]), f"0x60A8 (0x{unit & 0xFFFF_FFFF:08X})"
    feed = _ratio(read, codec.FEED_CONSTANT)
    if numerator != _INCREMENT and feed is not None and feed > 1.0:
        return feed, "0x6092"
    encoder = _ratio(read, codec.ENCODER_RESOLUTION)
    if encoder is None or encoder <= 1.0:
        return None, ""
    gear, scale = _ratio(read, codec.GEAR_RATIO) or 1.0, _ratio(read, codec.POSITION_FACTOR) or 1.0
    source = "0x608F" if gear == 1.0 else "0x608F with 0x6091"
    return encoder * gear / scale, source if scale == 1.0 else f"{source} and 0x6093"


def velocity_per_radps(config: Cia402, unit: int) -> float | None:
    """Return velocity units per rad/s of the axis by the value of 0x60A9; None for 0. Raises ValueError."""
    factor, numerator, denominator = _split(unit)
    if numerator == 0 and denominator == 0:
        return None
    if denominator not in _TIMES_S or (numerator not in _ANGLES and numerator != _INCREMENT):
        if config.velocity_units_per_degps is not None:
            return None
        raise ValueError(
            f"0x60A9 = 0x{unit & 0xFFFF_FFFF:08X} is no known unit of a rotary axis: "
            "set cia402.velocity_units_per_degps"
        )
    if numerator == _INCREMENT:
        return config.counts_per_turn / math.tau * _TIMES_S[denominator] / factor
    return config.gear_ratio * _TIMES_S[denominator] / (factor * _ANGLES[numerator])
