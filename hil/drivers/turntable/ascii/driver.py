"""Turntable behind one serial controller that speaks the lines of a protocol file."""

from __future__ import annotations

import contextlib
import time
from typing import Final

import numpy as np

from hil.config.load import load_protocol
from hil.config.protocol import Protocol
from hil.config.rig import GIMBAL_NAMES, AsciiTurntableLine, Turntable
from hil.core.clock import Clock
from hil.core.messages import Array, AxisFeedback, Homing
from hil.drivers.base import full_names
from hil.drivers.cyclic_exchange import CyclicAxisGroup
from hil.drivers.turntable.ascii.link import BURST, REPLY_S, AsciiTransport
from hil.drivers.turntable.ascii.protocol import DEVICE, AsciiCommand, AsciiProtocol, CommandRefused, Key, Value
from hil.errors import BadInput, BenchError, DeviceError, DriveFault, LinkTimeout, ProtocolError

_SET_UP_WALL_S: Final = 2.0
_REPLY_WALL_S: Final = 0.3  # set-up: wall time that one reply may take
_POLL_WALL_S: Final = 0.005

Told = dict[Key, Value]


class AsciiLink:
    """The controller's commands as actions; each exchange sets all axes and takes their report.

    Feedback is stamped with the bench time at which the requests reach the controller, their mean where
    each axis has its own.
    """

    has_profiles = False
    jogging = False

    def __init__(self, device: str, config: Turntable, line: AsciiTurntableLine, clock: Clock) -> None:
        self.device = device
        self.axis_names = full_names(device, GIMBAL_NAMES)
        loaded = load_protocol(line.protocol)
        self._protocol: Protocol = loaded.value
        self._dialect = AsciiProtocol(self._protocol)
        self._identity = line.identity
        self._clock = clock
        self._wire = AsciiTransport(device, str(line.port), line.baud, config.timeout_s, self._dialect, clock)
        encoders = [getattr(config, name).encoder for name in GIMBAL_NAMES]
        self._needs_home = [encoder == "incremental" for encoder in encoders]
        if any(self._needs_home) and not self._protocol.requests.home:
            axis = GIMBAL_NAMES[self._needs_home.index(True)]
            text = f'"incremental": protocol {self._protocol.name} ({loaded.source}) has no requests.home'
            raise BadInput.single("rig", f"turntable.{axis}.encoder", text)
        self._reset()

    def _reset(self) -> None:
        self._stopped = False
        self._search_begun = [False, False, False]
        self._homing = [Homing.NEEDED if needed else Homing.DONE for needed in self._needs_home]
        self._before: tuple[float, Array] | None = None

    def open(self) -> AxisFeedback:
        """Identify the controller, bring the axes to a stand, enable them; return where they stand."""
        self._wire.open()
        self._reset()
        try:
            return self._set_up()
        except BenchError:
            self._last_word()
            self.close()
            raise

    def _set_up(self) -> AxisFeedback:
        if self._protocol.requests.identify:
            self._check_identity(self._insist("identify")[1])
        end_s = time.monotonic() + _SET_UP_WALL_S
        self._insist("quick_stop")
        while self._is_moving(self._insist("status")[1]):
            if time.monotonic() > end_s:
                raise LinkTimeout(self.device, f"axes do not come to a stand within {_SET_UP_WALL_S:g} s")
            time.sleep(_POLL_WALL_S)
        if self._protocol.requests.clear_faults:
            self._insist("clear_faults")
        refused = self._try_to_enable()
        sampled_s, told = self._insist("status")
        self._check(told)
        if refused is not None:
            raise ProtocolError(self.device, f"refuses to be enabled: {refused}")
        self._wire.heard()
        return self._feedback(sampled_s, told)

    def _try_to_enable(self) -> str | None:
        """Enable; return why not where the controller refuses: an axis in fault is then found by its status."""
        self._stopped = False
        try:
            self._insist("enable")
        except ProtocolError as error:
            if isinstance(error.__cause__, CommandRefused):
                return error.__cause__.text
            raise
        return None

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Give the setpoint, take the report; after ``quick_stop`` and before homing take the report only."""
        values: Told = {}
        for axis in range(3):
            values["position", axis] = float(position[axis])
            values["rate", axis] = float(rate[axis])
        passive = self._stopped or not (self.jogging or all(known is Homing.DONE for known in self._homing))
        self._wire.counts["exchanges"] += 1
        answer = self._perform("status", {}) if passive else self._perform("set", values)
        if answer is not None and not passive and not self._dialect.set_tells_all:
            answer = self._perform("status", {})
        if answer is None:
            self._wire.check_silence()
            return None
        sampled_s, told = answer
        self._check(told)
        return self._feedback(sampled_s, told)

    def home(self) -> None:
        """Ask each axis that does not know its place to look for it."""
        for line in self._dialect.lines.get("home", []):
            for axis in line.axes:
                if axis == DEVICE or self._homing[axis] is not Homing.DONE:
                    self._insist_on_line(line, axis)
        for axis in range(3):
            if self._homing[axis] is not Homing.DONE:
                self._homing[axis] = Homing.UNDER_WAY
                self._search_begun[axis] = True

    def _insist_on_line(self, line: AsciiCommand, axis: int) -> None:
        for _ in range(BURST):
            if self._ask(line, axis, {}) is not None:
                return
        raise LinkTimeout(self._name(axis), f"does not answer {line.send.text!r}")

    def _name(self, axis: int) -> str:
        return self.device if axis == DEVICE else self.axis_names[axis]

    def _ask(self, line: AsciiCommand, axis: int, values: Told, reply_s: float = REPLY_S) -> tuple[float, Told] | None:
        try:
            return self._wire.ask(line, axis, values, reply_s, patient=line.action != "quick_stop")
        except CommandRefused as refused:
            raise ProtocolError(self._name(axis), f"refuses {line.send.text!r}: {refused.text}") from refused

    def move_to(self, position: Array, rate: Array) -> None:
        """Never called: the controller has no profiles of its own."""

    def quick_stop(self) -> None:
        """Send the quick stop, again when the reply is broken or missing."""
        self._stopped = True
        if not self._wire.is_open:
            return
        for _ in range(BURST):
            if self._perform("quick_stop", {}) is not None:
                return
            self._wire.check_silence()

    def close(self) -> None:
        self._wire.close()

    def counters(self) -> dict[str, int]:
        """Return exchanges, lost, protocol_errors (checksum, form), late, duplicates, skipped_bytes."""
        return {**self._wire.counts, "skipped_bytes": self._wire.skipped_bytes}

    def _last_word(self) -> None:
        """Quick stop without waiting for an answer: set-up has failed anyway and says why."""
        with contextlib.suppress(DeviceError):
            for line in self._dialect.lines["quick_stop"]:
                for axis in line.axes:
                    self._wire.tell(line, axis, {})

    def _perform(self, action: str, values: Told, reply_s: float = REPLY_S) -> tuple[float, Told] | None:
        """Send every line of an action; return the mean time of the requests and all that the replies tell."""
        told: Told = {}
        times = []
        for line in self._dialect.lines[action]:
            for axis in line.axes:
                answer = self._ask(line, axis, values, reply_s)
                if answer is None:
                    return None
                times.append(answer[0])
                told |= answer[1]
        return sum(times) / len(times), told

    def _insist(self, action: str) -> tuple[float, Told]:
        """Perform an action of set-up, where wall time counts."""
        reply_s = _REPLY_WALL_S * self._clock.speed
        for _ in range(BURST):
            answer = self._perform(action, {}, reply_s)
            if answer is not None:
                return answer
        text = self._dialect.lines[action][0].send.text
        raise LinkTimeout(self.device, f"does not answer {text!r} within {_REPLY_WALL_S:g} s")

    def _check_identity(self, told: Told) -> None:
        for name, expected in self._identity.items():
            found = told.get((name, DEVICE))
            if found is None:
                raise ProtocolError(self.device, f"tells no {name}, expected {expected!r}")
            if found != expected:
                raise ProtocolError(self.device, f"{name} is {found!r}, expected {expected!r}")

    def _has(self, told: Told, axis: int, name: str) -> bool:
        bit = getattr(self._protocol.status, name)
        return bit is not None and bool(int(told["status", axis]) & bit)

    def _is_moving(self, told: Told) -> bool:
        return any(self._has(told, axis, "moving") for axis in range(3))

    def _check(self, told: Told) -> None:
        for axis, name in enumerate(self.axis_names):
            fault = int(told.get(("fault", axis), 0))
            if self._has(told, axis, "fault") or fault:
                raise DriveFault(name, self._dialect.fault_text(fault), self._dialect.fault_kind(fault))
            if not self._stopped and not self._has(told, axis, "enabled"):
                raise DriveFault(name, f"was disabled by the controller, status 0x{int(told['status', axis]):02X}")

    def _feedback(self, sampled_s: float, told: Told) -> AxisFeedback:
        position = np.array([float(told["position", axis]) for axis in range(3)])
        if all(("rate", axis) in told for axis in range(3)):
            rate = np.array([float(told["rate", axis]) for axis in range(3)])
        else:
            rate = self._difference(sampled_s, position)
        self._before = (sampled_s, position)
        for axis in range(3):
            self._homing[axis] = self._homing_of(told, axis)
        roll, pitch, yaw = self._homing
        low = [self._has(told, axis, "limit_low") for axis in range(3)]
        high = [self._has(told, axis, "limit_high") for axis in range(3)]
        limit = [int(high[axis]) - int(low[axis]) for axis in range(3)]
        return AxisFeedback(sampled_s, position, rate, (roll, pitch, yaw), (limit[0], limit[1], limit[2]))

    def _difference(self, sampled_s: float, position: Array) -> Array:
        """Return the rate, (3,), of a controller that does not tell it."""
        if self._before is None or sampled_s <= self._before[0]:
            return np.zeros(3)
        return (position - self._before[1]) / (sampled_s - self._before[0])

    def _homing_of(self, told: Told, axis: int) -> Homing:
        bits = self._protocol.status
        if not self._needs_home[axis]:
            return Homing.DONE
        if self._has(told, axis, "homing"):
            return Homing.UNDER_WAY
        if self._has(told, axis, "homing_failed"):
            return Homing.FAILED
        known = self._has(told, axis, "homed") if bits.homed is not None else not self._has(told, axis, "not_homed")
        if known:
            return Homing.DONE
        return Homing.FAILED if self._search_begun[axis] else Homing.NEEDED


class AsciiTurntable(CyclicAxisGroup):
    """Turntable on a serial port; ``config.ascii`` names port, baud rate and protocol file. Raises BadInput."""

    def __init__(self, config: Turntable, clock: Clock, name: str = "turntable") -> None:
        if config.ascii is None or config.ascii.port is None:
            raise BadInput.single("rig", "turntable.ascii.port", "is missing: the wire to the device")
        super().__init__(config, clock, AsciiLink(name, config, config.ascii, clock), name)
