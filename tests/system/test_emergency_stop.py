"""The emergency stop pressed in mid-run on the emulated bench: the run ends, and the axes stand."""

from __future__ import annotations

import time

import pytest

from hil.core.modes import Mode
from hil.parts.emulation.fault_injection import FaultControl
from hil.session.build import check
from hil.session.build import runner as make_runner
from hil.session.warm_up import warm_up
from tests.support.run_settings import NEAR, UNHURRIED, make_job

# the fault matrix presses it in the normal run
pytestmark = [pytest.mark.wires, pytest.mark.slow]

WIRES = (*NEAR, *UNHURRIED)


def test_emergency_stop_ends_the_run_by_name_and_the_axes_stand() -> None:
    """It is pressed by the control port."""
    announced: list[str] = []
    job = make_job(20.0, WIRES, rig="emulated", seed=1)
    check(job)
    warm_up(job)
    pressed_s: list[float] = []

    def press_in_mid_run(mode: Mode, share: float) -> None:
        if mode is Mode.RUNNING and share > 0.0 and not pressed_s:
            line = next(text for text in announced if ": io" in text)
            control = FaultControl(line.rpartition("io.faults on ")[2].split(",")[0])
            assert control.send("on estop") == "ok"
            control.close()
            pressed_s.append(time.monotonic())

    with make_runner(job, press_in_mid_run, announced.append) as runner:
        outcome = runner.run()
        assert pressed_s, outcome.stop
        took_s = time.monotonic() - pressed_s[0]
    assert outcome.stop == "bench: emergency stop pressed, allowed released and reset"
    assert outcome.mode is Mode.SAFE_STOP
    assert took_s < 3.0
