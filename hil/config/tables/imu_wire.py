"""IMU of a lab on a wire of the rig: ``[imu]``."""

from __future__ import annotations

from typing import Annotated, Any, Final, Self

from pydantic import Field, model_validator

from hil.config.tables.can_bus import CanBus
from hil.config.tables.driver_registry import Wire, WireKey, WireKind
from hil.config.tables.model import ConfigModel, Positive, Triple

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
