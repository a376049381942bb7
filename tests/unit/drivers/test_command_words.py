"""Thruster words: bytes, effect of damaged ones, and the backend of a flight computer that falls silent."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.checks.compatibility import check_flight_computer
from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.config.tables.flight_computer import FlightComputer, WordsCan, WordsLine
from hil.core.messages import MAX_POSES, POSE, PoseFrame
from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.vmu.frame_codec import FrameDecoder
from hil.errors import BadInput, LinkLost, LinkTimeout
from hil.loop.core_memory import CycleData
from hil.parts.links.command_word_codec import CommandWordDecoder, Word, decode_can, encode, encode_can
from hil.parts.links.command_word_receiver import CommandWordReceiver, PoseForwarder
from hil.parts.links.command_words import CommandWordGnc
from hil.session.gnc_setup import backend_setup


def test_bytes_of_a_word() -> None:
    assert encode(Word(7, 0x00_80_05)).hex(" ") == "eb 91 01 07 05 80 00 18 1a"


@given(st.integers(0, 255), st.integers(0, 0xFFFFFF), st.binary(max_size=30), st.integers(1, 9))
def test_word_is_found_behind_any_rubbish_however_it_is_cut(
    counter: int, thrusters: int, rubbish: bytes, cut: int
) -> None:
    word = Word(counter, thrusters)
    data, decoder, found = rubbish + b"\0" * 9 + encode(word), CommandWordDecoder(), []
    for i in range(0, len(data), cut):
        found += decoder.feed(data[i : i + cut])
    assert found[-1] == word


@given(st.integers(0, 55), st.integers(0, 0xFFFFFF))
def test_one_wrong_bit_is_no_word(bit: int, thrusters: int) -> None:
    data = bytearray(encode_can(Word(3, thrusters)))
    data[bit // 8] ^= 1 << bit % 8
    assert decode_can(bytes(data)) is None


@pytest.fixture
def wire() -> Iterator[tuple[int, str]]:
    """Give one end of a pseudo terminal, and the path of the other."""
    here, there = os.openpty()
    tty.setraw(there)
    yield here, os.ttyname(there)
    os.close(here)
    os.close(there)


def until(condition: Callable[[], object]) -> None:
    give_up_s = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.002)


def test_newest_word_comes_over_a_serial_port_and_losses_are_counted(wire: tuple[int, str]) -> None:
    here, path = wire
    receiver = CommandWordReceiver(FlightComputer(command_words="serial", serial=WordsLine(port=path)), lambda: 12.5)
    receiver.open()
    try:
        spoilt = bytearray(encode(Word(2, 1)))
        spoilt[5] ^= 1
        os.write(here, encode(Word(1, 0b1)) + spoilt + encode(Word(4, 0b110)) + encode(Word(4, 0b1111)))
        until(lambda: receiver.repeated)
        assert receiver.newest() == (Word(4, 0b110), 12.5)
        assert receiver.counters() == {"received": 2, "lost": 2, "repeated": 1, "refused": 1}
    finally:
        receiver.close()


def test_newest_word_comes_over_can_from_its_identifier_alone() -> None:
    config = FlightComputer(command_words="can", can=WordsCan(interface="virtual", channel="words", identifier=0x120))
    receiver = CommandWordReceiver(config, lambda: 1.0)
    receiver.open()
    try:
        with can.Bus(interface="virtual", channel="words") as bus:
            for identifier, word in ((0x121, Word(1, 1)), (0x120, Word(1, 2))):
                bus.send(can.Message(arbitration_id=identifier, data=encode_can(word), is_extended_id=False))
            until(receiver.newest)
        assert receiver.newest() == (Word(1, 2), 1.0)
    finally:
        receiver.close()


def test_newest_word_comes_over_a_serial_can_adapter(wire: tuple[int, str]) -> None:
    here, path = wire
    receiver = CommandWordReceiver(
        FlightComputer(command_words="can", can=WordsCan(interface="serial", channel=path)), lambda: 1.0
    )
    receiver.open()
    try:
        head = b"\xaa" + bytes(4) + bytes([7]) + (0x120).to_bytes(4, "little")  # as python-can frames it
        os.write(here, head + encode_can(Word(9, 0b101)) + b"\xbb")
        until(receiver.newest)
        assert receiver.newest() == (Word(9, 0b101), 1.0)
    finally:
        receiver.close()


def test_port_that_is_not_there_is_named() -> None:
    receiver = CommandWordReceiver(
        FlightComputer(command_words="serial", serial=WordsLine(port="/dev/none")), lambda: 0.0
    )
    with pytest.raises(LinkLost, match="flight computer: cannot open /dev/none"):
        receiver.open()


def test_poses_go_out_as_the_vision_unit_sends_them_in_time_of_the_run(wire: tuple[int, str]) -> None:
    here, path = wire
    forwarder = PoseForwarder(WordsLine(port=path, baud=460_800))
    frame = PoseFrame(41, 100.25, 100.3, np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(6))
    forwarder.open()
    forwarder.put(frame, -0.1)  # of before the run
    forwarder.put(frame, 0.25)
    forwarder.close()
    (decoded,) = FrameDecoder(frame_codec()).feed(os.read(here, 1000), 0.0)
    assert (decoded.counter, decoded.t_s) == (41, 0.25)
    assert decoded.pose is not None
    np.testing.assert_array_equal(decoded.pose.t_v, frame.t_v)


class _Silence:
    poses = np.zeros(MAX_POSES, POSE).view(np.recarray)
    arrived = 0


@dataclass
class Said:
    """Words without a wire."""

    word: tuple[Word, float] | None = None

    def open(self) -> None: ...

    def close(self) -> None: ...

    def newest(self) -> tuple[Word, float] | None:
        return self.word


class Bench:
    """A backend with words from ``said`` at a time that the test sets."""

    def __init__(self, scenario: Scenario, **config: object) -> None:
        self.said, self.now_s, self.held = Said(), 0.0, ""
        self.seat = CommandWordGnc(
            FlightComputer(command_words="serial", **config),  # type: ignore[arg-type]
            self.said,  # type: ignore[arg-type]
            None,
            lambda: self.now_s,
            backend_setup(scenario),
        )
        self.seat.request_hold = self.hold
        self.now = CycleData()

    def hold(self, reason: str) -> None:
        self.held = reason

    def act(self, now_s: float) -> list[int]:
        """Return the thrusters that are open after a cycle, from 1."""
        self.now_s = now_s
        self.seat.step(now_s, self.now, _Silence())
        return (np.flatnonzero(self.now.command.on) + 1).tolist()


def test_word_stands_until_it_is_too_old_and_then_opens_nothing(scheme_1: Scenario) -> None:
    bench = Bench(scheme_1, timeout_s=0.1, lost_s=0.5)
    assert bench.act(0.0) == []
    bench.said.word = (Word(1, 0b1001), 0.02)
    assert bench.act(0.02) == bench.act(0.12) == [1, 4]
    assert bench.act(0.14) == bench.act(0.52) == []
    bench.said.word = (Word(2, 0b10), 0.53)
    assert bench.act(0.54) == [2]
    assert not bench.now.navigation.valid
    assert bench.held == ""


def test_longer_silence_stops_or_holds_as_configured(scheme_1: Scenario) -> None:
    bench = Bench(scheme_1, on_loss="stop")
    bench.said.word = (Word(1, 1), 0.0)
    assert bench.act(0.5) == []
    with pytest.raises(LinkTimeout, match=r"flight computer: no command word for 0.60 s, allowed 0.5 s"):
        bench.act(0.6)
    bench = Bench(scheme_1, on_loss="hold")
    bench.act(0.0)
    assert bench.act(0.6) == []
    assert bench.held == "flight computer: no command word for 0.60 s, allowed 0.5 s"
    assert bench.seat.blocking_reason
    bench.said.word = (Word(1, 1), 0.59)
    assert not bench.seat.blocking_reason


def test_wire_is_asked_for_and_a_mock_rig_has_no_flight_computer() -> None:
    scenario = load_scenario("scheme-1")
    (problem,) = check_flight_computer(scenario, load_rig("mock", ["rig.flight_computer.command_words=serial"]))
    assert "a mock rig does not run in real time" in str(problem)
    (problem,) = check_flight_computer(scenario, load_rig("emulated", ["rig.flight_computer.command_words=can"]))
    assert "rig.flight_computer.can.channel: is missing" in str(problem)
    with pytest.raises(BadInput, match=r"lost_s = 0.01: must not be below timeout_s"):
        load_rig("emulated", ["rig.flight_computer.lost_s=0.01"])
