"""CAN buses of a rig: of drives, of an IMU, and of the command words of a flight computer."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil.config.tables.model import ConfigModel


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
