"""IMU of a lab on a wire of the rig: ``[imu]``."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from hil.config.tables.driver_registry import Wire, WireKind
from hil.config.tables.model import ConfigModel, Positive, Triple

UDP: Final = "udp://"


class ImuWire(ConfigModel):
    """IMU on the innermost gimbal, whose gyros take the place of the virtual ones; on a mock rig it is the virtual one.

    Its rate is that of the table: Earth's rotation is removed, H's rate in the truth added. Accelerometers stay
    virtual: on a table they measure weight.
    """

    port: str | None = None
    """Serial port, or `udp://HOST:PORT` of this computer, on which datagrams are received."""
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
        kind: WireKind = "udp" if self.port is not None and self.port.startswith(UDP) else "serial"
        return Wire("imu.port", kind, self.port)
