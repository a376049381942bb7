"""RSI: telegrams, frames and corrections, answers that the controller rejects, and its files."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import hil_kuka_rsi
from hil.config.load import load_rig
from hil.core.clock import Order
from hil.drivers.datagrams import DatagramPort
from hil.parts.emulation.lock_step import LockStepConductor
from hil.parts.emulation.shared_state import SharedAxisState
from hil_kuka_rsi import codec
from hil_kuka_rsi.codec import RobotState

RIG = str(Path(hil_kuka_rsi.__file__).parent / "rigs" / "emulated-arm-kuka.toml")
TELEGRAM = (
    b'<Rob Type="KUKA"><RIst X="1200.5" Y="-3.0" Z="900.0" A="90.0" B="0.0" C="180.0"/><RSol X="1200.0" Y="-3.0" '
    b'Z="900.0" A="90.0" B="0.0" C="180.0"/><AIPos A1="0.0" A2="-90.0" A3="90.0" A4="0.0" A5="0.0" A6="0.0"/>'
    b'<Delay D="2"/><IPOC>4208163981</IPOC></Rob>'
)
"""As in the manual of RSI."""


def test_telegram_of_a_controller_is_read() -> None:
    state = codec.decode_state(TELEGRAM)
    assert (state.ipoc, state.delayed, state.status, state.corrected) == (4208163981, 2, None, None)
    assert state.actual.tolist() == [1200.5, -3.0, 900.0, 90.0, 0.0, 180.0]
    assert codec.decode_state(codec.encode_state(state)).actual == pytest.approx(state.actual)


def test_answer_has_the_form_of_the_manual() -> None:
    answer = codec.encode_answer(7, np.array([0.5, 0.0, 0.0, 0.0, 0.0, -1.0]), "ImFree")
    assert answer == (
        b'<Sen Type="ImFree"><RKorr X="0.500000" Y="0.000000" Z="0.000000" A="0.000000" B="0.000000" C="-1.000000" />'
        b"<IPOC>7</IPOC></Sen>"
    )
    assert codec.decode_answer(answer, "ImFree")[0] == 7


@pytest.mark.parametrize(
    "damaged",
    [b"", b"<Rob", b"<Sen/>", TELEGRAM[:-9], TELEGRAM.replace(b"1200.5", b"nan"), TELEGRAM.replace(b"RIst", b"RIsx")],
)
def test_damaged_telegram_is_refused(damaged: bytes) -> None:
    with pytest.raises(ValueError, match=r".+"):
        codec.decode_state(damaged)


@pytest.mark.parametrize("rotation", ["frame", "angles"])
def test_frames_and_corrections_are_inverted(rotation: codec.Rotation) -> None:
    draws = np.random.default_rng(3)
    for _ in range(100):
        start, goal = (np.array([*draws.uniform(-2e3, 2e3, 3), *draws.uniform(-89.0, 89.0, 3)]) for _ in range(2))
        assert codec.frame_of(*codec.pose_of(goal)) == pytest.approx(goal)
        correction = codec.correction_between(start, goal, rotation)
        assert codec.corrected(start, correction, rotation) == pytest.approx(goal)
        assert codec.uncorrected(goal, correction, rotation) == pytest.approx(start)


class Sensor:
    """A program at the port of the controller, that answers as a test wants."""

    def __init__(self, clock: LockStepConductor, port: DatagramPort, controller: Any) -> None:
        self.clock, self.port, self.controller = clock, port, controller

    def cycle(
        self, shift_mm: float = 0.0, late_by: int = 0, sen_type: str = "ImFree", damage: bool = False
    ) -> RobotState:
        """Take the next telegram and answer it."""
        state = codec.decode_state(self.port.read())
        correction = np.array([shift_mm, 0.0, 0.0, 0.0, 0.0, 0.0])
        answer = codec.encode_answer(state.ipoc - 4 * late_by, correction, sen_type)
        self.port.answer(answer[:-3] if damage else answer)
        return state


@contextmanager
def sensor() -> Iterator[Sensor]:
    clock, stop, board = LockStepConductor(0.02, 30.0), threading.Event(), SharedAxisState.create()
    rig = load_rig(RIG).value
    assert rig.arm is not None
    controller = rig.arm.make_emulator(rig, clock, board)
    host, _, number = controller.start()["arm"].rpartition(":")
    port = DatagramPort(clock, host, int(number), 0.1, answered=True)
    served = clock.start_thread(lambda: controller.run(stop), "controller", Order.AXES)
    try:
        yield Sensor(clock, port, controller)
    finally:
        port.close()
        stop.set()
        clock.join(served, 5.0)
        controller.close()
        board.close()
        clock.close()


def test_controller_corrects_while_each_cycle_is_answered() -> None:
    with sensor() as program:
        start = program.cycle().actual
        for _ in range(50):
            state = program.cycle(shift_mm=0.2)
        assert (state.status, state.delayed) == (codec.RUNNING, 0)
        assert state.commanded[0] - start[0] == pytest.approx(0.2, abs=1e-5)


REJECTED = {"wrong IPOC": {"late_by": 1}, "wrong type": {"sen_type": "Other"}, "damaged": {"damage": True}}


@pytest.mark.parametrize("wrong", REJECTED.values(), ids=REJECTED.keys())
def test_wrong_answers_are_late_ones_and_the_controller_stops_after_too_many(wrong: dict[str, Any]) -> None:
    with sensor() as program:
        for _ in range(20):
            program.cycle()
        for _ in range(10):
            assert program.cycle(shift_mm=5.0, **wrong).status == codec.RUNNING
        for _ in range(3):
            state = program.cycle(shift_mm=5.0, **wrong)
        assert (state.status, state.delayed) == (codec.STOPPED, 11)
        first = program.controller.robot.axes
        for _ in range(50):
            program.cycle(shift_mm=5.0)
        assert np.abs(program.controller.robot.axes - first).max() < 1e-6


def test_files_for_the_controller_are_those_of_the_rig(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hil_kuka_rsi", RIG, "-o", str(tmp_path)]
    assert len(subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()) == 3
    config = ElementTree.parse(tmp_path / "hil_bench_ethernet.xml").getroot()
    assert config.findtext("CONFIG/SENTYPE") == "ImFree"
    tags = [element.get("TAG") for element in config.findall("RECEIVE/ELEMENTS/ELEMENT")]
    assert tags == ["RKorr.X", "RKorr.Y", "RKorr.Z", "RKorr.A", "RKorr.B", "RKorr.C"]
    assert "RSI_ON(#ABSOLUTE, #IPO_FAST)" in (tmp_path / "hil_bench.src").read_text()
    assert "Timeout = 10" in (tmp_path / "hil_bench_rsi.md").read_text()
