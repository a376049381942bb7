"""Steps of commissioning on a mock bench: findings, and no motion after a failure."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from hil.core.modes import Mode
from hil.drivers.io.mock import MockIo
from hil.errors import LinkTimeout, SafetyTrip
from hil.loop.runner import Runner
from hil.loop.safety_io_stage import SafetyIoStage
from hil.parts.commissioning.emergency_stop import ChainTests
from hil.parts.commissioning.prompt import ScriptedPrompt, StepFailed
from hil.parts.commissioning.steps import Commissioning, CommissioningPlan, Findings, TruePosition
from hil.session import build
from tests.support.run_settings import make_job

STEP_S = 0.02
X, Y, YAW = 0, 1, 5
OTHERS = (1, 2, 3, 4)


@dataclass
class Button:
    """Emergency stop of the mock coupler. dead: its wire is broken."""

    io: MockIo
    dead: bool = False
    presses: int = 0

    def press(self) -> None:
        self.presses += 1
        self.io.pressed = not self.dead

    def release(self) -> None:
        self.io.pressed = False


@dataclass
class Trial:
    """One commissioning; ``fails``: the failed step."""

    prompt: ScriptedPrompt
    found: Findings | None = None
    fails: StepFailed | None = None
    calls: list[str] = field(default_factory=list)
    places: list[np.ndarray] = field(default_factory=list)
    mode: Mode = Mode.OFF
    presses: int = 0


Prepare = Callable[[Runner, Trial, Button], None]


def commissioned(
    axes: tuple[int, ...],
    *settings: str,
    others: tuple[int, ...] = (),
    answer: Callable[[str], bool] = lambda _: True,
    prepare: Prepare = lambda *_: None,
    true_position: TruePosition | None = None,
    ends: bool = False,
) -> Trial:
    job = make_job(STEP_S, settings)
    trial = Trial(ScriptedPrompt(answer))
    with build.runner(job) as runner:
        lines, bench = runner.loop.safety_io, runner.loop.bench
        assert isinstance(lines, SafetyIoStage)
        assert isinstance(lines.io, MockIo)
        button = Button(lines.io)
        stop, close, send = bench.stop, bench.close, bench._send
        bench.stop = lambda now_s: (trial.calls.append("stop"), stop(now_s))[1]  # type: ignore[method-assign,func-returns-value]
        bench.close = lambda: (trial.calls.append("close"), close())[1]  # type: ignore[method-assign,func-returns-value]

        def sent(now_s: float) -> None:
            send(now_s)
            trial.places.append(bench.motion.position.copy())

        bench._send = sent  # type: ignore[method-assign]
        prepare(runner, trial, button)
        plan = CommissioningPlan(axes, others, ends)
        steps = Commissioning(runner, job.rig.value, trial.prompt, plan, button, true_position)
        try:
            trial.found = steps.run()
        except StepFailed as failure:
            trial.fails = failure
        finally:
            trial.mode, trial.presses = runner.safety.modes.mode, button.presses
    return trial


def test_axes_are_found_in_order_one_at_a_time_and_stand_where_they_stood() -> None:
    trial = commissioned((X, YAW))
    assert trial.found is not None
    x, yaw = trial.found.axes
    assert (x.name, yaw.name) == ("rails.x", "turntable.yaw")
    assert abs(x.scale_error) < 1e-3
    assert abs(yaw.scale_error) < 1e-3
    assert 0.0 < x.following_error_max < 1e-3
    assert trial.found.dry_run is None  # four axes are left
    places = np.array(trial.places)
    way = np.ptp(places, axis=0)
    np.testing.assert_allclose(way, [0.02, 0.0, 0.0, 0.0, 0.0, math.radians(2.0)], atol=1e-9)
    speed = np.abs(np.diff(places, axis=0)).max(axis=0) / STEP_S
    assert speed[X] <= 0.02 + 1e-9
    assert speed[YAW] <= math.radians(2.0) + 1e-9
    assert not ((np.diff(places[:, X]) != 0.0) & (np.diff(places[:, YAW]) != 0.0)).any()
    np.testing.assert_allclose(places[-1], places[0], atol=1e-4)
    assert trial.calls == ["stop", "close"]


@pytest.mark.parametrize(
    ("without_pose", "text"),
    [(250, "250 frames without a pose: is the target in view from here?"), (0, "no frame within 5 s")],
)
def test_unit_that_answers_without_a_pose_is_distinguished_from_a_silent_one(without_pose: int, text: str) -> None:
    def sees_nothing(runner: Runner, trial: Trial, _: Button) -> None:
        runner.source.poll = lambda now_s: []  # type: ignore[method-assign,assignment]
        runner.source.counters = lambda: {"no_pose": without_pose}  # type: ignore[method-assign]

    with pytest.raises(LinkTimeout) as error:
        commissioned((X,), prepare=sees_nothing)
    assert str(error.value) == f"vmu: {text}"


def test_steps_come_in_their_order() -> None:
    trial = commissioned((X, YAW), others=OTHERS)
    titles = [line for line in trial.prompt.lines if line.startswith("-- ")]
    assert titles == [
        "-- emergency stop",
        "-- identity of the devices",
        "-- rails.x: sign and scale",
        "-- turntable.yaw: sign and scale",
        "-- limits",
        "-- dry run",
    ]
    assert trial.presses == 1


def test_with_all_axes_in_order_the_dry_run_goes_a_quarter_as_fast_as_allowed() -> None:
    trial = commissioned((X,), "rig.rails.x.rate_max_mps=0.2", others=(*OTHERS, YAW))
    assert trial.found is not None
    assert trial.found.dry_run is not None
    assert trial.found.dry_run[X] > 0.0
    places = np.array(trial.places)
    speed = np.abs(np.diff(places[:, X])) / STEP_S
    assert 0.04 < speed.max() <= 0.05 + 1e-9
    assert np.ptp(places[:, X]) == pytest.approx(0.1 + 0.02, abs=0.005)  # the straight piece, and the try before


def test_bench_of_a_floating_vehicle_moves_no_axis() -> None:
    job, prompt = make_job(STEP_S, scenario="planar-floating", rig="mock-floating"), ScriptedPrompt()
    with build.runner(job) as runner:
        lines = runner.loop.safety_io
        assert isinstance(lines, SafetyIoStage)
        assert isinstance(lines.io, MockIo)
        plan = CommissioningPlan((), tuple(range(6)), ends=False)
        found = Commissioning(runner, job.rig.value, prompt, plan, Button(lines.io), None).run()
        lines.io.open(runner.now_s())
        ChainTests(runner, job.rig.value, prompt, 0)._test_torque(lines)  # of no drive
    assert found.dry_run is not None
    assert not found.dry_run.any()
    assert "the vehicle floats: no axis moves, its thrusters are not tested" in prompt.lines
    assert not any("without torque" in line for line in prompt.lines)


def test_ends_of_the_travel_are_approached_when_asked_for() -> None:
    trial = commissioned((YAW,), ends=True)
    assert trial.fails is None
    yaw = np.degrees(np.array(trial.places)[:, YAW])
    assert yaw.min() == pytest.approx(-59.5, abs=1e-6)
    assert yaw.max() == pytest.approx(59.5, abs=1e-6)
    assert sum("Is its limit switch still free?" in question for question in trial.prompt.questions) == 2


def test_incremental_axis_is_homed_before_it_is_moved() -> None:
    trial = commissioned((Y,), 'rig.rails.y.encoder="incremental"', "rig.rails.y.home_m=0.05")
    assert trial.fails is None
    assert "rails.y: not homed, will search for the home switch" in trial.prompt.lines
    assert any("Homed: rails.y at +" in question for question in trial.prompt.questions)


@pytest.mark.parametrize(
    ("words", "step"),
    [
        ("without power", "io: emergency stop"),
        ("Has the carriage moved along rails.x by +20.00 mm", "rails.x: sign and scale"),
        ("Is each limit switch beyond", "rails.x: limits"),
        ("Is its path clear", "bench: dry run"),
    ],
)
def test_no_of_the_technician_ends_it_with_the_axes_stopped(words: str, step: str) -> None:
    trial = commissioned((X,), others=(*OTHERS, YAW), answer=lambda question: words not in question)
    assert trial.found is None
    assert trial.fails is not None
    assert trial.fails.what == step
    assert "the technician" in trial.fails.observed
    assert trial.calls == ([] if step.startswith("io") else ["stop", "close"])
    assert words in trial.prompt.questions[-1]


def _scaled(factor: float) -> TruePosition:
    """Return a measured position of ``factor`` times the encoder position."""
    runners: list[Runner] = []

    def look(axis: int, now_s: float) -> float:
        feedback = runners[0].loop.now.feedback
        return factor * float([*feedback.rail_m, *feedback.gimbal_rad][axis])

    look.runners = runners  # type: ignore[attr-defined]
    return look


@pytest.mark.parametrize(("factor", "step"), [(1.1, "scale"), (0.9, "scale"), (-1.0, "sign")])
def test_axis_that_deviates_from_its_encoder_is_detected_by_measurement(factor: float, step: str) -> None:
    look = _scaled(factor)
    trial = commissioned(
        (YAW,),
        true_position=look,
        prepare=lambda runner, *_: look.runners.append(runner),  # type: ignore[attr-defined]
    )
    assert trial.fails is not None
    assert trial.fails.what == f"turntable.yaw: {step}"
    assert "+2.000 deg within 2 %" in trial.fails.expected
    assert f"{2.0 * factor:+.3f} deg measured" in trial.fails.observed
    assert trial.calls == ["stop", "close"]


def _encoder(factor: float) -> Prepare:
    """Scale the encoder of x by ``factor`` about its initial position."""

    def prepare(runner: Runner, *_: Any) -> None:
        rails = runner.loop.bench.rails
        read = rails.read
        start: list[float] = []

        def spoilt(now_s: float) -> Any:
            feedback = read(now_s)
            start[:] = start or [float(feedback.position[X])]
            feedback.position[X] = start[0] + factor * (feedback.position[X] - start[0])
            return feedback

        rails.read = spoilt  # type: ignore[method-assign]

    return prepare


@pytest.mark.parametrize(
    ("factor", "step", "word"),
    [
        (-1.0, "sign", "invert one of them"),
        (0.0, "following", "does not follow"),
        (1.05, "scale", "counts per revolution"),
    ],
)
def test_encoder_that_does_not_go_with_the_command_is_found(factor: float, step: str, word: str) -> None:
    trial = commissioned((X,), prepare=_encoder(factor))
    assert trial.fails is not None
    assert trial.fails.what == f"rails.x: {step}"
    assert word in trial.fails.advice
    assert "by the encoder" in trial.fails.observed
    assert trial.calls == ["stop", "close"]
    assert float(np.ptp(np.array(trial.places)[:, X])) <= 0.02 + 1e-9


def test_emergency_stop_with_a_broken_wire_is_found_before_anything_is_opened() -> None:
    def broken(_: Runner, trial: Trial, button: Button) -> None:
        button.dead = True

    trial = commissioned((X,), prepare=broken)
    assert trial.fails is not None
    assert trial.fails.expected == "input opens"
    assert "still closed after 120 s" in trial.fails.observed
    assert trial.calls == []


def test_relay_that_closes_by_itself_after_the_release_is_found() -> None:
    def by_itself(runner: Runner, _: Trial, button: Button) -> None:
        io = button.io
        advance = io._advance

        def relay(now_s: float) -> bool:
            return advance(now_s) or (button.presses > 0 and not io.pressed)

        io._advance = relay  # type: ignore[method-assign]

    trial = commissioned((X,), prepare=by_itself)
    assert trial.fails is not None
    assert trial.fails.observed == "closed without reset"
    assert trial.calls == []


def test_emergency_stop_ends_the_waiting_for_an_answer() -> None:
    buttons: list[Button] = []
    answered = threading.Event()

    def answer(question: str) -> bool:
        if "Has the carriage moved" in question:
            buttons[0].press()
            answered.wait(60.0)
        return True

    with pytest.raises(SafetyTrip, match="emergency stop pressed"):
        commissioned((X,), answer=answer, prepare=lambda _runner, _trial, button: buttons.append(button))
    answered.set()


def test_ctrl_c_at_a_question_stops_the_axes_first() -> None:
    calls: list[list[str]] = []
    asked, answered = threading.Event(), threading.Event()

    def answer(question: str) -> bool:
        if "Has the carriage moved" in question:
            asked.set()
            answered.wait(60.0)
        return True

    def interrupt(runner: Runner, trial: Trial, _: Button) -> None:
        calls.append(trial.calls)
        read = runner.loop.bench.read

        def read_or_stop(now_s: float) -> None:
            if asked.is_set():
                raise KeyboardInterrupt
            read(now_s)

        runner.loop.bench.read = read_or_stop  # type: ignore[method-assign]

    with pytest.raises(KeyboardInterrupt):
        commissioned((X,), answer=answer, prepare=interrupt)
    answered.set()
    assert calls == [["stop", "close"]]


def test_proof_test_moves_no_axis_and_returns_what_it_found() -> None:
    job = make_job(STEP_S)
    prompt = ScriptedPrompt()
    with build.runner(job) as runner:
        lines, bench = runner.loop.safety_io, runner.loop.bench
        assert isinstance(lines, SafetyIoStage)
        assert isinstance(lines.io, MockIo)
        moved: list[float] = []
        bench._send = moved.append  # type: ignore[method-assign]
        steps = Commissioning(runner, job.rig.value, prompt, CommissioningPlan((X,)), Button(lines.io))
        proved = steps.prove()
    assert moved == []
    assert proved[0] == "io: coupler identified, emergency stop released, safety chain closed"
    assert "Are all drives without power while the emergency stop is pressed? yes" in proved
    assert proved[-1] == "io: released, chain stayed open, closed again after the reset"


@pytest.mark.parametrize("factor", [60.0, -60.0, 1.0 / 60.0, -1.0])
def test_drive_of_another_unit_moves_by_a_tenth_of_a_degree_before_the_technician_is_asked(factor: float) -> None:
    begun: list[tuple[Runner, Trial]] = []
    asked: list[float] = []

    def answer(question: str) -> bool:
        if "stay within" in question:
            asked.append(abs(factor) * float(np.ptp(np.array(begun[0][1].places)[:, YAW])))
        return True

    trial = commissioned(
        (YAW,),
        answer=answer,
        true_position=lambda axis, _: factor * float(begun[0][0].loop.bench.motion.position[axis]),
        prepare=lambda runner, trial, _: begun.append((runner, trial)),
    )
    assert trial.fails is not None
    if "first move" in trial.fails.what:  # the measurement came before the question
        asked.append(abs(factor) * float(np.ptp(np.array(trial.places)[:, YAW])))
    assert len(asked) == 1
    assert asked[0] <= math.radians(0.1001)
