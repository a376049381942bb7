"""What the serial turntable does about a wire that spoils its replies."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import tty

import pytest

from hil.core.clock import WallClock
from hil.drivers.turntable.ascii.driver import AsciiTurntable
from hil.errors import ProtocolError
from hil.parts.emulation.ascii_turntable import AsciiTurntableEmulator
from hil.parts.emulation.shared_state import SharedAxisState
from tests.behaviour.test_turntable_timeouts import error_of, eventually
from tests.support.turntable_bench import turntable

pytestmark = pytest.mark.wires


class NoisyLine:
    """A pty whose far end is a controller with given answers."""

    def __init__(self, spoil):
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        self.path = os.ttyname(self._far)
        self._spoil = spoil
        self._stop = threading.Event()
        self._emulator = AsciiTurntableEmulator(turntable("ascii"), WallClock(), SharedAxisState.create())
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        number = 0
        while not self._stop.is_set():
            if select.select([self._near], [], [], 0.02)[0]:
                for line in self._emulator.splitter.feed(os.read(self._near, 4096)):
                    number += 1
                    os.write(self._near, self._spoil(number, self._emulator.answer(line)))

    def close(self):
        self._stop.set()
        self._thread.join()
        os.close(self._near)
        os.close(self._far)


@contextlib.contextmanager
def noisy_ascii(spoil):
    line = NoisyLine(spoil)
    clock = WallClock()
    device = AsciiTurntable(turntable("ascii", line.path), clock)
    try:
        device.open(clock.now_s())
        yield device, clock
    finally:
        device.close()
        line.close()


def test_ascii_broken_reply_is_counted_and_asked_for_again():
    def every_seventh(number, reply):
        return b"\x00?" + reply.replace(b".", b",", 1) if number % 7 == 0 else reply

    with noisy_ascii(every_seventh) as (device, clock):
        eventually(lambda: device.counters()["protocol_errors"] >= 2)
        eventually(lambda: device.counters()["exchanges"] >= 20)
        device.read(clock.now_s())
        assert device.counters()["skipped_bytes"] >= 4


def test_ascii_burst_of_broken_replies_is_a_protocol_error():
    with noisy_ascii(lambda number, reply: reply if number < 20 else reply.replace(b".", b",", 1)) as (device, clock):
        error = error_of(device, clock)
        assert isinstance(error, ProtocolError)
        assert "turntable: 4 broken replies in a row: checksum" in str(error)


def test_ascii_late_reply_is_not_taken_for_the_next_one():
    def repeated(number, reply):
        return reply + reply if number == 12 else reply

    with noisy_ascii(repeated) as (device, clock):
        eventually(lambda: device.counters()["duplicates"] == 1)
        eventually(lambda: device.counters()["exchanges"] >= 20)
        assert device.counters()["protocol_errors"] == 0
        device.read(clock.now_s())
