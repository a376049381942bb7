"""What the cycle knows of a device. Every backend keeps these promises; ``tests/contract`` holds them to it.

Life of a device: ``open`` (connect, identify, make ready; may block), then any number of ``send`` /
``read`` / ``poll`` (never block: they hand over to and take from the newest-sample box of the
device's own thread), ``stop`` (bounded, may be called in any state and more than once, never
raises), ``close`` (the same). Time is bench time in seconds and is always handed in.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from hil.core.messages import Array, AxisFeedback, IoInputs, IoOutputs, PoseFrame
from hil.errors import SafetyTrip
from hil.maths.limits import cut_to_range


@runtime_checkable
class AxisGroup(Protocol):
    """Three position-controlled axes of one device: rails (m, m/s) or turntable (rad, rad/s)."""

    name: str
    axis_names: tuple[str, str, str]

    def open(self, now_s: float) -> None:
        """Connect, check the identity, enable the drives, and hold the present position. Raises DeviceError."""

    def home(self, now_s: float) -> None:
        """Let each axis that does not know its place look for its home switch; returns at once.

        ``read`` tells how far it is (AxisFeedback.homing). Setpoints are refused until all are at DONE.
        """

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Give the drives their next position and its rate; return the position that was accepted.

        What lies outside an axis' travel is cut to it. Raises SafetyTrip for a number that is not
        finite, DeviceError once the link has failed.
        """

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest feedback. Raises LinkTimeout when it is too old, DeviceError on failure."""

    def stop(self, now_s: float) -> None:
        """Bring all axes to a stand and keep them there: quick stop. Idempotent, never raises."""

    def close(self) -> None:
        """Let go of the wire. Idempotent, never raises."""


@runtime_checkable
class Jogs(Protocol):
    """An axis group that lets an axis be jogged that is not homed, or that stands beyond its travel."""

    def set_jogging(self, on: bool) -> None:
        """While on, take setpoints of axes that are not homed, and cut none to the travel."""


@runtime_checkable
class Parks(Protocol):
    """An axis group whose drives go to a place by profiles of their own."""

    def move_to(self, position: Array, rate: Array, now_s: float) -> Array:
        """Let the axes go to position (3,) and stand there, at most at rate (3,); return the goal that was accepted.

        Returns at once, ``read`` tells how far they are. Later setpoints are not passed on until the next
        ``open``: ``send`` returns where the axes stand. Errors as for ``send``.
        """


@runtime_checkable
class CountsLosses(Protocol):
    """A device whose wire counts what it lost."""

    def lost_packets(self) -> int:
        """Return how many packets were lost or damaged since ``open``."""


@runtime_checkable
class PoseSource(Protocol):
    """The vision measurement unit."""

    name: str

    def open(self, now_s: float) -> None:
        """Connect. Raises DeviceError."""

    def poll(self, now_s: float) -> list[PoseFrame]:
        """Return the frames that came since the last call, oldest first.

        Raises LinkTimeout when the unit has been silent for longer than its time-out, DeviceError
        on failure.
        """

    def counters(self) -> dict[str, int]:
        """Return what was counted since ``open``: frames, crc_errors, skipped_bytes, lost, duplicates."""

    def close(self) -> None:
        """Let go of the wire. Idempotent, never raises."""


@runtime_checkable
class DiscreteIo(Protocol):
    """Digital lines: emergency stop, safety chain, charge pump, thrusters. Usable from any process and thread."""

    name: str

    def open(self, now_s: float) -> None:
        """Connect, check the identity, set all outputs off. Raises DeviceError."""

    def pulse(self, now_s: float) -> None:
        """Say that whoever watches the bench is alive: the charge pump toggles, at its own period at most.

        Without these calls the pump stops and the safety relay opens. Never raises.
        """

    def write(self, outputs: IoOutputs, now_s: float) -> None:
        """Hand over the outputs; thruster lines beyond those given are off. Raises DeviceError once the link failed."""

    def read(self, now_s: float) -> IoInputs:
        """Return the newest inputs. Raises LinkTimeout when they are too old, DeviceError on failure."""

    def stop(self, now_s: float) -> None:
        """Set all outputs off and keep them off: the safety relay opens. Bounded, idempotent, never raises."""

    def close(self) -> None:
        """Let go of the wire, outputs off. Idempotent, never raises."""


def full_names(device: str, short: tuple[str, str, str]) -> tuple[str, str, str]:
    """Return the axis names as errors show them: ``rails.x``."""
    return (f"{device}.{short[0]}", f"{device}.{short[1]}", f"{device}.{short[2]}")


_UNLIMITED = np.full(3, np.finfo(float).max)


def setpoint_bounds(low: Array, high: Array, jogging: bool) -> tuple[Array, Array]:
    """Return the bounds of setpoints, (3,) each: the travel, or any finite number while jogging."""
    return (-_UNLIMITED, _UNLIMITED) if jogging else (low, high)


def accepted_setpoint(
    axis_names: tuple[str, str, str], values: Array, low: Array, high: Array, quantity: str = "setpoint"
) -> Array:
    """Return ``values`` (3,) cut to [low, high]; raise SafetyTrip, naming ``quantity``, where one is not finite."""
    accepted = np.empty(3)
    bad = cut_to_range(values, low, high, accepted)
    if bad >= 0:
        raise SafetyTrip(axis_names[bad], quantity, str(values[bad]), "a finite number")
    return accepted
