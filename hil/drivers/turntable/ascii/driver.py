"""Driver of a turntable controller with an ASCII protocol on a serial line."""

from __future__ import annotations

import contextlib
from math import fsum
from typing import Final

import numpy as np

from hil.config.load import load_protocol
from hil.config.protocol import Protocol
from hil.config.rig import AsciiTurntableLine, Turntable
from hil.core.clock import BenchClock
from hil.core.messages import Array, AxisFeedback, Homing
from hil.drivers.base import full_names
from hil.drivers.cyclic_exchange import CyclicAxisGroup
from hil.drivers.turntable.ascii.link import BURST, REPLY_S, AsciiTransport
from hil.drivers.turntable.ascii.protocol import DEVICE, AsciiCommand, AsciiProtocol, CommandRefused, FieldValues
from hil.errors import BadInput, BenchError, DeviceError, DriveFault, LinkTimeout, ProtocolError

_SET_UP_WALL_S: Final = 2.0
_REPLY_WALL_S: Final = 0.3  # set-up: wall time that one reply may take
_POLL_WALL_S: Final = 0.005


class AsciiLink:
    """Exchange link to the controller; each exchange sets all axes and reads their reports.

    Feedback is stamped with the bench time at which the requests reach the controller, with their mean if each axis
    has its own.
    """

    has_profiles = False
    jogging = False

    def __init__(self, device: str, config: Turntable, line: AsciiTurntableLine, clock: BenchClock) -> None:
        self.device = device
        self.axis_names = full_names(device, config.axis_names)
        loaded = load_protocol(line.protocol)
        self._protocol: Protocol = loaded.value
        self._bits = self._protocol.bits
        self._ascii = AsciiProtocol(self._protocol)
        self._identity = line.identity
        self._clock = clock
        self._wire = AsciiTransport(device, str(line.port), line.baud, config.timeout_s, self._ascii, clock)
        encoders = [axis.encoder for axis in config.axes]
        self._needs_home = [encoder == "incremental" for encoder in encoders]
        if any(self._needs_home) and not self._protocol.requests.home:
            axis = config.axis_names[self._needs_home.index(True)]
            text = f'"incremental": protocol {self._protocol.name} ({loaded.source}) has no requests.home'
            raise BadInput.single("rig", f"turntable.{axis}.encoder", text)
        self._unanswered, self._unanswered_axis = self._ascii.lines["status"][0], DEVICE
        self._reset()

    def _reset(self) -> None:
        self._stopped = False
        self._homing_started = [False] * len(self.axis_names)
        self._homing = [Homing.NEEDED if needed else Homing.DONE for needed in self._needs_home]
        self._previous: tuple[float, Array] | None = None

    def open(self) -> AxisFeedback:
        """Identify the controller, stop and enable the axes; return their positions."""
        self._wire.open()
        self._reset()
        try:
            return self._set_up()
        except BenchError:
            self._send_quick_stop()
            self.close()
            raise

    def _set_up(self) -> AxisFeedback:
        if self._protocol.requests.identify:
            self._check_identity(self._insist("identify")[1])
        end_s = self._clock.host_s() + _SET_UP_WALL_S
        self._insist("quick_stop")
        while self._is_moving(self._insist("status")[1]):
            if self._clock.host_s() > end_s:
                raise LinkTimeout(self.device, f"axes do not come to a stand within {_SET_UP_WALL_S:g} s")
            self._clock.sleep(_POLL_WALL_S)
        if self._protocol.requests.clear_faults:
            self._insist("clear_faults")
        refused = self._try_to_enable()
        sampled_s, report = self._insist("status")
        self._check(report)
        if refused is not None:
            raise ProtocolError(self.device, f"refuses to be enabled: {refused}")
        self._wire.restart_timeout()
        return self._feedback(sampled_s, report)

    def _try_to_enable(self) -> str | None:
        """Enable; return the reason if the controller refuses: the status then gives the axis in fault."""
        self._stopped = False
        try:
            self._insist("enable")
        except ProtocolError as error:
            if isinstance(error.__cause__, CommandRefused):
                return error.__cause__.text
            raise
        return None

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Send the setpoint and read the report; after ``quick_stop`` and before homing read the report only."""
        values: FieldValues = {}
        for axis in range(len(self.axis_names)):
            values["position", axis] = float(position[axis])
            values["rate", axis] = float(rate[axis])
        passive = self._stopped or not (self.jogging or all(state is Homing.DONE for state in self._homing))
        self._wire.counts["exchanges"] += 1
        reply = self._perform("status", {}) if passive else self._perform("set", values)
        if reply is not None and not passive and not self._ascii.set_reports_all:
            reply = self._perform("status", {})
        if reply is None:
            self._wire.check_silence()
            return None
        sampled_s, report = reply
        self._check(report)
        return self._feedback(sampled_s, report)

    def home(self) -> None:
        """Start homing of each axis that is not homed."""
        for line in self._ascii.lines.get("home", []):
            for axis in line.axes:
                if axis == DEVICE or self._homing[axis] is not Homing.DONE:
                    self._insist_on_line(line, axis)
        for axis in range(len(self.axis_names)):
            if self._homing[axis] is not Homing.DONE:
                self._homing[axis] = Homing.UNDER_WAY
                self._homing_started[axis] = True

    def _insist_on_line(self, line: AsciiCommand, axis: int) -> None:
        for _ in range(BURST):
            if self._request(line, axis, {}) is not None:
                return
        raise LinkTimeout(self._name(axis), f"does not answer {line.send.text!r}")

    def _name(self, axis: int) -> str:
        return self.device if axis == DEVICE else self.axis_names[axis]

    def _request(
        self, line: AsciiCommand, axis: int, values: FieldValues, reply_s: float = REPLY_S
    ) -> tuple[float, FieldValues] | None:
        try:
            return self._wire.request(line, axis, values, reply_s, patient=line.action != "quick_stop")
        except CommandRefused as refused:
            raise ProtocolError(self._name(axis), f"refuses {line.send.text!r}: {refused.text}") from refused

    def move_to(self, position: Array, rate: Array) -> None:
        """Never called: the controller has no profiles."""

    def quick_stop(self) -> None:
        """Send the quick stop, again when the reply is broken or missing."""
        self._stopped = True
        if not self._wire.is_open:
            return
        for _ in range(BURST):
            if self._perform("quick_stop", {}) is not None:
                return
            self._wire.check_silence()

    def disable(self) -> None:
        """Stop: the protocols have no command for the torque, the controller switches it off after a quick stop."""
        self.quick_stop()

    def close(self) -> None:
        self._wire.close()

    def counters(self) -> dict[str, int]:
        """Return exchanges, lost, protocol_errors (checksum, format), late, duplicates, skipped_bytes."""
        return {**self._wire.counts, "skipped_bytes": self._wire.skipped_bytes}

    def _send_quick_stop(self) -> None:
        """Send the quick stop without waiting for a reply: set-up has failed and reports the cause."""
        with contextlib.suppress(DeviceError):
            for line in self._ascii.lines["quick_stop"]:
                for axis in line.axes:
                    self._wire.send(line, axis, {})

    def _perform(self, action: str, values: FieldValues, reply_s: float = REPLY_S) -> tuple[float, FieldValues] | None:
        """Send every line of an action; return the mean time of the requests and the values of all replies."""
        report: FieldValues = {}
        times = []
        for line in self._ascii.lines[action]:
            for axis in line.axes:
                reply = self._request(line, axis, values, reply_s)
                if reply is None:
                    self._unanswered, self._unanswered_axis = line, axis
                    return None
                times.append(reply[0])
                report |= reply[1]
        return fsum(times) / len(times), report

    def _insist(self, action: str) -> tuple[float, FieldValues]:
        """Perform an action of set-up, with time-outs in wall time."""
        reply_s = _REPLY_WALL_S * self._clock.speed
        for _ in range(BURST):
            reply = self._perform(action, {}, reply_s)
            if reply is not None:
                return reply
        broken = f"; {self._wire.broken}" if self._wire.broken else ""
        text = f"does not answer {self._unanswered.send.text!r} within {_REPLY_WALL_S:g} s{broken}"
        raise LinkTimeout(self._name(self._unanswered_axis), text)

    def _check_identity(self, report: FieldValues) -> None:
        for name, expected in self._identity.items():
            reported = report.get((name, DEVICE))
            if reported is None:
                raise ProtocolError(self.device, f"reports no {name}, expected {expected!r}")
            if reported != expected:
                raise ProtocolError(self.device, f"{name} is {reported!r}, expected {expected!r}")

    def _has(self, report: FieldValues, axis: int, name: str) -> bool:
        bit = getattr(self._bits, name)
        return bit is not None and bool(int(report["status", axis]) & bit)

    def _is_moving(self, report: FieldValues) -> bool:
        return any(self._has(report, axis, "moving") for axis in range(len(self.axis_names)))

    def _check(self, report: FieldValues) -> None:
        for axis, name in enumerate(self.axis_names):
            fault = int(report.get(("fault", axis), 0))
            if self._has(report, axis, "fault") or fault:
                raise DriveFault(name, self._ascii.fault_text(fault), self._ascii.fault_kind(fault))
            if not self._stopped and not self._has(report, axis, "enabled"):
                raise DriveFault(name, f"was disabled by the controller, status 0x{int(report['status', axis]):02X}")

    def _feedback(self, sampled_s: float, report: FieldValues) -> AxisFeedback:
        position = np.array([float(report["position", axis]) for axis in range(len(self.axis_names))])
        if all(("rate", axis) in report for axis in range(len(self.axis_names))):
            rate = np.array([float(report["rate", axis]) for axis in range(len(self.axis_names))])
        else:
            rate = self._difference(sampled_s, position)
        self._previous = (sampled_s, position)
        for axis in range(len(self.axis_names)):
            self._homing[axis] = self._homing_of(report, axis)
        low = [self._has(report, axis, "limit_low") for axis in range(len(self.axis_names))]
        high = [self._has(report, axis, "limit_high") for axis in range(len(self.axis_names))]
        limit = [int(high[axis]) - int(low[axis]) for axis in range(len(self.axis_names))]
        return AxisFeedback(sampled_s, position, rate, tuple(self._homing), tuple(limit))

    def _difference(self, sampled_s: float, position: Array) -> Array:
        """Return the rate, (n,), by differences, for a controller that does not report it."""
        if self._previous is None or sampled_s <= self._previous[0]:
            return np.zeros(len(self.axis_names))
        return (position - self._previous[1]) / (sampled_s - self._previous[0])

    def _homing_of(self, report: FieldValues, axis: int) -> Homing:
        bits = self._bits
        if not self._needs_home[axis]:
            return Homing.DONE
        if self._has(report, axis, "homing"):
            return Homing.UNDER_WAY
        if self._has(report, axis, "homing_failed"):
            return Homing.FAILED
        homed = self._has(report, axis, "homed") if bits.homed is not None else not self._has(report, axis, "not_homed")
        if homed:
            return Homing.DONE
        return Homing.FAILED if self._homing_started[axis] else Homing.NEEDED


class AsciiTurntable(CyclicAxisGroup):
    """Turntable on a serial port; ``config.ascii`` names port, baud rate and protocol file. Raises BadInput."""

    def __init__(self, config: Turntable, clock: BenchClock, name: str = "turntable") -> None:
        if config.ascii is None or config.ascii.port is None:
            raise BadInput.single("rig", "turntable.ascii.port", "is missing: the wire to the device")
        super().__init__(config, clock, AsciiLink(name, config, config.ascii, clock), name)
