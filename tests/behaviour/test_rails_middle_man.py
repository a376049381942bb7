"""Rails on a serial line with something in the middle: an echo, torn frames, another baud rate.

No wrong position passes.
"""

from __future__ import annotations

import os
import pty
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partialmethod

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.rig import Rails
from hil.core.clock import WallClock
from hil.drivers.rails.driver import ModbusRails
from hil.errors import DeviceError
from hil.parts.emulation.emulated_axes import EmulatedAxes
from hil.parts.emulation.rails import RtuRailsEmulator
from hil.parts.emulation.shared_state import ChainState, SharedAxisState

pytestmark = pytest.mark.wires

TIMEOUT_S = 1.2  # of bench time
SPEED = 0.3  # of bench time: a busy computer is not late
AT_REST_M = 1e-4
TORN_S = 0.004  # between the halves of a frame: longer than the gap of 3.5 characters
_BLOCK = 4096

Deed = Callable[[bytes], list[tuple[float, bytes]]]
"""Returns what becomes of received bytes: pauses, s, and the bytes sent after each."""


def passed(data: bytes) -> list[tuple[float, bytes]]:
    return [(0.0, data)]


def torn(data: bytes) -> list[tuple[float, bytes]]:
    half = len(data) // 2
    return [(0.0, data[:half]), (TORN_S, data[half:])]


def first_half(data: bytes) -> list[tuple[float, bytes]]:
    return [(0.0, data[: len(data) // 2])]


def at_baud(ratio: float) -> Deed:
    """Return what a receiver reads that samples the line at ``ratio`` times the sender's baud rate."""

    def deed(data: bytes) -> list[tuple[float, bytes]]:
        line = [1] + [bit for byte in data for bit in (0, *((byte >> k) & 1 for k in range(8)), 1)] + [1] * 20
        read, at = bytearray(), 0.0
        while (start := next((k for k in range(int(at), len(line)) if line[k] == 0), None)) is not None:
            places = [int(start + (k + 1.5) / ratio) for k in range(9)]
            if places[-1] >= len(line):
                break
            read.append(sum(line[place] << k for k, place in enumerate(places[:8])))
            at = start + 9.5 / ratio
        return [(0.0, bytes(read))]

    return deed


class MiddleMan:
    """Passes bytes between ``port``, for the controller, and the drives' port.

    to_drives, to_controller: what becomes of them. echo: whether the line returns what it is sent.
    """

    def __init__(self, drives: str) -> None:
        self._controller, slave = pty.openpty()
        tty.setraw(slave)
        self.port, self._slave = os.ttyname(slave), slave
        self._drives = os.open(drives, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._drives)
        self.to_drives: Deed = passed
        self.to_controller: Deed = passed
        self.echo = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.is_set():
            for end in select.select([self._controller, self._drives], [], [], 0.02)[0]:
                data = os.read(end, _BLOCK)
                if end == self._controller:
                    if self.echo:
                        os.write(self._controller, data)
                    self._send(self._drives, self.to_drives(data))
                else:
                    self._send(self._controller, self.to_controller(data))

    @staticmethod
    def _send(end: int, parts: list[tuple[float, bytes]]) -> None:
        for pause_s, part in parts:
            time.sleep(pause_s)
            os.write(end, part)

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        for end in (self._controller, self._slave, self._drives):
            os.close(end)


@dataclass
class Line:
    rails: ModbusRails
    clock: WallClock
    middle: MiddleMan

    def watch(self, exchanges: int, wall_s: float = 15.0) -> DeviceError | None:
        """Read until so many exchanges are done; return the error that ends it. Each position is the true one."""
        enough, end = self.rails.counters()["exchanges"] + exchanges, time.monotonic() + wall_s
        while self.rails.counters()["exchanges"] < enough and time.monotonic() < end:
            try:
                position = self.rails.read(self.clock.now_s()).position
            except DeviceError as error:
                return error
            np.testing.assert_allclose(position, self.at_rest, atol=AT_REST_M)
            time.sleep(0.002)
        assert self.rails.counters()["exchanges"] >= enough, "neither exchanges nor an error"
        return None

    def begin(self) -> None:
        self.rails.open(self.clock.now_s())
        self.at_rest = np.array(self.rails.read(self.clock.now_s()).position)
        assert self.watch(20) is None


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Iterator[Line]:
    """Return three drives at rest behind a middle man that passes everything; their own watchdog is not tested here."""
    monkeypatch.setattr(EmulatedAxes, "follow", partialmethod(EmulatedAxes.follow, watchdog_s=60.0))
    with line_of() as made:
        yield made


@contextmanager
def line_of() -> Iterator[Line]:
    clock, board, stop = WallClock(speed=SPEED), SharedAxisState.create(), threading.Event()
    config = Rails.model_validate(load_rig("emulated-rtu").value.rails.model_dump() | {"timeout_s": TIMEOUT_S})
    emulator = RtuRailsEmulator(config, clock, board, chain=lambda: ChainState(True, True, True), seed=3)
    addresses = emulator.start()
    thread = threading.Thread(target=emulator.run, args=(stop,))
    thread.start()
    middle = MiddleMan(addresses["rails"])
    assert config.rtu is not None
    rtu = config.rtu.model_copy(update={"port": middle.port, "parity": "none"})
    rails = ModbusRails(config.model_copy(update={"rtu": rtu}), clock)
    try:
        yield Line(rails, clock, middle)
    finally:
        rails.close()
        stop.set()
        thread.join()
        middle.close()
        emulator.close()
        board.close()


def test_torn_frames_are_put_together(line: Line) -> None:
    line.begin()
    line.middle.to_controller = torn
    assert line.watch(10) is None


@pytest.mark.parametrize(
    ("direction", "deed"),
    [
        ("to_controller", first_half),
        ("to_drives", first_half),
        ("to_controller", at_baud(0.5)),
        ("to_controller", at_baud(2.0)),
        ("to_controller", at_baud(1.1)),
        ("to_drives", at_baud(0.5)),
    ],
    ids=["half answers", "half requests", "half the baud rate", "twice the baud rate", "a tenth off", "drives at half"],
)
def test_line_that_garbles_everything_is_an_error_that_names_an_axis(line: Line, direction: str, deed: Deed) -> None:
    line.begin()
    setattr(line.middle, direction, deed)
    error = line.watch(30)
    assert error is not None
    assert error.device.startswith("rails.")


def test_drives_at_another_baud_rate_are_not_opened(line: Line) -> None:
    line.middle.to_drives, line.middle.to_controller = at_baud(0.5), at_baud(2.0)
    with pytest.raises(DeviceError, match=r"^rails\."):
        line.rails.open(line.clock.now_s())


def test_echo_of_the_line_is_no_answer(line: Line) -> None:
    line.begin()
    line.middle.echo = True
    line.middle.to_controller = lambda _: []  # the drives are dead, and the line still answers with what it is sent
    error = line.watch(30)
    assert error is not None
    assert error.device.startswith("rails.")
