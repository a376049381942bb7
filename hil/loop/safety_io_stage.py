"""The safety chain in the cycle: keeps it closed, looks at the emergency stop, mirrors the thrusters to lines."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Protocol

import numpy as np

from hil.core.messages import IoInputs, IoOutputs
from hil.drivers.base import DiscreteIo
from hil.errors import SafetyTrip
from hil.loop.rate_keeper import Rate

CLOSING_TIME_S: Final = 1.0  # from the first edge of enable until the relay must have closed
_EDGE_EACH_S: Final = 0.2  # a new edge of enable is offered
_PULSE_S: Final = 0.01


class SafetyIo(Protocol):
    """What the cycle and the runner know of the bench's digital lines."""

    def open(self, rate: Rate) -> None:
        """Connect and close the safety chain. Raises DeviceError, SafetyTrip."""

    thrusters_s: float
    """When the coupler was given the thrusters' lines as they are, s of bench time; NaN where nothing tells."""

    def check(self, now_s: float) -> None:
        """Keep the chain closed for another moment; raise SafetyTrip where it is not, DeviceError on failure."""

    def mirror(self, now_s: float) -> None:
        """Bring the thrusters' lines up to date."""

    def stop(self, now_s: float) -> None:
        """Set all lines off: the chain opens. Never raises."""

    def close(self) -> None:
        """Let go of the wire. Never raises."""


class NoSafetyIo:
    """A bench without digital lines."""

    thrusters_s = math.nan

    def open(self, rate: Rate) -> None: ...

    def check(self, now_s: float) -> None: ...

    def mirror(self, now_s: float) -> None: ...

    def stop(self, now_s: float) -> None: ...

    def close(self) -> None: ...


class SafetyIoStage:
    """Digital lines of a bench that has them.

    on: view of the thrusters in COMMAND, whole numbers 0 or 1, one for each line.
    """

    def __init__(self, io: DiscreteIo, on: np.ndarray) -> None:
        self.io = io
        self._on = on
        self._mirrored = on.tobytes()
        self.thrusters_s = math.nan

    def open(self, rate: Rate) -> None:
        """Connect, then offer the relay edges of enable until it closes, ``CLOSING_TIME_S`` at most."""
        self.io.open(rate.now_s())
        now_s = start_s = rate.now_s()
        while not self._offer(now_s, enable=(now_s - start_s) % _EDGE_EACH_S < 0.5 * _EDGE_EACH_S):
            if now_s - start_s > CLOSING_TIME_S:
                raise SafetyTrip(self.io.name, "safety chain", f"open {CLOSING_TIME_S:g} s after enable", "closed")
            now_s = rate.wait().now_s

    def _offer(self, now_s: float, enable: bool) -> bool:
        """Pulse and set enable; return whether the chain is closed."""
        self.io.pulse(now_s)
        self.io.write(IoOutputs(enable, self._lines()), now_s)
        inputs = self.io.read(now_s)
        if not inputs.estop_closed or inputs.open_interlocks:
            raise self._trip(inputs)
        return enable and inputs.chain_closed

    def check(self, now_s: float) -> None:
        """Pulse the charge pump; raise SafetyTrip when interlock or relay say that the drives have no torque.

        An emergency stop, which opens the relay too, is for the supervisor to tell (``emergency_input``).
        """
        self.io.pulse(now_s)
        inputs = self.io.read(now_s)
        self.thrusters_s = inputs.thrusters_s
        if inputs.estop_closed and (not inputs.chain_closed or inputs.open_interlocks):
            raise self._trip(inputs)

    def emergency_input(self, now_s: float) -> tuple[bool | None, bool]:
        """Return whether the emergency stop is pressed, and the level of a reset input, of which there is none."""
        return not self.io.read(now_s).estop_closed, False

    def mirror(self, now_s: float) -> None:
        """Hand over the thrusters' lines where one has changed."""
        if self._on.tobytes() != self._mirrored:
            self._mirrored = self._on.tobytes()
            self.io.write(IoOutputs(True, self._lines()), now_s)

    def stop(self, now_s: float) -> None:
        """Set all lines off."""
        self.io.stop(now_s)

    def close(self) -> None:
        """Let go of the wire."""
        self.io.close()

    def _lines(self) -> bytes:
        return self._on.astype(np.uint8).tobytes()

    def _trip(self, inputs: IoInputs) -> SafetyTrip:
        if not inputs.estop_closed:
            return SafetyTrip(self.io.name, "emergency stop", "pressed", "released")
        for name in inputs.open_interlocks:
            return SafetyTrip(self.io.name, f"interlock {name}", "open", "closed")
        return SafetyTrip(self.io.name, "safety chain", "open", "closed")


@contextmanager
def chain_kept_closed(lines: SafetyIo, rate: Rate) -> Iterator[None]:
    """Pulse the charge pump from a thread while the body blocks: devices take their time to open and to stop.

    For whoever holds the lines itself; in a run the watchdog process pulses. Only on the wall: in simulated time
    no time passes meanwhile.
    """
    if not (isinstance(lines, SafetyIoStage) and rate.on_the_wall):
        yield
        return
    ended = threading.Event()

    def pulse() -> None:
        while not ended.wait(_PULSE_S):
            lines.io.pulse(rate.now_s())

    thread = threading.Thread(target=pulse, name="charge-pump", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
