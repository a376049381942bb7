"""Rig files, table ``[flight_computer]``: a computer that commands the thrusters by command words."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.driver_registry import Wire, WireKey
from hil.config.tables.model import ConfigModel, Positive
from hil.config.tables.wires import CanBus


class WordsCan(CanBus):
    """The CAN bus of the command words."""

    interface: str = "socketcan"
    """Interface of python-can."""
    baud: Annotated[int, Field(gt=0)] = 115_200
    """Baud rate of a serial adapter."""
    bitrate: Annotated[int, Field(gt=0)] = 500_000
    """Bit rate of the bus, bit/s."""
    identifier: Annotated[int, Field(ge=1, le=0x7FF)] = 0x120
    """11-bit identifier of the command words."""


class WordsLine(ConfigModel):
    """A serial port."""

    port: str | None = None
    """Serial port."""
    baud: Annotated[int, Field(gt=0)] = 115_200
    """Baud rate."""


class FlightComputer(ConfigModel):
    """Flight computer in the loop."""

    command_words: Literal["none", "serial", "can"] = "none"
    """Link of the flight computer; "none": the GNC of the scenario is used."""
    timeout_s: Positive = 0.1
    """Age from which a command word opens no thruster."""
    lost_s: Positive = 0.5
    """Time without a command word after which `on_loss` applies."""
    on_loss: Literal["hold", "stop"] = "stop"
    """Hold or safe stop."""
    serial: WordsLine = WordsLine.model_construct()
    """Serial port of the command words."""
    can: WordsCan = WordsCan.model_construct()
    """CAN bus of the command words."""
    poses: WordsLine = WordsLine(baud=460_800)
    """Serial output of the vision unit's frames, if it has a port."""

    @model_validator(mode="after")
    def _lost_is_later_than_silent(self) -> Self:
        if self.lost_s < self.timeout_s:
            raise ValueError(f"lost_s = {self.lost_s:g}: must not be below timeout_s, {self.timeout_s:g}")
        return self

    @model_validator(mode="after")
    def _poses_go_to_who_flies(self) -> Self:
        if self.command_words == "none" and self.poses.port is not None:
            raise ValueError(
                'poses.port goes with command_words = "serial" or "can": other GNCs receive the poses by other means'
            )
        return self

    def wires(self) -> list[Wire]:
        """Return the wires that are opened, also those without an address in the file."""
        keys = {"serial": [WireKey("serial.port", "serial")], "can": [WireKey("can.channel", "can")]}.get(
            self.command_words, []
        )
        if self.poses.port is not None:
            keys.append(WireKey("poses.port", "serial"))
        wires = [key.wire(self) for key in keys]
        return [Wire(f"flight_computer.{wire.key}", wire.kind, wire.address) for wire in wires]
