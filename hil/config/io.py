"""Rig files, table ``[io]``: coupler of digital inputs and outputs, and its wiring to the safety chain."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from hil.config.driver_registry import DeviceTable
from hil.config.model import ConfigModel, Positive

MAX_THRUSTER_LINES = 24

BitAddress = Annotated[int, Field(ge=0, le=65535)]


class IoCoils(ConfigModel):
    """Addresses of the outputs; the thrusters' lines are consecutive."""

    charge_pump: BitAddress = 0
    enable: BitAddress = 1
    thrusters_first: BitAddress = 2


class InputLines(ConfigModel):
    """Addresses of the inputs, each 1 while its contact is closed."""

    estop_closed: BitAddress = 0
    chain_closed: BitAddress = 1


class IoIdentity(ConfigModel):
    """Expected Modbus device identification of the coupler; omitted keys are not checked."""

    vendor: str | None = None
    product: str | None = None
    revision: str | None = None


class Io(DeviceTable):
    """Coupler of digital lines. ``driver = "none"``: the bench has none."""

    device: ClassVar = "io"
    without_wires: ClassVar = ("mock", "none")

    timeout_s: Positive = 0.4
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    device_id: Annotated[int, Field(ge=1, le=247)] = 1
    coils: IoCoils = IoCoils()
    inputs: InputLines = InputLines()
    interlocks: dict[str, BitAddress] = Field(default_factory=dict)  # name -> input, 1 while closed
    thruster_lines: Annotated[int, Field(ge=0, le=MAX_THRUSTER_LINES)] = MAX_THRUSTER_LINES  # 0: not mirrored
    pump_period_s: Positive = 0.01  # shortest time between two edges of the charge pump
    pump_timeout_s: Positive = 0.05  # without an edge for longer than this the relay opens
    identity: IoIdentity = IoIdentity()

    @model_validator(mode="after")
    def _addresses_are_used_once(self) -> Self:
        first, lines = self.coils.thrusters_first, self.thruster_lines
        if first + lines > 65536:
            raise ValueError(f"coils.thrusters_first {first}: the {lines} thruster lines must end at 65535")
        coils = [("coils.charge_pump", self.coils.charge_pump), ("coils.enable", self.coils.enable)]
        coils += [(f"coils.thrusters_first + {i}", first + i) for i in range(lines)]
        inputs = [("inputs.estop_closed", self.inputs.estop_closed), ("inputs.chain_closed", self.inputs.chain_closed)]
        inputs += [(f"interlocks.{name}", address) for name, address in self.interlocks.items()]
        for lines_of_a_kind in (coils, inputs):
            taken: dict[int, str] = {}
            for name, address in lines_of_a_kind:
                if address in taken:
                    raise ValueError(f"{name} has address {address}, which is that of {taken[address]}")
                taken[address] = name
        return self

    @model_validator(mode="after")
    def _the_pump_can_keep_up(self) -> Self:
        if self.pump_period_s > 0.5 * self.pump_timeout_s:
            text = f"pump_period_s {self.pump_period_s:g}: allowed up to half of pump_timeout_s"
            raise ValueError(f"{text}, {0.5 * self.pump_timeout_s:g}")
        return self
