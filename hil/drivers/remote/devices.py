"""Devices that other processes serve, for the loop: AxisGroup, PoseSource and DiscreteIo over shared memory."""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable, Sequence

import numpy as np

from hil.config.rig import AxisGroupTable, Vmu
from hil.config.tables.io import Io
from hil.core.clock import BenchClock
from hil.core.messages import Array, AxisFeedback, IoInputs, IoOutputs, PoseFrame
from hil.drivers.axes import SetpointLimits
from hil.drivers.remote import io_layout
from hil.drivers.remote.io_layout import IoSharedMemory
from hil.drivers.remote.requests import IoRequests
from hil.errors import DeviceError, LinkLost, LinkTimeout

log = logging.getLogger("hil")
SILENCE_MAX_S = 0.1
"""Wall time without a heartbeat of the serving process after which its devices count as lost."""
_BEAT_WALL_S = 0.004  # between two heartbeats, and two looks at that of the process: a cycle may be shorter
_CLOSE_WALL_S = 1.0
_LOSSES = ("lost", "retries", "crc_errors", "protocol_errors")


class IoLink:
    """Link to a serving process, shared by its devices: memory, requests and heartbeat.

    name: IO or WATCHDOG. end_text: returns how the process ended and why, "" while it runs. plug_ins: devices whose
    drivers in the process are of other packages.
    """

    def __init__(
        self,
        name: str,
        memory: IoSharedMemory,
        requests: IoRequests,
        clock: BenchClock,
        end_text: Callable[[], str],
        plug_ins: Sequence[str] = (),
    ) -> None:
        self.memory = memory
        self.requests = requests
        self.clock = clock
        self._name = name
        self._end_text = end_text
        self._plug_ins = list(plug_ins)
        self._heartbeat = np.zeros(1, io_layout.HEARTBEAT)
        self._beat_s = _BEAT_WALL_S * clock.speed
        self._sent_s = self._checked_s = -math.inf
        self._watched = False

    def beat(self, now_s: float, watched: bool) -> None:
        """Send the loop's heartbeat; watched: the next one is due, and its absence stops the bench."""
        if now_s - self._sent_s < self._beat_s and watched == self._watched:
            return
        self._sent_s, self._watched = now_s, watched
        self._heartbeat["watched"] = watched
        self.memory.block[io_layout.LOOP].write(self._heartbeat, now_s)

    def check(self, device: str, now_s: float) -> None:
        """Raise LinkLost for ``device`` if its process has ended or is silent."""
        if now_s - self._checked_s < self._beat_s:
            return
        if ended := self._end_text():
            raise self._lost(device, ended)
        _, beat_s = self.memory.block[self._name].read(self._heartbeat)
        age_s = (now_s - beat_s) / self.clock.speed
        if age_s > SILENCE_MAX_S:
            raise self._lost(device, f"has been silent for {age_s:.3f} s, allowed {SILENCE_MAX_S:g} s")
        self._checked_s = now_s

    def _lost(self, device: str, what: str) -> LinkLost:
        """Return the error of a lost process: of the device whose driver it was calling, otherwise of ``device``."""
        calls = self.memory.calls_of(self._name)
        if calls:
            device, _, called = calls[-1].partition(" ")
            return LinkLost(device, f"{self._name} process {what}, calling {called}")
        if self._plug_ins and device not in self._plug_ins:
            device = self._plug_ins[0]
        return LinkLost(device, f"{self._name} process {what}")

    def wake(self) -> None:
        """Let the process start its next period at once."""
        self.clock.wake(self._name, self.memory.wakes[self._name])


class _RemoteDevice:
    """Common part of all remote devices."""

    def __init__(self, name: str, link: IoLink) -> None:
        self.name = name
        self._link = link
        self._block = link.memory.block
        self._failure = self._block[f"{name}.failure"]
        self._failures_before = 0
        self._record = np.zeros(1, io_layout.FAILURE)
        self._is_open = False

    def _open(self, now_s: float) -> None:
        self._failures_before = self._failure.read(self._record)[0]
        answer = self._link.requests.request("open", self.name)
        if "failure" in answer:
            self._record[0] = tuple(field.encode() for field in answer["failure"])
            raise io_layout.failure_of(self._record)
        self._is_open = True

    def _check(self, now_s: float) -> None:
        if not self._is_open:
            raise LinkLost(self.name, "is not open")
        if self._failure.written > self._failures_before:
            self._failure.read(self._record)
            raise io_layout.failure_of(self._record)
        self._link.check(self.name, now_s)

    def counters(self) -> dict[str, int]:
        """Return the driver's counts since ``open``, some 0.1 s old."""
        record = np.zeros(1, io_layout.COUNTERS)
        self._block[f"{self.name}.counters"].read(record)
        return io_layout.counters_of(record)

    def lost_packets(self) -> int:
        """Return the number of packets lost or damaged since ``open``."""
        counters = self.counters()
        return sum(counters.get(name, 0) for name in _LOSSES)

    def close(self) -> None:
        """Let the serving process close the device. Idempotent, never raises."""
        if not self._is_open:
            return
        self._is_open = False
        with contextlib.suppress(DeviceError):
            self._link.check(self.name, self._link.clock.now_s())
            if failure := self._link.requests.request("close", self.name, _CLOSE_WALL_S).get("failure"):
                log.error("%s: %s", *failure[1:3])


class RemoteAxes(_RemoteDevice):
    """Axes of one group in the I/O process. ``read`` sends the loop's heartbeat: call it in every cycle.

    When the heartbeat ceases, the I/O process stops the axes. wakes: whether a setpoint wakes that process; False for a
    device whose setpoint is followed by another one's.
    """

    def __init__(self, name: str, config: AxisGroupTable, link: IoLink, wakes: bool = True) -> None:
        super().__init__(name, link)
        self._wakes = wakes
        self._limits = SetpointLimits(name, config)
        self.axis_names = self._limits.names
        self._timeout_s = config.timeout_s
        self._setpoint = np.zeros(1, io_layout.setpoint_record(len(self.axis_names)))
        self._feedback = np.zeros(1, io_layout.feedback_record(len(self.axis_names)))
        self._stop = np.zeros(1, io_layout.STOP)
        self._newest: AxisFeedback | None = None
        self._received = self._feedback_before = 0
        self._stopped = self._disabled = False
        self._kind = io_layout.CYCLIC

    def open(self, now_s: float) -> None:
        """Let the I/O process open the device; the axes hold their position. Raises DeviceError."""
        self.close()
        self._link.beat(now_s, watched=False)
        self._received = self._feedback_before = self._block[f"{self.name}.feedback"].read(self._feedback)[0]
        self._stopped = self._disabled = False
        self._kind = io_layout.CYCLIC
        self.set_limits(self._limits.rate_max, self._limits.acceleration_max)
        self._open(now_s)

    def home(self, now_s: float) -> None:
        """Start homing in the I/O process. Raises DeviceError."""
        self._check(now_s)
        self._link.requests.request("home", self.name)

    def limit_torque(self, axis: int, reduced: bool) -> None:
        """Let the I/O process start to reduce the torque limit of ``axis``, or to restore it. Raises DeviceError."""
        self._link.requests.request("torque", self.name, axis=axis, reduced=reduced)

    def torque_limit(self, axis: int) -> str:
        """Return what became of that, "" before it is done. Raises DeviceError."""
        return str(self._link.requests.request("torque", self.name, axis=axis).get("torque", ""))

    def set_limits(self, rate: Array, acceleration: Array) -> None:
        """Set the limits (n,) within which the axes catch up after a gap in the setpoints."""
        self._setpoint["rate_max"], self._setpoint["acceleration_max"] = rate, acceleration

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Send the newest setpoint; return the accepted position, or the measured one if the device is stopped."""
        self._check(now_s)
        accepted, accepted_rate = self._limits.accepted(position, rate, self._kind == io_layout.JOGGED)
        if self._stopped or self._kind == io_layout.GOAL:
            return np.array(self._feedback["position"][0])
        self._write_setpoint(accepted, accepted_rate, now_s)
        return accepted

    def _write_setpoint(self, position: Array, rate: Array, now_s: float) -> None:
        self._setpoint["position"], self._setpoint["rate"] = position, rate
        self._setpoint["kind"] = self._kind
        self._block[f"{self.name}.setpoint"].write(self._setpoint, now_s)
        if self._wakes:
            self._link.wake()

    def set_jogging(self, on: bool) -> None:
        """While on, accept setpoints of axes that are not homed, without the limits of the travel."""
        self._kind = io_layout.JOGGED if on else io_layout.CYCLIC

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest feedback. Raises LinkTimeout when it is older than ``timeout_s``."""
        if self._is_open:  # also while the device reports a failure: the loop is alive
            self._link.beat(now_s, watched=not self._disabled)
        self._check(now_s)
        box = self._block[f"{self.name}.feedback"]
        if box.written > self._received:
            self._received, _ = box.read(self._feedback)
            self._newest = io_layout.read_feedback(self._feedback)
        if self._newest is None or self._received <= self._feedback_before:
            raise LinkTimeout(self.name, "has not answered yet")
        age_s = now_s - self._newest.t_s
        if age_s > self._timeout_s:
            raise LinkTimeout(self.name, f"no answer for {age_s:.3f} s, allowed {self._timeout_s:g} s")
        return self._newest

    def exchanges(self) -> tuple[int, float]:
        """Return the number of samples since ``open``, and bench time of the newest, s, at the last ``read``."""
        return self._received - self._feedback_before, 0.0 if self._newest is None else self._newest.t_s

    def stop(self, now_s: float) -> None:
        """Order the quick stop through the shared memory, without waiting; idempotent, never raises."""
        if self._stopped or not self._is_open:
            return
        self._stopped = True
        self._order(io_layout.QUICK_STOP, now_s)

    def disable(self, now_s: float) -> None:
        """Order that the torque is switched off, without waiting; the heartbeat is not due any more."""
        if self._disabled or not self._is_open:
            return
        self._stopped = self._disabled = True
        self._link.beat(now_s, watched=False)
        self._order(io_layout.DISABLE, now_s)

    def _order(self, kind: int, now_s: float) -> None:
        self._stop["number"] += 1
        self._stop["kind"] = kind
        self._block[f"{self.name}.stop"].write(self._stop, now_s)
        self._link.wake()


class RemoteTurntable(RemoteAxes):
    """A turntable in the I/O process; its drives move to the parking position in their own profile."""

    def move_to(self, position: Array, rate: Array, now_s: float) -> Array:
        """Move the axes to position (3,), rad, at most at rate (3,), rad/s; return the accepted goal."""
        self._check(now_s)
        goal, speed = self._limits.accepted_goal(position, rate)
        if not self._stopped:
            self._kind = io_layout.GOAL
            self._write_setpoint(goal, speed, now_s)
        return goal


class RemotePoses(_RemoteDevice):
    """The vision unit in the I/O process."""

    def __init__(self, config: Vmu, link: IoLink) -> None:
        super().__init__("vmu", link)
        self._frames = link.memory.frames.reader(from_now=True)

    def open(self, now_s: float) -> None:
        """Let the I/O process open the unit. Raises DeviceError."""
        self.close()
        self._frames = self._link.memory.frames.reader(from_now=True)
        self._open(now_s)

    def poll(self, now_s: float) -> list[PoseFrame]:
        """Return the frames received since the last call, oldest first. Raises DeviceError."""
        self._check(now_s)
        return [PoseFrame.from_record(record) for record in self._frames.read()]


class RemoteIo(_RemoteDevice):
    """The digital I/O in the watchdog process, which pulses the charge pump while all heartbeats continue."""

    def __init__(self, config: Io, link: IoLink) -> None:
        super().__init__("io", link)
        self._timeout_s = config.timeout_s
        self._inputs = np.zeros(1, io_layout.INPUTS)
        self._received = 0
        self._newest = io_layout.read_inputs(self._inputs)
        self._stop = np.zeros(1, io_layout.STOP)

    def open(self, now_s: float) -> None:
        """Let the watchdog open the coupler, all outputs off. Raises DeviceError."""
        self.close()
        self._open(now_s)

    def pulse(self, now_s: float) -> None:
        """Do nothing: the watchdog pulses while it receives the loop's heartbeat."""

    def write(self, outputs: IoOutputs, now_s: float) -> None:
        """Send the outputs. Raises DeviceError once the link has failed."""
        self._check(now_s)
        self._block["io.outputs"].write(io_layout.outputs_record(outputs), now_s)
        self._link.wake()

    def read(self, now_s: float) -> IoInputs:
        """Return the newest inputs. Raises LinkTimeout when they are too old, DeviceError on failure."""
        self._check(now_s)
        box = self._block["io.inputs"]
        if box.written != self._received:
            self._received, _ = box.read(self._inputs)
            self._newest = io_layout.read_inputs(self._inputs)
        inputs = self._newest
        age_s = now_s - inputs.t_s
        if age_s > self._timeout_s:
            raise LinkTimeout(self.name, f"no answer for {age_s:.3f} s, allowed {self._timeout_s:g} s")
        return inputs

    def stop(self, now_s: float) -> None:
        """Let the watchdog set all outputs off, without waiting; idempotent, never raises."""
        if self._is_open:
            self._stop["number"] += 1
            self._stop["kind"] = io_layout.QUICK_STOP
            self._block["io.stop"].write(self._stop, now_s)
            self._link.wake()
