"""The safety chain in the cycle, on a coupler in memory."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.tables.io import Io
from hil.core.clock import SimulatedClock, WallClock
from hil.core.messages import IoOutputs
from hil.drivers.io.mock import MockIo
from hil.errors import LinkTimeout, SafetyTrip
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.safety_io_stage import CLOSING_TIME_S, SafetyIoStage
from hil.parts.emulation.shared_state import ChainState, SharedAxisState

STEP_S = 0.02


class Desk:
    def __init__(self) -> None:
        self.io = MockIo(Io(driver="mock", thruster_lines=4))
        self.on = np.zeros(4, np.int64)
        self.stage = SafetyIoStage(self.io, self.on)
        self.rate = SimulatedRate(SimulatedClock(), STEP_S)

    def step(self) -> None:
        self.stage.check(self.rate.wait().now_s)


@pytest.fixture
def desk() -> Desk:
    desk = Desk()
    desk.stage.open(desk.rate)
    return desk


def test_opening_closes_the_chain_and_takes_no_simulated_time(desk: Desk) -> None:
    assert desk.rate.now_s() == 0.0
    assert desk.io.read(0.0).chain_closed
    for _ in range(500):
        desk.step()


@pytest.mark.parametrize(
    ("attribute", "value", "text"),
    [
        ("pressed", True, "io: emergency stop pressed, allowed released"),
        ("open_interlocks", ("door",), "io: interlock door open, allowed closed"),
    ],
)
def test_what_people_do_trips_in_the_next_cycle_and_forbids_opening(
    desk: Desk, attribute: str, value: object, text: str
) -> None:
    desk.step()
    assert desk.stage.emergency_input(0.0) == (False, False)
    setattr(desk.io, attribute, value)
    if attribute == "pressed":  # reported by the safety monitor, not by this check
        desk.step()
        assert desk.stage.emergency_input(0.0) == (True, False)
    else:
        with pytest.raises(SafetyTrip) as caught:
            desk.step()
        assert str(caught.value) == text
    with pytest.raises(SafetyTrip) as caught:
        desk.stage.open(desk.rate)
    assert str(caught.value) == text


def test_a_chain_that_opens_by_itself_trips(desk: Desk) -> None:
    desk.io.outputs = desk.io.outputs._replace(enable=False)
    desk.step()  # it takes some milliseconds
    with pytest.raises(SafetyTrip, match="io: safety chain open, allowed closed"):
        desk.step()


def test_a_chain_that_does_not_close_is_given_up() -> None:
    desk = Desk()
    desk.io._pump_timeout_s = -1.0  # a relay for which no pump is fast enough
    with pytest.raises(SafetyTrip, match="io: safety chain open 1 s after enable, allowed closed"):
        desk.stage.open(desk.rate)
    assert CLOSING_TIME_S < desk.rate.now_s() < CLOSING_TIME_S + 3 * STEP_S


def test_failure_of_the_link_reaches_the_cycle(desk: Desk) -> None:
    desk.io.fail(LinkTimeout("io", "no answer for 0.5 s"))
    with pytest.raises(LinkTimeout, match="io: no answer"):
        desk.step()


def test_thrusters_are_mirrored_to_their_lines(desk: Desk) -> None:
    desk.on[:] = (0, 1, 0, 1)
    desk.stage.mirror_thrusters(0.0)
    assert desk.io.outputs == IoOutputs(True, b"\0\1\0\1")
    desk.on[:] = 0
    desk.stage.mirror_thrusters(0.02)
    assert desk.io.outputs.thrusters == b"\0\0\0\0"
    desk.on[0] = 1
    desk.stage.mirror_thrusters(0.04)
    desk.stage.stop(0.06)
    assert desk.io.outputs == IoOutputs(False, b"")


def test_brakes_stay_released_when_a_thruster_fires_and_close_with_the_chain(desk: Desk) -> None:
    desk.stage.release_brakes(True, 0.0)
    desk.on[0] = 1
    desk.stage.mirror_thrusters(0.02)
    assert desk.io.outputs == IoOutputs(True, b"\1\0\0\0", True)
    assert desk.stage.brakes_closed(0.02) is None  # no contact reads them
    desk.stage.release_brakes(False, 0.04)
    assert desk.io.outputs == IoOutputs(True, b"\1\0\0\0")
    desk.stage.release_brakes(True, 0.06)
    desk.stage.stop(0.08)
    assert not desk.io.outputs.brakes_released


def test_the_board_carries_the_chain_to_the_drives() -> None:
    board, clock = SharedAxisState.create(), WallClock()
    try:
        assert board.read_chain(clock).closed  # no bench has such a device
        board.write_chain(ChainState(*[False] * 3), clock.now_s())
        assert not board.read_chain(clock).closed
        board.write_chain(ChainState(*[True] * 3), clock.now_s())
        assert board.read_chain(clock).closed
        board.write_chain(ChainState(*[True] * 3), clock.now_s() - 1.0)
        assert not board.read_chain(clock).closed  # the reporting process is dead
    finally:
        board.close()
