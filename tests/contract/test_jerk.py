"""The limit of the jerk on every path to a setpoint: the third difference of what is sent, of each axis and motion."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.checks.compatibility import check_rates
from hil.config.load import load_rig
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, TargetManipulator
from hil.core.clock import SimulatedClock
from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand
from hil.drivers.mock_axes import MockAxes
from hil.errors import BadInput
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.target_stage import HeldAxes
from hil.session import build
from tests.support.operated_bench import Recorded, Script, Session, operate
from tests.support.plain_filters import PLAIN
from tests.support.rows import assert_same_bits
from tests.support.run_settings import make_job

JERK_MPS3, JERK_DEGPS3 = 6.0, 800.0
LIMITED = (
    *(f"rig.rails.{name}.jerk_max_mps3={JERK_MPS3}" for name in RAIL_NAMES),
    *(f"rig.turntable.{name}.jerk_max_degps3={JERK_DEGPS3}" for name in GIMBAL_NAMES),
)
LIMIT = np.array([JERK_MPS3] * 3 + [math.radians(JERK_DEGPS3)] * 3)
INCREMENTAL = ('rig.rails.y.encoder="incremental"', 'rig.turntable.yaw.encoder="incremental"')
MOVING = "initial.velocity_mps=[-0.03, 0.01, 0.0]"
FAST_AXES = "rig.bench.axes_rate_hz=1000.0"


class Motions:
    """Setpoints of each motion of a bench; a motion begins at rest, where its first setpoint is seeded."""

    def __init__(self, session: Session) -> None:
        self.found: list[list[np.ndarray]] = []
        bench = session.runner.loop.bench
        self.dt_s = float(bench.params.dt_s)
        seed, send = bench.seed, bench._send

        def seed_and_begin(now_s: float) -> None:
            seed(now_s)
            self.found.append([np.array(bench.motion.position)])

        def send_and_keep(now_s: float) -> None:
            send(now_s)
            self.found[-1].append(np.array([*bench.accepted.rail_m, *bench.accepted.gimbal_rad]))

        bench.seed, bench._send = seed_and_begin, send_and_keep  # type: ignore[method-assign]

    def worst(self) -> float:
        """Return the largest jerk over the limit of its axis, of all motions that move."""
        ratios = [
            np.abs(np.diff([motion[0]] * 3 + motion, 3, axis=0)).max(axis=0) / self.dt_s**3 / LIMIT
            for motion in self.found
            if np.ptp(motion, axis=0).max() > 1e-3
        ]
        return float(np.max(ratios))


def jerk_of(script: Script, *settings: str, duration_s: float = 3.0, **more: object) -> tuple[float, Session]:
    """Return the largest jerk over its limit in a session under ``script``, and the session."""
    kept: list[Motions] = []
    _, session = operate(
        script, *settings, duration_s=duration_s, prepare=lambda s: kept.append(Motions(s)), **more  # type: ignore[arg-type]
    )  # fmt: skip
    return kept[0].worst(), session


def idle(_: Session) -> None:
    """Give no command."""


def jog(session: Session) -> None:
    """Jog an axis for a second, let it stop, then another one; the session ends by itself."""
    if session.mode in (Mode.STANDBY, Mode.JOGGING):
        if 0.2 < session.now_s < 1.2:
            session.operator.jog("rails.y", 1)
        elif 2.5 < session.now_s < 3.5:
            session.operator.jog("turntable.yaw", -1)
        elif session.now_s > 5.0:
            session.order_once(OperatorCommand.STOP)


def park(session: Session) -> None:
    session.order_once(OperatorCommand.PARK, session.mode is Mode.STANDBY)


def hold(mode: Mode, after_s: float) -> Script:
    """Hold ``after_s`` after ``mode`` began, resume 2 s later."""

    def script(session: Session) -> None:
        session.once("begun", session.mode is mode)
        session.order_once(OperatorCommand.HOLD, session.mode is mode and session.since_s("begun") > after_s)
        session.order_once(OperatorCommand.RESUME, session.since_s("hold") > 2.0)

    return script


PATHS: dict[str, tuple[Script, tuple[str, ...], Mode]] = {
    "closed loop": (idle, (MOVING,), Mode.RUNNING),
    "closed loop, axes at 1 kHz": (idle, (MOVING, FAST_AXES), Mode.RUNNING),
    "hold of a run": (hold(Mode.RUNNING, 1.0), (MOVING,), Mode.HOLD),
    "place": (idle, INCREMENTAL, Mode.PLACING),
    "hold of a placing": (hold(Mode.PLACING, 1.0), INCREMENTAL, Mode.HOLD),
    "jog": (jog, (), Mode.JOGGING),
    "park": (park, (), Mode.PARKING),
}


@pytest.mark.parametrize("path", PATHS)
def test_the_jerk_of_setpoints_is_limited(path: str) -> None:
    script, settings, mode = PATHS[path]
    more = {"plan": (), "attended": True} if path in ("jog", "park") else {}
    worst, session = jerk_of(script, *settings, *LIMITED, **more)
    assert mode in session.seen_modes
    assert 0.1 < worst <= 1.0 + 1e-4


def test_without_the_limit_setpoints_have_steps_of_their_acceleration() -> None:
    worst, _ = jerk_of(idle, MOVING)
    assert worst > 3.0


def test_a_target_is_placed_within_its_limit() -> None:
    axis = {"travel_m": [-0.5, 0.5], "rate_max_mps": 0.2, "acceleration_max_mps2": 0.4, "jerk_max_mps3": JERK_MPS3}
    table = {"driver": "mock", "place_m": [0.2, -0.1, 0.0], "servo": {"gain_per_s": 25.0, "lag_s": 0.008}}
    settings = TargetManipulator.model_validate(table | dict.fromkeys(RAIL_NAMES, axis), strict=False)
    axes = Recorded(MockAxes("target", settings))
    target, rate = HeldAxes(axes, settings), SimulatedRate(SimulatedClock(), 0.02)
    target.open(0.0)
    target.place(rate.wait, 0.02)
    assert axes.stood_at is not None
    sent = [axes.stood_at] * 3 + [position for _, position in axes.sent]
    worst = np.abs(np.diff(sent, 3, axis=0)).max() / 0.02**3 / JERK_MPS3
    assert 0.1 < worst <= 1.0 + 1e-4


@pytest.mark.parametrize("more", [(), (FAST_AXES,)])
def test_the_compiled_loop_limits_the_jerk_bit_by_bit_like_the_cycle_in_python(more: tuple[str, ...]) -> None:
    job = make_job(3.0, (MOVING, *more, *LIMITED))
    histories = []
    for compiled in (True, False):
        with build.runner(replace(job, compiled=compiled)) as runner:
            histories.append(runner.run().history)
    assert_same_bits(*histories)


def test_the_mean_is_taken_ahead_by_its_delay() -> None:
    job = make_job(20.0, (MOVING, *PLAIN, *LIMITED))
    with build.runner(job) as runner:
        history = runner.run().history
    with build.runner(make_job(20.0, (MOVING, *PLAIN))) as runner:
        before = runner.run().history
    # relative to the truth of each flight, as they do not fire the same
    late, direct = (rows["setpoint"]["rail_m"] - rows["truth"]["r_CT_H"] for rows in (history[500:], before[500:]))
    late -= direct
    assert np.abs(late).max() < 1e-4  # a delay of 0.09 s at 0.03 m/s would be 3e-3


def test_a_limit_that_averages_more_setpoints_than_are_kept_is_rejected() -> None:
    job = make_job(1.0, (FAST_AXES, "rig.rails.x.jerk_max_mps3=1.3"))
    assert [f"{problem.key} {problem.message}" for problem in check_rates(job.scenario, job.rig)] == [
        "rig.rails.x.jerk_max_mps3 1.3: allowed from 2.34 at 1000 setpoints per second"
    ]
    with pytest.raises(BadInput, match=r"jerk_max_mps3 1: allowed from 1.2, twice the acceleration limit per second"):
        load_rig("mock", ("rig.rails.x.jerk_max_mps3=1.0",))
