"""Safety I/O of the cycle: keeps the safety chain closed, reads the emergency stop, mirrors thrusters to lines."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

import numpy as np

from hil.core import alarm_table as table
from hil.core.messages import IoInputs, IoOutputs
from hil.drivers.base import DiscreteIo
from hil.errors import DeviceError, SafetyTrip
from hil.loop.rate_keeper import Rate
from hil.safety.monitor import not_enabled

CLOSING_TIME_S: Final = 1.0  # allowed from the first edge of enable until the relay closes
_READ_BACK_WALL_S: Final = 0.15  # of the chain after the relay has opened: relay, coupler, processes
_EDGE_PERIOD_S: Final = 0.2  # of the edges of enable
_PULSE_PERIOD_S: Final = 0.01


class SafetyIo:
    """Digital lines of the bench, as used by cycle and runner; those of a bench without any."""

    has_chain = False
    """Whether there is a safety chain, whose opening stops the bench."""
    thrusters_s = math.nan
    """Bench time at which the coupler received the present thruster lines, s; NaN if unknown."""

    def open(self, rate: Rate) -> None:
        """Connect and close the safety chain. Raises DeviceError, SafetyTrip."""

    def check(self, now_s: float) -> None:
        """Keep the chain closed by a pulse; raise SafetyTrip if it is open, DeviceError on failure."""

    def mirror_thrusters(self, now_s: float) -> None:
        """Write the thruster lines if they have changed."""

    def release_brakes(self, released: bool, now_s: float) -> None:
        """Release the holding brakes, or let them close. Never raises."""

    def brakes_closed(self, now_s: float) -> bool | None:
        """Return whether the holding brakes are closed; None if that is not read back, False if it cannot be read."""
        return None

    def warn(self, on: bool, now_s: float) -> None:
        """Switch the warning of motion on or off. Raises DeviceError once the link has failed."""

    def keep_closed(self, now_s: float) -> None:
        """Keep the chain closed by a pulse, without a check. Never raises."""

    def set_mirrored(self) -> IoOutputs:
        """Take the present thruster commands as mirrored, as a compiled loop has done; return the outputs."""
        return IoOutputs(False, b"")

    def stop(self, now_s: float) -> None:
        """Switch all lines off, which opens the chain. Never raises."""

    def close(self) -> None:
        """Close the link. Never raises."""


class SafetyIoStage(SafetyIo):
    """Digital lines of a bench with an I/O coupler.

    on: view of the thruster commands in COMMAND, integers 0 or 1, one per line. tested_pump_s: time-out of the safety
    relay for the charge pump, s of wall time, if each opening tests it.
    """

    has_chain = True

    def __init__(self, io: DiscreteIo, on: np.ndarray, tested_pump_s: float | None = None) -> None:
        self.io = io
        self._on = on
        self._tested_pump_s = tested_pump_s
        self._mirrored = on.tobytes()
        self._brakes_released = self._warning = False

    def open(self, rate: Rate) -> None:
        """Connect, and close the safety chain; the drives have no torque yet.

        If the relay's time-out is to be tested, the chain is opened by a pause of the charge pump, and closed again.
        """
        self._brakes_released = self._warning = False
        self.io.open(rate.now_s())
        self._close_chain(rate)
        if self._tested_pump_s is not None:
            self.test_pump(rate, self._tested_pump_s)
            self._close_chain(rate)

    def test_pump(self, rate: Rate, timeout_s: float) -> float:
        """Pause the charge pump and wait until the chain reads as open; return after how long, s of wall time.

        timeout_s: of the relay, s of wall time. Raises SafetyTrip if the chain is closed after it.
        """
        begun = time.monotonic()
        self.io.write(IoOutputs(True, self._lines(), pump=False), rate.now_s())
        while self.io.read(rate.now_s()).chain_closed:
            if time.monotonic() - begun > timeout_s + _READ_BACK_WALL_S:
                raise table.PUMP_TIMEOUT.trip(self.io.name, timeout_s + _READ_BACK_WALL_S, timeout_s)
            rate.wait()
        return time.monotonic() - begun

    def _close_chain(self, rate: Rate) -> None:
        """Send edges of enable until the relay closes, for at most ``CLOSING_TIME_S``."""
        now_s = start_s = rate.now_s()
        while not self._send_enable(now_s, enable=(now_s - start_s) % _EDGE_PERIOD_S < 0.5 * _EDGE_PERIOD_S):
            if now_s - start_s > CLOSING_TIME_S:
                raise table.SAFETY_CHAIN.trip(self.io.name, f"open {CLOSING_TIME_S:g} s after enable", "closed")
            now_s = rate.wait().now_s

    def _send_enable(self, now_s: float, enable: bool) -> bool:
        """Pulse the charge pump and set enable; return whether the chain is closed."""
        self.io.pulse(now_s)
        self.io.write(IoOutputs(enable, self._lines()), now_s)
        inputs = self.io.read(now_s)
        if not inputs.estop_closed or inputs.open_interlocks:
            raise self._trip(inputs)
        if inputs.local_enable is False:
            raise not_enabled(now_s).trip()
        return enable and inputs.chain_closed

    def check(self, now_s: float) -> None:
        """Pulse the charge pump; raise SafetyTrip if an interlock or the relay has removed the drives' torque.

        An emergency stop, which also opens the relay, is reported by the safety monitor (``emergency_input``).
        """
        self.io.pulse(now_s)
        inputs = self.io.read(now_s)
        self.thrusters_s = inputs.thrusters_s
        if inputs.estop_closed and (not inputs.chain_closed or inputs.open_interlocks):
            raise self._trip(inputs)

    def emergency_input(self, now_s: float) -> tuple[bool | None, bool]:
        """Return whether the emergency stop is pressed, and False: the coupler has no reset input."""
        return not self.io.read(now_s).estop_closed, False

    def local_enable(self, now_s: float) -> bool:
        """Return whether the switch at the bench permits power and motion; True if the bench has none."""
        return self.io.read(now_s).local_enable is not False

    def mirror_thrusters(self, now_s: float) -> None:
        if self._on.tobytes() != self._mirrored:
            self._mirrored = self._on.tobytes()
            self.io.write(self._outputs(), now_s)

    def release_brakes(self, released: bool, now_s: float) -> None:
        self._brakes_released = released
        with suppress(DeviceError):  # without the coupler the relay opens, and the brakes close
            self.io.write(self._outputs(), now_s)

    def warn(self, on: bool, now_s: float) -> None:
        self._warning = on
        self.io.write(self._outputs(), now_s)

    def brakes_closed(self, now_s: float) -> bool | None:
        try:
            return self.io.read(now_s).brakes_closed
        except DeviceError:
            return False

    def keep_closed(self, now_s: float) -> None:
        self.io.pulse(now_s)

    @property
    def thruster_lines(self) -> int:
        """Number of thrusters that are mirrored."""
        return len(self._on)

    def set_mirrored(self) -> IoOutputs:
        self._mirrored = self._on.tobytes()
        return IoOutputs(True, self._lines())

    def stop(self, now_s: float) -> None:
        self.io.stop(now_s)

    def close(self) -> None:
        self.io.close()

    def _outputs(self) -> IoOutputs:
        return IoOutputs(True, self._lines(), self._brakes_released, warning=self._warning)

    def _lines(self) -> bytes:
        return self._on.astype(np.uint8).tobytes()

    def _trip(self, inputs: IoInputs) -> SafetyTrip:
        if not inputs.estop_closed:
            return table.EMERGENCY_STOP.trip(self.io.name, "pressed", "released")
        for name in inputs.open_interlocks:
            return table.INTERLOCK.trip(self.io.name, "open", "closed", name)
        return table.SAFETY_CHAIN.trip(self.io.name, "open", "closed")


@contextmanager
def chain_kept_closed(lines: SafetyIo, rate: Rate) -> Iterator[None]:
    """Pulse the charge pump from a thread while the body blocks, e.g. while devices open or stop.

    For callers that own the lines; in a run the watchdog process pulses. No operation in simulated time, which does
    not advance meanwhile.
    """
    if not (isinstance(lines, SafetyIoStage) and rate.paced):
        yield
        return
    ended = threading.Event()

    def pulse() -> None:
        while not ended.wait(_PULSE_PERIOD_S):
            lines.io.pulse(rate.now_s())

    thread = threading.Thread(target=pulse, name="charge-pump", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
