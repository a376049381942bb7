"""The vision unit's driver against its emulator with faults on the wire, in the unit, and in its clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from hil.config.rig import Vmu, VmuLine
from hil.core.clock import Order
from hil.core.messages import PoseFrame
from hil.drivers.vmu.driver import Rs422Vmu
from hil.errors import DeviceError, LinkLost, LinkTimeout, ProtocolError
from hil.parts.emulation.lock_step import LockStepConductor
from hil.parts.emulation.vision_unit import VmuEmulator
from tests.support.lock_step import in_lock_step, serving

POSE = PoseFrame(0, 0.0, 0.0, np.array([0.1, -0.2, 3.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(6) * 1e-4)


@dataclass
class Desk:
    """A driver, and the time."""

    clock: LockStepConductor
    vmu: Rs422Vmu

    def poll_until(self, done: Callable[[list[PoseFrame]], bool]) -> list[PoseFrame]:
        """Poll at 100 Hz until ``done(all frames)``, 10 s at most."""
        frames: list[PoseFrame] = []
        give_up_s = self.clock.now_s() + 10.0
        while not done(frames):
            assert self.clock.now_s() < give_up_s, self.vmu.counters()
            self.clock.sleep(0.01)
            frames += self.vmu.poll(self.clock.now_s())
        return frames

    def error(self) -> DeviceError:
        """Poll until an error comes; return it."""
        with pytest.raises(DeviceError) as caught:
            self.poll_until(lambda frames: False)
        return caught.value


@contextmanager
def emulated(
    fault: str = "", value: float | None = None, **changes: object
) -> Iterator[tuple[VmuEmulator, Rs422Vmu, LockStepConductor]]:
    """Give an emulator at work in a thread, and a driver on its line that is not open yet, in lock-step.

    fault, value: that the emulator has from its first frame on.
    """
    with in_lock_step() as clock:
        emulator = VmuEmulator(Vmu(driver="rs422", rate_hz=25.0), clock, lambda t_s: POSE)
        if fault:
            emulator.faults.on(fault, value=value)
        line = {"driver": "rs422", "rs422": VmuLine(port=emulator.start()["vmu"])}
        with (
            serving(clock, emulator, Order.CAMERAS),
            closing(Rs422Vmu(Vmu.model_validate(line | changes), clock)) as vmu,
        ):
            yield emulator, vmu, clock


@pytest.mark.parametrize(
    ("fault", "value", "counter"),
    [
        ("freeze", None, "duplicates"),
        ("link_down", None, ""),
        ("drop", 1.0, ""),
        ("corrupt", 1.0, "crc_errors"),
        ("clock_jump", 10.0, "clock_jumps"),
    ],
)
@pytest.mark.parametrize("unit_clock", ["shared", "own"])
def test_fault_of_the_unit_or_its_wire_is_no_sign_of_life(
    fault: str, value: float | None, counter: str, unit_clock: str
) -> None:
    with emulated(clock=unit_clock) as (emulator, vmu, clock):
        vmu.open(clock.now_s())
        desk = Desk(clock, vmu)
        desk.poll_until(lambda frames: len(frames) >= 5)
        emulator.faults.on(fault, value=value)
        error = desk.error()
    assert isinstance(error, LinkTimeout)
    if counter:
        assert vmu.counters()[counter] > 0
        assert f"{counter} " in str(error)
    of_clock = counter == "clock_jumps" and unit_clock == "shared"
    assert ("from the future: the unit's clock is ahead" in str(error)) == of_clock


def test_shared_clock_that_is_1000_ppm_fast_is_named_when_its_stamps_are_ahead() -> None:
    with emulated() as (emulator, vmu, clock):
        vmu.open(clock.now_s())

        def fly() -> None:
            while clock.now_s() < 300.0:
                emulator.faults.on("clock_jump", value=1e-3 * clock.now_s())
                clock.sleep(0.1)
                vmu.poll(clock.now_s())

        with pytest.raises(LinkTimeout, match="from the future: the unit's clock is ahead"):
            fly()


def test_unit_clock_that_jumps_back_is_not_trusted() -> None:
    with emulated("clock_jump", 10.0, clock="own") as (emulator, vmu, clock):
        vmu.open(clock.now_s())
        desk = Desk(clock, vmu)
        frames = desk.poll_until(lambda frames: len(frames) >= 5)
        assert all(0.0 <= frame.received_s - frame.t_s < 1.0 for frame in frames[1:])
        emulator.faults.clear()
        error = desk.error()
    assert isinstance(error, LinkTimeout)
    assert "clock_jumps" in str(error)


def test_lost_repeated_and_late_frames_are_counted_and_survived() -> None:
    with emulated(timeout_s=5.0) as (emulator, vmu, clock):
        vmu.open(clock.now_s())
        desk = Desk(clock, vmu)
        emulator.faults.on("duplicate", value=0.5)
        emulator.faults.on("drop", value=0.3)
        desk.poll_until(lambda frames: vmu.counters()["duplicates"] > 1 and vmu.counters()["lost"] > 1)
        emulator.faults.clear()
        emulator.faults.on("delay", value=0.2)
        desk.poll_until(lambda frames: len(frames) > 3)
        clock.sleep(0.3)
        emulator.faults.clear()  # the next ones overtake those under way
        desk.poll_until(lambda frames: vmu.counters()["late"] > 1)


def test_unit_is_identified_by_its_reply() -> None:
    named = {"vendor": "hil", "serial": "VMU-0001", "firmware": "1.4"}
    with emulated(identity=named) as (_, vmu, clock):
        vmu.open(clock.now_s())
        Desk(clock, vmu).poll_until(lambda frames: len(frames) > 2)


@pytest.mark.parametrize(("name", "text", "said"), [("serial", "VMU-0002", "'VMU-0001'"), ("firmware", "2.0", "'1.4'")])
def test_another_unit_is_refused(name: str, text: str, said: str) -> None:
    with emulated(identity={name: text}) as (_, vmu, clock):
        with pytest.raises(ProtocolError, match=f"vmu: wrong unit: {name} {said}, expected '{text}'"):
            vmu.open(clock.now_s())
        with pytest.raises(LinkLost):
            vmu.poll(clock.now_s())


def test_unit_that_does_not_identify_itself_is_refused() -> None:
    with (
        emulated("link_down", identity={"vendor": "hil"}) as (_, vmu, clock),
        pytest.raises(LinkTimeout, match=r"vmu: no identity frame within 2\.5 s"),
    ):
        vmu.open(clock.now_s())
