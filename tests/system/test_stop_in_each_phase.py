"""A stop asked for in each mode and phase of an attended bench: time to rest, and the chain; devices that lose power.

``pytest -s tests/system/test_stop_in_each_phase.py`` prints the times.
"""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hil.core.modes import Mode
from hil.core.operator_commands import Operator, StopCommanded
from hil.parts.commissioning.steps import Commissioning, CommissioningPlan
from hil.parts.emulation.operator import AutoOperator
from hil.session import build
from hil.session.warm_up import warm_up
from tests.support.run_settings import UNHURRIED, make_job
from tests.system.test_killed_in_each_mode import DROP_M, SETTINGS, STANDING_MPS, Bench, bench, stop_times

pytestmark = [pytest.mark.wires, pytest.mark.slow]

STANDS_S = 1.3  # a ramp from 0.25 m/s, standstill, and a busy computer
TORQUE_OFF_S = 2.0  # after the brakes have closed
PHASES = ("standby", "homing", "jogging", "placing", "armed", "running", "hold", "abort", "retreat", "parking")
AWAITS_POSES = ("armed", "running", "hold")
_BRAKING_S, _RETREATING_S = 0.5, 6.0


def bring_to(made: Bench, phase: str) -> None:
    """Lead the bench into ``phase``; abort and retreat are those of the chaser, while running."""
    made.bring_to("running" if phase in ("abort", "retreat") else phase)
    if phase in ("abort", "retreat"):
        made.order("abort")
        time.sleep(_BRAKING_S if phase == "abort" else _RETREATING_S)


@pytest.mark.parametrize("phase", PHASES)
def test_stop_brings_the_axes_to_rest_before_the_chain_opens(tmp_path: Path, phase: str) -> None:
    with bench(tmp_path, lambda made: bring_to(made, phase)) as made:
        (z_m, z_mps), speed = made.z(), made.speed()
        made.order("stop")
        stands, opened = stop_times(made)
        time.sleep(0.3)
        drop_m = z_m - made.z()[0]
        assert stands is not None
        assert opened is not None
        print(  # noqa: T201
            f"{phase:9}: {1e3 * speed:4.0f} mm/s, stands {1e3 * stands:4.0f} ms, torque off {1e3 * opened:4.0f} ms, "
            f"z drop {1e3 * drop_m:+.2f} mm"
        )
        assert stands < STANDS_S
        assert stands <= opened < TORQUE_OFF_S
        assert made.speed() < STANDING_MPS
        if abs(z_mps) < 1e-3:
            assert abs(drop_m) < DROP_M


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hanging"])
@pytest.mark.parametrize("device", ["turntable", "vmu", "io"])
@pytest.mark.parametrize("phase", ["jogging", "placing", "armed", "running", "hold", "parking"])
def test_device_that_loses_its_power_stops_the_bench(
    tmp_path: Path, phase: str, device: str, how: signal.Signals
) -> None:
    """Poses are awaited while armed, running and on hold, none to move axes alone. The rails stand otherwise."""
    with bench(tmp_path, lambda made: bring_to(made, phase), (*SETTINGS, *UNHURRIED)) as made:
        os.kill(made.emulated.pids[device], how)
        begun = time.monotonic()
        while made.modes[-1] == phase and time.monotonic() - begun < 3.0:
            time.sleep(0.002)
        noticed = time.monotonic() - begun
        after = made.modes[-1]
        time.sleep(1.5)
        speed = made.speed() if device != "turntable" else float(abs(made.rail_rates()).max())
        print(  # noqa: T201
            f"{phase:9} {device:9} {how.name}: {after} after {1e3 * noticed:4.0f} ms, {1e3 * speed:.1f} mm/s 1.5 s "
            f"later, torque {'on' if made.has_torque() else 'off'}; {'; '.join(made.alarms) or 'no alarm'}"
        )
        if device != "vmu" or phase in AWAITS_POSES:
            assert after == Mode.SAFE_STOP.value
            assert made.alarms[0].startswith(f"{device}: ")
            assert speed < STANDING_MPS
            assert device == "io" or not made.has_torque()
        else:
            assert after != Mode.SAFE_STOP.value, made.alarms
        os.kill(made.emulated.pids[device], signal.SIGCONT) if how is signal.SIGSTOP else None


COMMISSIONED = ("emergency stop", "homing", "rails.x: sign and scale", "question", "dry run")
_INTO_STEP_S = 0.4  # the axis moves, or the button is pressed


class StoppingOperator(Operator):
    """Prompt and operator of a commissioning, who stops it shortly after ``step`` has begun."""

    def __init__(self, step: str) -> None:
        super().__init__(attended=True)
        self._step = step
        self._due_s = math.inf
        self.stopped_s = math.nan
        """Time by ``time.monotonic`` at which it was stopped."""

    def show(self, text: str) -> None:
        self._begin(text.removeprefix("-- "))

    def ask(self, question: str) -> bool:
        if self._step == "question" and "rails.x" in question:
            self._begin("question")
            time.sleep(2.0 * _INTO_STEP_S)
        if "start pose" in question:
            self._begin("dry run")
        return True

    def _begin(self, step: str) -> None:
        if step == self._step and not (step == "dry run" and self._due_s < math.inf):
            self._due_s = time.monotonic() + _INTO_STEP_S

    def poll(self, now_s: float) -> None:
        if time.monotonic() >= self._due_s:
            self.stopped_s = time.monotonic()
            raise StopCommanded


@pytest.mark.parametrize("step", COMMISSIONED)
def test_stop_in_a_commissioning_brings_the_axes_to_rest_and_opens_the_chain(step: str) -> None:
    in_view = [setting for setting in SETTINGS if "rails.y.park" not in setting]
    settings = (*in_view, *UNHURRIED)
    job = make_job(0.02, settings, rig="emulated")
    warm_up(job)
    operator, ended = StoppingOperator(step), threading.Event()
    seen: list[tuple[float, float, bool]] = []
    with build.wired_bench(job) as wired:
        board, clock = wired.board, wired.clock
        assert board is not None

        def watch() -> None:
            while not ended.is_set():
                rates = [board.read(device, clock.now_s())[1] for device in ("rails", "turntable")]
                seen.append((time.monotonic(), float(np.abs(rates).max()), board.read_chain(clock).torque))
                time.sleep(0.001)

        watching = threading.Thread(target=watch)
        watching.start()
        try:
            button = AutoOperator(board, wired.addresses)
            with pytest.raises(StopCommanded):
                Commissioning(
                    wired.runner(operator=operator), job.rig.value, operator, CommissioningPlan(range(6)), button
                ).run()
            time.sleep(1.0)
        finally:
            ended.set()
            watching.join()
    after = [(t - operator.stopped_s, speed, torque) for t, speed, torque in seen if t >= operator.stopped_s]
    stands = next(t for k, (t, *_) in enumerate(after) if all(speed < STANDING_MPS for _, speed, _ in after[k:]))
    opened = next(t for k, (t, *_) in enumerate(after) if not any(torque for *_, torque in after[k:]))
    print(  # noqa: T201
        f"commissioning, {step}: {1e3 * after[0][1]:4.0f} mm/s, stands {1e3 * stands:4.0f} ms, "
        f"torque off {1e3 * opened:4.0f} ms"
    )
    assert stands < STANDS_S
    assert opened < TORQUE_OFF_S
