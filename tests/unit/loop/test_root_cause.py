"""Root cause of a fault: the time to wait for it depends on the fault's kind, never on its text."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hil.core import alarm_table as table
from hil.errors import BenchError, DeviceError, DriveFault, FaultKind, LinkLost, LinkTimeout
from hil.loop.controlled_stop import RootCause

OPEN_INTERLOCK = table.INTERLOCK.trip("io", "open", "closed", "door")


class SteppedRate:
    """A rate whose time advances by 10 ms at each query."""

    paced = True

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        self._now_s += 0.01
        return self._now_s


def cause_found(
    fault: BenchError,
    after_s: float,
    cause: BenchError = OPEN_INTERLOCK,
    chain_opened: bool = False,
    powered: bool = True,
) -> BenchError:
    """Return what is found behind ``fault`` when ``cause`` shows ``after_s`` later."""

    def check(now_s: float) -> None:
        if now_s > after_s:
            raise cause

    loop: Any = SimpleNamespace(
        safety_io=SimpleNamespace(check=check, has_chain=True),
        bench=SimpleNamespace(
            poll_safety_inputs=lambda now_s: None,
            safety=SimpleNamespace(interlock_power=lambda now_s: None),
        ),
    )
    rate: Any = SteppedRate()
    search = RootCause(fault, loop, rate, powered)
    while (found := search.poll(rate.now_s(), chain_opened)) is None:
        pass
    return found


def test_a_fault_before_the_drives_are_powered_is_its_own_cause() -> None:
    fault = DeviceError("vmu.left", "pixel format 'Mono12': the camera has Mono8")
    assert cause_found(fault, after_s=0.0, cause=LinkLost("io", "is not open"), powered=False) is fault


@pytest.mark.parametrize("text", ["safe torque off", "STO active", ""])
def test_a_drive_without_torque_has_the_time_of_a_dead_coupler_whatever_its_fault_is_called(text: str) -> None:
    fault = DriveFault("rails.x", text, FaultKind.TORQUE_OFF)
    assert cause_found(fault, after_s=0.5) is OPEN_INTERLOCK
    assert cause_found(fault, after_s=0.7) is fault


@pytest.mark.parametrize(
    "fault",
    [
        DriveFault("rails.x", "not safe torque off"),
        LinkTimeout("rails.x", "safe torque off"),
        table.SPEED.trip("rails.x", 1.0, 0.0),
    ],
)
def test_any_other_fault_has_the_time_of_the_emergency_stop_alone(fault: BenchError) -> None:
    assert cause_found(fault, after_s=0.03) is OPEN_INTERLOCK
    assert cause_found(fault, after_s=0.1) is fault


def test_a_wire_that_is_gone_is_a_cause_itself() -> None:
    lost = LinkLost("rails.x", "connection closed")
    assert cause_found(lost, after_s=0.0) is lost


def test_a_chain_that_the_stop_itself_has_opened_is_no_cause() -> None:
    fault = table.FOLLOWING_ERROR.trip("rails.x", 0.06, 0.05)
    opened = table.SAFETY_CHAIN.trip("io", "open", "closed")
    assert cause_found(fault, 0.0, opened) is opened
    assert cause_found(fault, 0.0, opened, chain_opened=True) is fault
    assert cause_found(fault, 0.03, OPEN_INTERLOCK, chain_opened=True) is OPEN_INTERLOCK
