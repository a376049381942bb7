"""Wires of a rig: CAN buses, the serial line of the rail drives, ``[rails.rtu]``, and the IMU of a lab, ``[imu]``."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.driver_registry import Wire, WireKey, WireKind
from hil.config.tables.model import ConfigModel, Delay, Positive, Triple
from hil.config.tables.rail_map import RailMap, span


class CanBus(ConfigModel):
    """CAN bus of python-can."""

    interface: str = "serial"
    """Interface of python-can."""
    channel: str | None = None
    """Channel of that interface."""
    bitrate: Annotated[int, Field(gt=0)] = 1_000_000
    """Bit rate of the bus, bit/s."""
    baud: Annotated[int, Field(gt=0)] = 1_000_000
    """Baud rate of a serial adapter."""
    arguments: dict[str, bool | int | float | str] = Field(default_factory=dict)
    """Further arguments of that interface, such as `host` and `port` of socketcand."""


UDP: Final = "udp://"


class ImuCan(CanBus):
    """CAN bus of an IMU whose frame is sent in several messages."""

    identifiers: Annotated[tuple[Annotated[int, Field(ge=0, le=0x7FF)], ...], Field(min_length=1, max_length=8)]
    """Of the messages of a frame, in their order. The frame has the first one, two bytes, big end first, as its sync,
    and after it the data of all."""

    @property
    def sync(self) -> bytes:
        """Bytes with which a frame begins."""
        return self.identifiers[0].to_bytes(2, "big")


class ImuWire(ConfigModel):
    """IMU on the innermost gimbal, whose gyros take the place of the virtual ones; on a mock rig it is the virtual one.

    Its rate is that of the table: Earth's rotation is removed, H's rate in the truth added. Accelerometers stay
    virtual: on a table they measure weight.
    """

    port: str | None = None
    """Serial port, or `udp://HOST:PORT` of this computer, on which datagrams are received."""
    can: ImuCan | None = None
    """In place of a port."""
    baud: Annotated[int, Field(gt=0)] = 460_800
    """Baud rate of a serial port."""
    frames: str = "imu"
    """Frames with a field `rate`: `imu` or the path of a frame file."""
    rate_hz: Positive = 200.0
    """Frames per second, at least one per cycle."""
    timeout_s: Positive = 0.1
    """Silence that stops the bench."""
    rotation_deg: Triple = (0.0, 0.0, 0.0)
    """Rotation vector from c to the axes of the IMU."""
    earth_rate_degps: Triple = (0.0, 0.0, 0.0)
    """Earth's rotation, in the axes of rails and gimbals: 0.00418 along the local pole."""

    def wire(self) -> Wire:
        """Return the wire."""
        if self.can is not None:
            wire = WireKey("channel", "can").wire(self.can)
            return Wire("imu.can.channel", wire.kind, wire.address)
        kind: WireKind = "udp" if self.port is not None and self.port.startswith(UDP) else "serial"
        return Wire("imu.port", kind, self.port)

    @model_validator(mode="after")
    def _has_one_wire(self) -> Self:
        if self.can is not None and self.port is not None:
            raise ValueError(f'port "{self.port}": does not go with the table can, allowed one of both')
        if self.can is not None and len(set(self.can.identifiers)) < len(self.can.identifiers):
            raise ValueError(f"can.identifiers {list(self.can.identifiers)}: must differ from each other")
        return self

    def connected(self, address: str) -> Self:
        """Return the table with the address that its emulator reports: CAN is on a serial adapter there."""
        if self.can is not None:
            update: dict[str, Any] = {"interface": "serial", "channel": address}
            return self.model_copy(update={"can": self.can.model_copy(update=update)})
        return self.model_copy(update={"port": (UDP if (self.port or "").startswith(UDP) else "") + address})


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
