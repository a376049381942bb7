"""Interfaces of the devices as the cycle uses them. ``tests/contract`` tests each backend against them.

Life cycle of a device: ``open`` (connect, identify, make ready; may block), then any number of ``send``, ``read`` and
``poll`` (never block: they exchange newest samples with the device's own thread), ``stop`` and ``disable`` (bounded,
allowed in any state and more than once, never raise), ``close`` (the same). Time is bench time in s, always an
argument.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from hil.core import alarm_table as table
from hil.core.alarms import AlarmKind
from hil.core.messages import AXES_MAX, Array, AxisFeedback, IoInputs, IoOutputs, PoseFrame


@runtime_checkable
class AxisGroup(Protocol):
    """Position-controlled axes of one device, n of one to six, in m and m/s or rad and rad/s."""

    name: str
    axis_names: tuple[str, ...]

    def open(self, now_s: float) -> None:
        """Connect, check the identity, enable the drives, and hold the present position. Raises DeviceError."""

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed; returns at once.

        ``read`` reports the progress (AxisFeedback.homing). Setpoints are rejected until all axes are at DONE.
        """

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Set the next position and its rate; return the accepted position.

        The position is limited to the travel. Raises SafetyTrip for a value that is not finite, DeviceError once the
        link has failed.
        """

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest feedback. Raises LinkTimeout if it is too old, DeviceError on failure."""

    def stop(self, now_s: float) -> None:
        """Quick stop of all axes, which then hold. Idempotent, never raises."""

    def disable(self, now_s: float) -> None:
        """Switch the torque of all axes off until the next ``open``. Returns at once; idempotent, never raises.

        Drives that control holding brakes close them first. A device without such a command only stops.
        """

    def close(self) -> None:
        """Disconnect. Idempotent, never raises."""


@runtime_checkable
class Jogs(Protocol):
    """An axis group whose axes can be jogged when not homed or outside their travel."""

    def set_jogging(self, on: bool) -> None:
        """While on, accept setpoints for axes that are not homed, and do not limit them to the travel."""


@runtime_checkable
class LimitsSetpoints(Protocol):
    """An axis group whose axes catch up after a gap in the setpoints, as after a lost response."""

    def set_limits(self, rate: Array, acceleration: Array) -> None:
        """Set the limits (n,) of catching up, those of the present move; ``open`` sets the limits of the axes."""


@runtime_checkable
class Streams(Protocol):
    """An axis group whose drives interpolate between setpoints, over the time between them."""

    def set_period(self, period_s: float) -> None:
        """Expect a setpoint every ``period_s``, from the next ``open`` on."""


NO_TORQUE_LIMIT = "its driver cannot limit the torque: full torque"


@runtime_checkable
class LimitsTorque(Protocol):
    """An axis group that can let an axis move with little torque, as in the first move of commissioning."""

    def limit_torque(self, axis: int, reduced: bool) -> None:
        """Start to reduce the torque limit of ``axis`` of the group, or to restore it."""

    def torque_limit(self, axis: int) -> str:
        """Return what became of that, one line; "" before it is done."""


@runtime_checkable
class Describes(Protocol):
    """An axis group that reports what it uses of its drives."""

    def facts(self) -> list[str]:
        """Return the mode, units and watchdog of each opened drive, a line each."""


@runtime_checkable
class Parks(Protocol):
    """An axis group with profiled moves."""

    def move_to(self, position: Array, rate: Array, now_s: float) -> Array:
        """Move to position (n,) at most at rate (n,) and hold there; return the accepted goal.

        Returns at once, ``read`` reports the progress. Later setpoints are not passed on until the next ``open``:
        ``send`` returns the present position. Errors as for ``send``.
        """


@runtime_checkable
class CountsExchanges(Protocol):
    """An axis group that counts the feedback of its drives."""

    def exchanges(self) -> tuple[int, float]:
        """Return the number of samples of all axes since ``open``, and bench time of the newest, s."""


@runtime_checkable
class CountsPackets(Protocol):
    """A device that counts its exchanges and what went wrong in them."""

    def counters(self) -> dict[str, int]:
        """Return the counts since ``open`` by name; ``exchanges`` is one of them."""


@runtime_checkable
class CountsLosses(Protocol):
    """A device that counts lost packets."""

    def lost_packets(self) -> int:
        """Return how many packets were lost or damaged since ``open``."""


@runtime_checkable
class Exposes(Protocol):
    """A simulated vision unit, whose exposures between two ``poll`` are taken when it is called."""

    def expose(self, now_s: float) -> None:
        """Take the exposures up to bench time ``now_s``."""


@runtime_checkable
class PoseSource(Protocol):
    """The vision measurement unit."""

    name: str

    def open(self, now_s: float) -> None:
        """Connect. Raises DeviceError."""

    def poll(self, now_s: float) -> list[PoseFrame]:
        """Return the frames received since the last call, oldest first.

        Raises LinkTimeout if none was received for longer than the time-out, DeviceError on failure.
        """

    def counters(self) -> dict[str, int]:
        """Return the counters since ``open``: frames, crc_errors, skipped_bytes, lost, duplicates."""

    def close(self) -> None:
        """Disconnect. Idempotent, never raises."""


@runtime_checkable
class DiscreteIo(Protocol):
    """Digital lines: emergency stop, safety chain, charge pump, thrusters. Usable from any process and thread."""

    name: str

    def open(self, now_s: float) -> None:
        """Connect, check the identity, set all outputs off. Raises DeviceError."""

    def pulse(self, now_s: float) -> None:
        """Toggle the charge pump, at most once per its period; never raises.

        Without these calls the pump stops and the safety relay opens.
        """

    def write(self, outputs: IoOutputs, now_s: float) -> None:
        """Set the outputs; thruster lines that are not given are off. Raises DeviceError once the link has failed."""

    def read(self, now_s: float) -> IoInputs:
        """Return the newest inputs. Raises LinkTimeout if they are too old, DeviceError on failure."""

    def stop(self, now_s: float) -> None:
        """Set all outputs off for good: the safety relay opens. Bounded, idempotent, never raises."""

    def close(self) -> None:
        """Set the outputs off and disconnect. Idempotent, never raises."""


def full_names(device: str, short: Sequence[str]) -> tuple[str, ...]:
    """Return the axis names as used in errors: ``rails.x``, also of the part ``rails.x-y`` of ``rails``."""
    group = device.partition(".")[0]
    return tuple(f"{group}.{name}" for name in short)


_UNLIMITED = np.full(AXES_MAX, np.finfo(float).max)


def setpoint_bounds(low: Array, high: Array, jogging: bool) -> tuple[Array, Array]:
    """Return the bounds of setpoints, (n,) each: the travel, or any finite number while jogging."""
    return (-_UNLIMITED[: len(low)], _UNLIMITED[: len(low)]) if jogging else (low, high)


def accepted_setpoint(
    axis_names: tuple[str, ...], values: Array, low: Array, high: Array, kind: AlarmKind = table.SETPOINT
) -> Array:
    """Return ``values`` (n,) limited to [low, high]; raise SafetyTrip of ``kind`` if one is not finite."""
    numbers = values.tolist()
    if not math.isfinite(sum(numbers)):
        for name, value in zip(axis_names, numbers, strict=True):
            if not math.isfinite(value):
                raise kind.trip(name, str(value), "a finite number")
    accepted: Array = np.minimum(high, np.maximum(low, values))
    return accepted
