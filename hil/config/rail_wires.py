"""The rails' serial line, and what wires and register map must be able to do for the axes."""

from __future__ import annotations

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from hil.config.model import ConfigModel
from hil.config.rail_map import RailMap, reach, span

DeviceId = Annotated[int, Field(ge=1, le=247)]

_EXCHANGE_BYTES: Final = 18  # of function 23 on a serial line, request and answer, without the registers
_EXCHANGES_IN_TIMEOUT: Final = 10.0  # three drives, one of them asked twice, and as much again for their own time


class ModbusRtu(ConfigModel):
    """Three drives on one serial line; they take turns."""

    port: str | None = None
    baud: Annotated[int, Field(ge=9600, le=4_000_000)] = 115_200
    parity: Literal["none", "even", "odd"] = "even"
    stopbits: Literal[1, 2] = 1
    device_ids: tuple[DeviceId, DeviceId, DeviceId] = (1, 2, 3)  # x, y, z

    @property
    def bits_a_byte(self) -> int:
        """Start bit, eight data bits, parity, stop bits."""
        return 9 + (self.parity != "none") + self.stopbits

    @property
    def gap_s(self) -> float:
        """Silence between two frames: 3.5 characters, 1.75 ms at least (MODBUS over serial line V1.02, 2.5.1.1)."""
        return max(3.5 * self.bits_a_byte / self.baud, 1.75e-3)

    def exchange_s(self, register_map: RailMap) -> float:
        """Return how long the line is busy with one exchange, s."""
        blocks = register_map.blocks()
        words = len(span(blocks["command"].values())) + len(span(blocks["state"].values()))
        return (_EXCHANGE_BYTES + 2 * words) * self.bits_a_byte / self.baud + 2.0 * self.gap_s

    @model_validator(mode="after")
    def _devices_differ(self) -> Self:
        if len(set(self.device_ids)) != len(self.device_ids):
            raise ValueError(f"device_ids {list(self.device_ids)} must differ from each other")
        return self


def check_line(baud: int, exchange_s: float, timeout_s: float) -> None:
    """Raise ValueError where the line is too slow for three drives of which one may be asked twice."""
    least_s = _EXCHANGES_IN_TIMEOUT * exchange_s
    if timeout_s < least_s:
        raise ValueError(
            f"timeout_s {timeout_s:g}: too short for three drives at {baud} baud, one of them asked twice, "
            f"allowed {least_s:.2f} or more"
        )


def check_axis(register_map: RailMap, name: str, travel_m: tuple[float, float], incremental: bool) -> None:
    """Raise ValueError where the map cannot serve the axis ``name``."""
    if incremental and not register_map.homes:
        raise ValueError(f'{name}.encoder = "incremental" needs map.control_bits.home and map.status_bits.homed')
    for block, register in (("command", register_map.command.position), ("state", register_map.state.position)):
        low, high = reach(register)
        if not low <= travel_m[0] < travel_m[1] <= high:
            raise ValueError(
                f"{name}.travel_m {list(travel_m)}: map.{block}.position ({register.type}, {register.scale:g} "
                f"{register.unit} a count) holds {low:g} to {high:g} m"
            )
