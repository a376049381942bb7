"""Serial line of the rail drives, table ``[rails.rtu]``."""

from __future__ import annotations

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.model import ConfigModel, Delay
from hil.config.tables.rail_map import RailMap, span

DeviceId = Annotated[int, Field(ge=1, le=247)]

_BYTES: Final = {3: 13, 6: 14, 16: 17, 23: 18}  # a serial transaction, both ways, without the registers


class ModbusRtu(ConfigModel):
    """Drives on one serial line, addressed one after the other."""

    port: str | None = None
    """Serial port."""
    baud: Annotated[int, Field(ge=9600, le=4_000_000)] = 115_200
    """Baud rate."""
    parity: Literal["none", "even", "odd"] = "even"
    """Parity."""
    stopbits: Literal[1, 2] = 1
    """Stop bits."""
    adapter_latency_s: Delay = 0.0
    """Time for which a USB adapter collects bytes."""
    device_ids: Annotated[tuple[DeviceId, ...], Field(min_length=1, max_length=6)] = (1, 2, 3)
    """Modbus device ids of x, y, z, of further axes also of u, v, w; or of as many drives as there are."""

    @property
    def bits_per_byte(self) -> int:
        """Start bit, eight data bits, parity bit, stop bits."""
        return 9 + (self.parity != "none") + self.stopbits

    @property
    def gap_s(self) -> float:
        """Silence between two frames: 3.5 characters, 1.75 ms at least (MODBUS over serial line V1.02, 2.5.1.1)."""
        return max(3.5 * self.bits_per_byte / self.baud, 1.75e-3)

    def exchange_s(self, register_map: RailMap) -> float:
        """Return how long the line is busy with one exchange, s."""
        blocks = register_map.blocks()
        written, read = len(span(blocks["command"].values())), len(span(blocks["state"].values()))
        transactions = [*[6] * written, 3] if register_map.functions[0] == 6 else register_map.functions
        size = sum(_BYTES[function] for function in transactions) + 2 * (written + read)
        return size * self.bits_per_byte / self.baud + len(transactions) * (2.0 * self.gap_s + self.adapter_latency_s)

    @model_validator(mode="after")
    def _devices_differ(self) -> Self:
        if len(set(self.device_ids)) != len(self.device_ids):
            raise ValueError(f"device_ids {list(self.device_ids)} must differ from each other")
        return self
