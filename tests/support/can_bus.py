"""A CAN bus in memory, in simulated time: frames take their time on it, and the queue of an interface is short."""

from __future__ import annotations

import errno
from collections import deque

import can

from hil.config.rig import RotaryAxes
from hil.drivers.can_port import REMOTE, Frame
from hil.parts.emulation.cia402 import Cia402Emulator

QUEUE = 10
_BITS = 47
_POLL_S = 5e-4


class BusClock:
    """Time that passes on the bus, and in sleeps."""

    speed = 1.0

    def __init__(self) -> None:
        self.t_s = 0.0
        self.bus: CanBus | None = None

    def now_s(self) -> float:
        return self.t_s

    host_s = now_s

    def sleep(self, wall_s: float) -> None:
        self.sleep_until(self.t_s + wall_s)

    def sleep_until(self, t_s: float) -> None:
        assert self.bus is not None
        self.bus.run_until(t_s)

    def paced_s(self, period_s: float) -> float:
        return period_s

    def wall_s(self, duration_s: float) -> float:
        return duration_s


class Interface:
    """An interface of python-can on the bus, with a queue of ten frames."""

    def __init__(self, bus: CanBus) -> None:
        self._bus = bus
        self.sent: deque[Frame] = deque()
        self.received: deque[Frame] = deque()
        self.refused = 0

    def send(self, message: can.Message) -> None:
        if len(self.sent) >= QUEUE:
            self.refused += 1
            raise can.CanOperationError("No buffer space available", errno.ENOBUFS)
        self.sent.append((message.arbitration_id | REMOTE * message.is_remote_frame, bytes(message.data)))

    def recv(self, timeout: float) -> can.Message | None:
        end_s = self._bus.clock.t_s + timeout
        while not self.received and self._bus.clock.t_s < end_s:
            self._bus.run_until(min(end_s, self._bus.clock.t_s + _POLL_S))
        if not self.received:
            return None
        identifier, data = self.received.popleft()
        return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)

    def fileno(self) -> int:
        raise NotImplementedError

    def shutdown(self) -> None:
        """Leave nothing behind."""


class CanBus:
    """Emulated drives and other nodes, and the interfaces of the drivers."""

    def __init__(self, clock: BusClock, bitrate: int) -> None:
        self.clock = clock
        clock.bus = self
        self._bitrate = bitrate
        self._emulators: list[Cia402Emulator] = []
        self.interfaces: list[Interface] = []
        self._answers: deque[Frame] = deque()
        self._stepped_s = 0.0
        self.frames = 0

    def join(self, emulator: Cia402Emulator) -> None:
        self._emulators.append(emulator)

    def open(self, **_: object) -> Interface:
        """Return a new interface, as ``can.Bus``."""
        self.interfaces.append(Interface(self))
        return self.interfaces[-1]

    def run_until(self, t_s: float) -> None:
        """Transfer frames, each in its time, the one with the lowest identifier first; advance the drives."""
        while self.clock.t_s < t_s:
            heads = [(each.sent[0][0] & ~REMOTE, each) for each in self.interfaces if each.sent]
            if self._answers:
                heads.append((self._answers[0][0] & ~REMOTE, self))
            if not heads:
                self.clock.t_s = min(t_s, self.clock.t_s + _POLL_S)
                self._advance()
                continue
            sender = min(heads, key=lambda head: head[0])[1]
            frame = self._answers.popleft() if sender is self else sender.sent.popleft()
            self.clock.t_s += (_BITS + 8 * len(frame[1]) * 1.15) / self._bitrate
            self.frames += 1
            self._deliver(frame, sender)
            self._advance()

    def _deliver(self, frame: Frame, sender: object) -> None:
        for each in self.interfaces:
            if each is not sender:
                each.received.append(frame)
        for emulator in self._emulators:
            self._answers.extend(emulator.answers([frame], self.clock.t_s))

    def _advance(self) -> None:
        if self.clock.t_s < self._stepped_s + _POLL_S:
            return
        self._stepped_s = self.clock.t_s
        for emulator in self._emulators:
            self._answers.extend(emulator.answers([], self.clock.t_s))


def group_of(turntable: RotaryAxes, **of_bus: object) -> RotaryAxes:
    """Return a turntable with other keys of its bus."""
    return turntable.model_copy(update={"cia402": turntable.cia402.model_copy(update=of_bus)})
