"""Mock of the coupler, in simulated time, with the safety relay."""

from __future__ import annotations

import math
from collections.abc import Callable

from hil.config.tables.io import Io
from hil.core.messages import IoInputs, IoOutputs
from hil.drivers.io import NAME
from hil.drivers.io.relay import HoldingBrakes, SafetyRelay
from hil.errors import DeviceError, LinkLost

_OFF = IoOutputs(False, b"")


class MockIo:
    """DiscreteIo without a wire. ``pressed`` and ``open_interlocks``: emergency stop and interlocks, set by tests.

    brakes_stick: the holding brakes do not close. local_enable: the switch at the bench permits power and motion.
    """

    def __init__(self, config: Io) -> None:
        self.name = NAME
        self.pressed = False
        self.open_interlocks: tuple[str, ...] = ()
        self.brakes_stick = False
        self.local_enable = True
        self.fire: Callable[[bytes, float], None] = lambda lines, now_s: None
        """Receives the thruster lines that have power, through the relay's contacts, and bench time."""
        self._reads_local_enable = config.inputs.local_enable is not None
        self._torque_delay_s = config.torque_delay_s
        self._reads_brakes = config.inputs.brakes_closed is not None
        self.outputs = _OFF
        self._period_s = config.pump_period_s
        self._pump_timeout_s = config.pump_timeout_s
        self._thrusters_s = math.nan
        self._error: DeviceError | None = LinkLost(NAME, "is not open")

    def open(self, now_s: float) -> None:
        """Start with all outputs off."""
        self._relay = SafetyRelay(self._pump_timeout_s, self._torque_delay_s)
        self._brakes = HoldingBrakes(0.5 * self._torque_delay_s)
        self._pump = False
        self._toggled_s = now_s - self._period_s
        self.outputs = _OFF
        self._error = None

    def pulse(self, now_s: float) -> None:
        """Toggle the charge pump, unless it was toggled within the pump's period."""
        if self._error is None and self.outputs.pump and now_s - self._toggled_s >= self._period_s:
            self._pump = not self._pump
            self._toggled_s = now_s
            self._advance(now_s)

    def write(self, outputs: IoOutputs, now_s: float) -> None:
        """Set the outputs."""
        self._check()
        if outputs.thrusters != self.outputs.thrusters:
            self._thrusters_s = now_s
        self.outputs = outputs
        self._advance(now_s)

    def set_outputs(self, outputs: IoOutputs, thrusters_s: float) -> None:
        """Take over ``outputs`` of a compiled loop, whose thruster lines have changed at ``thrusters_s``."""
        self.outputs = outputs
        self._thrusters_s = thrusters_s

    def read(self, now_s: float) -> IoInputs:
        """Return the inputs at ``now_s``."""
        self._check()
        closed = self._advance(now_s)
        brakes = self._brakes.update(now_s, self.brakes_stick or (closed and self.outputs.brakes_released))
        brakes_closed = brakes if self._reads_brakes else None
        local_enable = self.local_enable if self._reads_local_enable else None
        return IoInputs(
            now_s, not self.pressed, closed, self.open_interlocks, self._thrusters_s, brakes_closed, local_enable
        )

    def stop(self, now_s: float) -> None:
        """Set all outputs off for good."""
        if self._error is None:
            self.outputs = _OFF
            self._advance(now_s)

    def close(self) -> None:
        """Disconnect: the outputs of a coupler without a client are off."""
        self.outputs = _OFF
        self._error = LinkLost(NAME, "is closed")

    def fail(self, error: DeviceError) -> None:
        """Make later ``write`` and ``read`` raise ``error``, as after a failure of the link."""
        self._error = error

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _advance(self, now_s: float) -> bool:
        contacts_closed = not (self.pressed or self.open_interlocks)
        closed = self._relay.update(now_s, self._pump, self.outputs.enable, contacts_closed, self.local_enable)
        self.fire(self.outputs.thrusters if closed else b"", now_s)
        return closed
