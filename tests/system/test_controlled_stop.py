"""Stops in lock-step: drives that do not stop, gravity, holding brakes, with and without an operator."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from hil.api.jobs import IN_LOCK_STEP
from hil.core.modes import Mode
from hil.core.operator_commands import Operator, OperatorCommand
from hil.loop.controlled_stop import OFF_RAMP_S, REACTION_S
from hil.loop.runner import Runner
from hil.parts.emulation.fault_injection import FaultControl
from hil.parts.emulation.lock_step import LockStepConductor
from hil.parts.wires.wired import WiredBench
from hil.session import build
from hil.session.warm_up import warm_up
from tests.support.lock_step import GRID_S
from tests.support.run_settings import make_job

PLAN = (OperatorCommand.HOME, OperatorCommand.ARM, OperatorCommand.START)
START = (
    "initial.position_m=[2.0, -0.12, 0.12]",
    "rig.rails.x.park_m=2.0",
    "rig.rails.y.park_m=-0.12",
    "rig.rails.z.park_m=0.12",
)
LOCAL_ENABLE = ("rig.io.inputs.local_enable=3",)
LOCAL_ENABLE_OFF = "io on local_enable_off"
DETECTED_S = 0.2
"""From the moment in which an axis leaves its ramp until its torque is off: time above the ramp, chain, relay."""


@dataclass
class Session:
    """A run in lock-step, what has happened to its axes, and a parallel script in bench time."""

    bench: WiredBench
    runner: Runner
    operator: Operator

    def fault(self, device: str, line: str) -> None:
        control = FaultControl(self.bench.addresses[f"{device}.faults"])
        control.send(line)
        control.close()

    @property
    def mode(self) -> Mode:
        return self.runner.safety.modes.mode

    @property
    def now_s(self) -> float:
        return self.bench.clock.now_s()

    def position(self, device: str) -> np.ndarray:
        assert self.bench.board is not None
        return self.bench.board.read(device, self.now_s)[0]

    def speed(self, device: str) -> float:
        assert self.bench.board is not None
        return float(np.abs(self.bench.board.read(device, self.now_s)[1]).max())

    def torque(self) -> bool:
        assert self.bench.board is not None
        return self.bench.board.read_chain(self.bench.clock).torque

    def wait(self, reached: Callable[[], bool], limit_s: float = 30.0) -> float:
        """Wait until ``reached``; return how long it took, s."""
        begun_s = self.now_s
        while not reached():
            assert self.now_s - begun_s < limit_s, f"not reached: {self.runner.safety.alarms.all()}"
            self.bench.clock.sleep(0.001)
        return self.now_s - begun_s

    def pause(self, duration_s: float) -> None:
        self.bench.clock.sleep(duration_s)


def run(attended: bool, script: Callable[[Session], None], *settings: str) -> None:
    """Run a session, and ``script`` in parallel from RUNNING on."""
    job = make_job(60.0, (*START, *IN_LOCK_STEP, *settings), rig="emulated")
    warm_up(job)
    with build.wired_bench(job) as bench:
        assert isinstance(bench.clock, LockStepConductor)
        operator = Operator(PLAN, attended)
        made = Session(bench, bench.runner(operator=operator), operator)
        ended, failures = threading.Event(), list[BaseException]()

        def act() -> None:
            try:
                made.wait(lambda: made.mode is Mode.RUNNING)
                script(made)
            except BaseException as error:
                failures.append(error)
            while not ended.is_set():
                operator.submit(OperatorCommand.STOP)
                made.pause(0.1)

        thread = bench.clock.start_thread(act, "script")
        made.runner.run()
        ended.set()
        bench.clock.join(thread, 30.0)
        if failures:
            raise failures[0]


def cases(*of_one_case: object, slow: int = 0) -> list[object]:
    """Return the cases attended and unattended; those from number ``slow`` on run with the slow tests only."""
    every = [(one, attended) for one in of_one_case for attended in (True, False)]
    return [pytest.param(*case, marks=[pytest.mark.slow] if k >= slow else []) for k, case in enumerate(every)]


@pytest.mark.parametrize(("axis", "attended"), cases("rails.x", "rails.z", "turntable.yaw", slow=1))
def test_drive_that_does_not_follow_a_safe_stop_loses_its_torque(axis: str, attended: bool) -> None:
    device, name = axis.split(".")

    def script(made: Session) -> None:
        made.fault(device, f"on runaway {name} {0.2 if device == 'rails' else 15.0}")
        made.wait(lambda: made.mode is Mode.SAFE_STOP)
        took_s = made.wait(lambda: not made.torque())
        assert took_s < REACTION_S + DETECTED_S + GRID_S
        assert took_s > OFF_RAMP_S
        made.wait(lambda: made.speed(device) < 2e-3, 2.0)
        print(f"{axis}: torque off {took_s:.3f} s after the safe stop")  # noqa: T201
        assert made.runner.safety.alarms.latched()

    run(attended, script)


WIDE_WINDOW = ("rig.rails.drive_following_error_max_m=100", "rig.turntable.drive_following_error_max_deg=1000")
"""Drives that do not watch their following error."""


@pytest.mark.parametrize("axis", ["rails.y", pytest.param("turntable.pitch", marks=pytest.mark.slow)])
def test_an_axis_with_a_reversed_encoder_loses_its_torque_by_the_guard_alone(axis: str) -> None:
    device, name = axis.split(".")

    def script(made: Session) -> None:
        made.fault(device, f"on reversed {name}")
        made.wait(lambda: made.mode is Mode.SAFE_STOP or not made.torque())
        made.wait(lambda: not made.torque())
        opened_s = made.now_s
        took_s = opened_s - min(alarm.t_s for alarm in made.runner.safety.alarms.all())
        print(f"{axis}: torque off {took_s:.3f} s after the alarm")  # noqa: T201
        assert took_s < REACTION_S + DETECTED_S + GRID_S
        made.wait(lambda: made.speed(device) < 2e-3, 2.0)

    run(False, script, *WIDE_WINDOW)


FIRST_CAUSES = ("rails on drive_fault y", "turntable on drive_fault yaw", "vmu on link_down", LOCAL_ENABLE_OFF, "stop")


@pytest.mark.parametrize(("first", "attended"), cases(*FIRST_CAUSES, slow=0))
def test_drive_that_does_not_stop_loses_its_torque_for_any_stop_cause(first: str, attended: bool) -> None:
    def script(made: Session) -> None:
        made.wait(lambda: made.speed("rails") > 0.025)
        made.fault("rails", "on runaway x 0")  # at its present speed: no following error gives it away
        device, _, line = first.partition(" ")
        begun_s = made.now_s
        if line:
            made.fault(device, line)
        else:
            made.operator.submit(OperatorCommand.STOP)
        made.wait(lambda: not made.torque())
        opened_s = made.now_s
        alarms = made.runner.safety.alarms.all()
        stopped_s = min((alarm.t_s for alarm in alarms), default=begun_s) if line else begun_s
        took_s = opened_s - stopped_s
        print(f"{first}: torque off {took_s:.3f} s after the stop began")  # noqa: T201
        assert took_s < REACTION_S + DETECTED_S + GRID_S
        made.wait(lambda: made.speed("rails") < 2e-3, 2.0)

    run(attended, script, *LOCAL_ENABLE)


@pytest.mark.parametrize(
    ("line", "attended"),
    cases("io on estop", "rails on drive_fault x", "turntable on link_down", LOCAL_ENABLE_OFF, "stop"),
)
def test_a_gravity_loaded_axis_does_not_drop_in_any_stop(line: str, attended: bool) -> None:
    device, _, order = line.partition(" ")

    def script(made: Session) -> None:
        before = made.position("rails")[2]
        if order:
            made.fault(device, order)
        else:
            made.operator.submit(OperatorCommand.STOP)
        made.wait(lambda: not made.torque(), 3.0)
        made.wait(lambda: made.speed("rails") < 1e-3, 2.0)
        made.pause(0.3)
        drop = before - made.position("rails")[2]
        print(f"{line}: z has sunk by {1e3 * drop:.2f} mm")  # noqa: T201
        assert abs(drop) < 0.002

    run(attended, script, *LOCAL_ENABLE)


BRAKES = ("rig.io.coils.brakes_released=26", "rig.io.inputs.brakes_closed=2")


def test_brakes_that_are_not_confirmed_are_an_alarm_and_a_watched_standstill() -> None:
    def script(made: Session) -> None:
        made.fault("io", "on brakes_open")
        made.operator.submit(OperatorCommand.STOP)  # all drives follow their ramps
        latched = made.runner.safety.alarms.latched
        made.wait(lambda: any(alarm.quantity == "holding brakes" for alarm in latched()), 5.0)
        before = made.position("rails")[2]
        made.pause(0.5)
        assert made.torque()
        assert abs(made.position("rails")[2] - before) < 1e-3
        made.fault("io", "off brakes_open")
        made.wait(lambda: not made.torque(), 2.0)
        made.pause(0.3)
        assert abs(made.position("rails")[2] - before) < 0.002

    run(True, script, *BRAKES)
