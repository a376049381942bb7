"""Rig files, table ``[io]``: coupler of digital inputs and outputs, and its wiring to the safety chain."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from hil.config.tables.driver_registry import DeviceTable
from hil.config.tables.model import ConfigModel, NotNegative, Positive

MAX_THRUSTER_LINES = 24

BitAddress = Annotated[int, Field(ge=0, le=65535)]


class IoCoils(ConfigModel):
    """Addresses of the outputs; the thrusters' lines are consecutive."""

    charge_pump: BitAddress = 0
    """Output that toggles while the monitoring processes are alive."""
    enable: BitAddress = 1
    """Output whose edge requests the safety relay to close."""
    thrusters_first: BitAddress = 2
    """First of the outputs that show the thrusters."""
    brakes_released: BitAddress | None = None
    """Output that releases the holding brakes; omitted if drives and relay control them."""
    warning: BitAddress | None = None
    """Output of the light or horn that warns before the first motion; omitted if the bench has none."""


class InputLines(ConfigModel):
    """Addresses of the inputs, each 1 while its contact is closed."""

    estop_closed: BitAddress = 0
    """Input that is 1 while the emergency stop is released."""
    chain_closed: BitAddress = 1
    """Input that is 1 while the relay enables torque."""
    brakes_closed: BitAddress | None = None
    """Input that is 1 while all holding brakes are closed; omitted if they have no contact."""
    local_enable: BitAddress | None = None
    """Input that is 1 while the switch at the bench permits power and motion; omitted if the bench has none."""


class IoIdentity(ConfigModel):
    """Expected Modbus device identification of the coupler; omitted keys are not checked."""

    vendor: str | None = None
    """Vendor name."""
    product: str | None = None
    """Product code."""
    revision: str | None = None
    """Revision."""


class Io(DeviceTable):
    """Coupler of digital lines. ``driver = "none"``: the bench has none."""

    device: ClassVar = "io"
    without_wires: ClassVar = ("mock", "none")

    timeout_s: Positive = 0.4
    """Longest silence of the coupler."""
    host: str = "127.0.0.1"
    """Address of the coupler."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """TCP port of the coupler."""
    device_id: Annotated[int, Field(ge=1, le=247)] = 1
    """Modbus device id."""
    coils: IoCoils = IoCoils.model_construct()
    """Addresses of outputs."""
    inputs: InputLines = InputLines.model_construct()
    """Addresses of inputs."""
    interlocks: dict[str, BitAddress] = Field(default_factory=dict)
    """Further contacts of the chain: name = input, 1 while closed. An open one ends the run and is named."""
    thruster_lines: Annotated[int, Field(ge=0, le=MAX_THRUSTER_LINES)] = MAX_THRUSTER_LINES
    """Outputs that show the thrusters, at least as many as the scenario has, or 0."""
    pump_period_s: Positive = 0.01
    """Shortest time between two edges of the charge pump, at most half of `pump_timeout_s`."""
    pump_timeout_s: Positive = 0.05
    """Time-out of the safety relay for an edge of the charge pump."""
    torque_delay_s: NotNegative = 0.0
    """Delayed contacts of the safety relay: the torque goes this long after brakes and chain."""
    warning_s: Annotated[float, Field(ge=0.0, le=60.0)] = 2.0
    """Duration of the warning before the first motion after the drives were enabled, with `coils.warning`."""
    identity: IoIdentity = IoIdentity.model_construct()
    """Expected identification of the coupler."""

    @model_validator(mode="after")
    def _addresses_are_used_once(self) -> Self:
        first, lines = self.coils.thrusters_first, self.thruster_lines
        if first + lines > 65536:
            raise ValueError(f"coils.thrusters_first {first}: the {lines} thruster lines must end at 65535")
        coils = [("coils.charge_pump", self.coils.charge_pump), ("coils.enable", self.coils.enable)]
        coils += [(f"coils.thrusters_first + {i}", first + i) for i in range(lines)]
        signals = {"brakes_released": self.coils.brakes_released, "warning": self.coils.warning}
        coils += [(f"coils.{name}", address) for name, address in signals.items() if address is not None]
        inputs = [("inputs.estop_closed", self.inputs.estop_closed), ("inputs.chain_closed", self.inputs.chain_closed)]
        optional = {"brakes_closed": self.inputs.brakes_closed, "local_enable": self.inputs.local_enable}
        inputs += [(f"inputs.{name}", address) for name, address in optional.items() if address is not None]
        inputs += [(f"interlocks.{name}", address) for name, address in self.interlocks.items()]
        for lines_of_a_kind in (coils, inputs):
            taken: dict[int, str] = {}
            for name, address in lines_of_a_kind:
                if address in taken:
                    raise ValueError(f"{name} has address {address}, which is that of {taken[address]}")
                taken[address] = name
        return self

    @model_validator(mode="after")
    def _brakes_are_commanded_to_be_read(self) -> Self:
        if self.inputs.brakes_closed is not None and self.coils.brakes_released is None:
            raise ValueError("inputs.brakes_closed: needs coils.brakes_released, the output that it confirms")
        return self

    @model_validator(mode="after")
    def _the_pump_can_keep_up(self) -> Self:
        if self.pump_period_s > 0.5 * self.pump_timeout_s:
            text = f"pump_period_s {self.pump_period_s:g}: allowed up to half of pump_timeout_s"
            raise ValueError(f"{text}, {0.5 * self.pump_timeout_s:g}")
        return self
