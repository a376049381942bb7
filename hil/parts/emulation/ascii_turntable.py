"""Emulator of an ASCII turntable controller: any protocol file, on a pseudo terminal with the line's timing."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

from hil.config.load import load_protocol
from hil.config.rig import Turntable
from hil.core.clock import BenchClock
from hil.core.messages import Homing
from hil.drivers.tcp_port import SCHEME, is_tcp
from hil.drivers.turntable.ascii.frames import BrokenLine
from hil.drivers.turntable.ascii.protocol import DEVICE, AsciiCommand, AsciiProtocol, CommandRefused, FieldValues
from hil.errors import BadInput
from hil.parts.emulation.emulated_axes import STEP_S, EmulatedAxes
from hil.parts.emulation.fault_injection import FaultyChannel, FaultyWire
from hil.parts.emulation.modbus_tcp import ModbusTcpEmulator, ModbusTcpPort
from hil.parts.emulation.pty_line import PtyLine
from hil.parts.emulation.shared_state import SharedAxisState


class _AsciiServer(ModbusTcpEmulator):
    """The controller on a port of 127.0.0.1."""

    def __init__(
        self,
        clock: BenchClock,
        advance: Callable[[], None],
        answers: Callable[[bytes], list[bytes]],
        wire: FaultyWire,
    ) -> None:
        super().__init__(clock, clock.paced_s(STEP_S))
        self._advance = advance
        self._ports.append(ModbusTcpPort(lambda data: (len(data), answers(data)), wire, clock))

    def listen(self) -> str:
        """Listen; return the address."""
        self._listen()
        return f"{SCHEME}{self._ports[0].address}"

    def _step(self) -> None:
        self._advance()


class AsciiTurntableEmulator:
    """Controller of roll, pitch, yaw on ``config.ascii``; serve it with ``run`` in a process of its own.

    Faults of the wire apply to its replies; a dead wire transfers no requests either.
    """

    def __init__(
        self, config: Turntable, clock: BenchClock, shared: SharedAxisState, name: str = "turntable", **axes: Any
    ) -> None:
        if config.ascii is None:
            raise BadInput.single("rig", "turntable.ascii", "is missing")
        protocol = load_protocol(config.ascii.protocol).value
        self._clock = clock
        self._bits = protocol.bits
        self._words = protocol.emulator
        self._torque_off = protocol.faults.torque_off or self._words.drive_fault
        self._following_error = protocol.faults.following_error or self._words.drive_fault
        self._has_flags = protocol.faults.kind == "flags"
        self.protocol = AsciiProtocol(protocol)
        self.gimbals = EmulatedAxes(name, config, clock, shared, **axes)
        self.faults = self.gimbals.faults
        self._channel = FaultyChannel(self.faults, self.gimbals.wire_noise)
        self.splitter = self.protocol.requests.splitter()
        n = len(self.gimbals.names)
        self._all = range(n)
        self._enabled = [False] * n
        self._homing = [False] * n  # until the axis is at rest again
        self._quick_stopped = False
        self.fault = [0] * n
        self._frozen: FieldValues | None = None
        self._server: _AsciiServer | None = None
        self._line: PtyLine | None = None
        if is_tcp(config.ascii.port or ""):
            wire = FaultyWire(self.faults, self.gimbals.wire_noise)
            self._server = _AsciiServer(clock, self._advance, self._answers, wire)
        else:
            self._line = PtyLine(config.ascii.baud, clock, config.ascii.adapter_latency_s)

    def start(self) -> dict[str, str]:
        """Return the path of the line, or the address on the network."""
        if self._server is not None:
            return {self.faults.device: self._server.listen()}
        assert self._line is not None
        return {self.faults.device: self._line.path}

    def run(self, stop: threading.Event) -> None:
        """Serve the line until ``stop`` is set."""
        if self._server is not None:
            self._server.run(stop)
            return
        assert self._line is not None
        line, step_s = self._line, self._clock.paced_s(STEP_S)
        while not stop.is_set():
            for reply in self._answers(line.read(step_s)):
                self._channel.put(reply, self._clock.now_s())
            for reply in self._channel.due(self._clock.now_s()):
                line.write(reply)
                self._advance()

    def close(self) -> None:
        """Close the line."""
        if self._server is not None:
            self._server.close()
        if self._line is not None:
            self._line.close()

    def _answers(self, data: bytes) -> list[bytes]:
        """Advance to the present; return the replies to the requests that ``data`` completes."""
        self._advance()
        if not data or self.faults.value("link_down") is not None:
            return []
        replies = []
        for request in self.splitter.feed(data):
            echo = request + self.protocol.requests.end if self.protocol.protocol.line.echo else b""
            replies.append(echo + self.answer(request))
        return [reply for reply in replies if reply]

    def answer(self, text: bytes) -> bytes:
        """Execute one request; return the reply, b"" for a broken line."""
        try:
            sequence, line, axis, values = self.protocol.decode_request(text)
        except BrokenLine:
            return b""  # its sequence number is not reliable: no reply
        except CommandRefused as refused:
            return self.protocol.refusal(int(str(refused), 16), self._words.unknown)
        if self._refuses(line.action, axis):
            return self.protocol.refusal(sequence, self._words.refused)
        self._execute(line, axis, values)
        return self.protocol.reply(sequence, line, axis, self._report())

    def _refuses(self, action: str, axis: int) -> bool:
        axes = self._all if axis == DEVICE else (axis,)
        if action == "enable":
            return any(self.fault[i] or self.gimbals.moving(i) or self.gimbals.torque_off for i in axes)
        return action == "home" and not all(self._enabled[i] for i in axes)

    def _execute(self, line: AsciiCommand, axis: int, values: FieldValues) -> None:
        for i in self._all if axis == DEVICE else (axis,):
            if line.action == "set":
                position = values.get(("position", i), self.gimbals.position[i])
                self._follow(i, float(position), float(values.get(("rate", i), 0.0)))
            elif line.action == "enable":
                self._enabled[i] = True
                self._quick_stopped = False
                self.gimbals.enable(i)
                self._hold(i)
            elif line.action == "hold":
                self._hold(i)
            elif line.action == "quick_stop":
                self._quick_stopped = True
                self._disable(i)
            elif line.action == "clear_faults":
                self.fault[i] = 0
                self.gimbals.astray[i] = False
            elif line.action == "home" and self.gimbals.homing[i] is not Homing.DONE:
                self._homing[i] = True
                self.gimbals.home(i)

    def _follow(self, axis: int, position_rad: float, rate_radps: float) -> None:
        if self._enabled[axis]:
            self.gimbals.follow(axis, position_rad, rate_radps, self._clock.now_s())

    def _hold(self, axis: int) -> None:
        """Hold the present position; the watchdog applies to setpoints only."""
        if self._enabled[axis]:
            held = float(self.gimbals.position[axis])
            self.gimbals.follow(axis, held, 0.0, self._clock.now_s(), watchdog_s=math.inf)

    def _disable(self, axis: int) -> None:
        self._enabled[axis] = False
        self.gimbals.brake(axis)

    def _advance(self) -> None:
        self.gimbals.advance(self._clock.now_s())
        for axis, name in enumerate(self.gimbals.names):
            self._homing[axis] &= self.gimbals.homing[axis] is Homing.UNDER_WAY or self.gimbals.moving(axis)
            switched = self.faults.pop("drive_fault", name)
            if switched is not None:
                self._fail(axis, round(switched) or self._words.drive_fault)
            if self.gimbals.overdue[axis]:
                self.gimbals.overdue[axis] = False
                self._fail(axis, self._words.command_timeout)
            if self.gimbals.torque_off and self._enabled[axis]:
                self._fail(axis, self._torque_off)
            if self.gimbals.astray[axis] and not self.fault[axis]:
                self._fail(axis, self._following_error)

    def _fail(self, axis: int, number: int) -> None:
        self.fault[axis] = self.fault[axis] | number if self._has_flags else self.fault[axis] or number
        self._disable(axis)

    def _status(self, axis: int) -> int:
        homing, limit = self.gimbals.homing[axis], self.gimbals.limit(axis)
        shown = {
            "enabled": self._enabled[axis],
            "fault": self.fault[axis] != 0,
            "quick_stopped": self._quick_stopped,
            "moving": self.gimbals.moving(axis),
            "homed": homing is Homing.DONE,
            "not_homed": homing is not Homing.DONE,
            "homing": self._homing[axis],
            "homing_failed": homing is Homing.FAILED,
            "limit_low": limit < 0,
            "limit_high": limit > 0,
        }
        return sum(getattr(self._bits, name) or 0 for name, on in shown.items() if on)

    def _report(self) -> FieldValues:
        """Return the values of all fields of replies; constant while the device is frozen."""
        if self._frozen is not None and self.faults.value("freeze") is not None:
            return self._frozen
        words = self._words
        report: FieldValues = {("model", DEVICE): words.model, ("serial", DEVICE): words.serial}
        report |= {("firmware", DEVICE): words.firmware, ("ignore", DEVICE): ""}
        for axis in self._all:
            report["position", axis] = float(self.gimbals.position[axis])
            report["rate", axis] = float(self.gimbals.rate[axis])
            report["status", axis] = self._status(axis)
            report["fault", axis] = self.fault[axis]
        self._frozen = report
        return report
