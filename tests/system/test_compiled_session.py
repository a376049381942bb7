"""Unattended runs on the mock rig: the compiled loop against the cycle in Python, in every row, event and message."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import NonSeekingReader

from hil.config.load import load_rig, load_scenario
from hil.core.modes import Mode
from hil.loop.compiled import cycles
from hil.loop.compiled.cycles import CompiledCycles
from hil.loop.cycle import Cycles, PythonCycles
from hil.loop.outcome import Outcome
from hil.loop.rate_keeper import Tick
from hil.loop.runner import COMPLETED, STOPPED_BY_OPERATOR, Runner
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.dispersions import Design, case_seed
from hil.recording import session as recording_session
from hil.recording.sinks import RecordingSinks
from hil.report.summary import summarise
from hil.session import build
from hil.session.build import Job
from hil.session.compiled import python_only
from tests.support.external_gnc import c_example
from tests.support.plain_filters import PLAIN
from tests.support.rows import assert_same_bits
from tests.support.run_settings import ALL_ERRORS, make_job

pytestmark = pytest.mark.xdist_group("campaign")

LATE = (
    "vmu.latency_s=0.07",
    "vmu.latency_jitter_s=0.3",
    "vmu.duplicate_probability=0.2",
    "vmu.loss_probability=0.1",
    "rig.vmu.timeout_s=2.0",
)
CROWDED = ("rig.vmu.rate_hz=400.0", "vmu.latency_jitter_s=0.1", "vmu.duplicate_probability=0.3")
"""More poses in a cycle than it takes."""
SLOW_RAILS = (
    "rig.rails.x.acceleration_max_mps2=0.0002",
    "rig.rails.following_error_max_m=1.0",
    "rig.guard.enabled=false",
)
WIDE_AXES = "rig.guard.axis_error_max_m=1.0"
PUSHED = ("initial.position_m=[0.45, 0.0, 0.0]", "initial.velocity_mps=[-0.1, 0.0, 0.0]")
RATES = ("rig.bench.axes_rate_hz=250.0", "imu.rate_hz=200.0")
STEP = "    gnc_state *g = gnc;"
STARTED_NS = 1_700_000_000_000_000_000

Prepare = Callable[[Runner], None]


def _fault(device: str, kind: str, more: str = "") -> str:
    """Return the setting of a fault that begins at 5 s."""
    return f'faults=[{{device = "{device}", kind = "{kind}", at_s = 5.0, {more}}}]'.replace(", }", "}")


@dataclass
class Evidence:
    """All results of a run. messages: of its recording in the order of the file."""

    outcome: Outcome
    summary: dict[str, Any]
    messages: list[tuple[str, int, int, bytes]]


def run(job: Job, folder: Path, compiled: bool, prepare: Prepare = lambda _: None) -> Evidence:
    """Run ``job`` recorded, by the compiled loop or by the cycle in Python."""
    job = replace(job, compiled=compiled)
    with recording_session.recording(job, "mock", folder, lambda _: None) as taken:
        with build.runner(job, sinks=taken.sinks) as runner:
            assert isinstance(runner.cycles, CompiledCycles if compiled else PythonCycles)
            prepare(runner)
            outcome = runner.run()
        scenario, rig = job.scenario.value, job.rig.value
        summary, _ = summarise(outcome, scenario, rig, "mock", job.seed, 1.0 / scenario.step_s)
        taken.finish(summary)
    with io.BytesIO(taken.path.read_bytes()) as file:
        messages = [
            (channel.topic, message.log_time, message.sequence, _without_digest(channel.topic, message.data))
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False)
        ]
    return Evidence(outcome, summary, messages)


def _without_digest(topic: str, data: bytes) -> bytes:
    """Return a message without its digest in the audit, which begins with the header of its own recording."""
    return re.sub(rb', ?"digest": ?"[0-9a-f]{64}"', b"", data) if topic == "/log" else data


def assert_equal(one: Evidence, other: Evidence) -> None:
    """Compare all results, nan with nan."""
    assert (one.outcome.stop, one.outcome.faults) == (other.outcome.stop, other.outcome.faults)
    assert one.outcome.events == other.outcome.events
    assert one.outcome.alarms == other.outcome.alarms
    assert one.outcome.mode is other.outcome.mode
    assert len(one.outcome.history) == len(other.outcome.history)
    assert_same_bits(one.outcome.history, other.outcome.history)
    assert one.outcome.history.tobytes() == other.outcome.history.tobytes()
    assert json.dumps(one.summary) == json.dumps(other.summary)
    assert len(one.messages) == len(other.messages)
    for mine, yours in zip(one.messages, other.messages, strict=True):
        assert mine == yours


@pytest.fixture(autouse=True, scope="module")
def _compiled_loop() -> None:
    """Compile the loop: without it in the cache a session runs the cycle in Python."""
    scenario = load_scenario("scheme-1").value
    CaseRunner(scenario, load_rig("mock").value, 2.0 * scenario.step_s).run(scenario, 0)


@pytest.fixture(autouse=True)
def _same_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let all recordings start at the same time of day."""
    monkeypatch.setattr(recording_session, "utc_ns", lambda: STARTED_NS)


@pytest.fixture
def check(tmp_path: Path) -> Callable[..., Evidence]:
    """Return a function that compares both loops on a job and returns the results."""

    def compare(job: Job, prepare: Prepare = lambda _: None) -> Evidence:
        found, expected = (run(job, tmp_path / str(c), c, prepare) for c in (True, False))
        assert_equal(found, expected)
        return found

    return compare


Check = Callable[..., Evidence]


@pytest.mark.parametrize(
    ("scheme", "settings"),
    [
        ("scheme-1", ()),
        ("scheme-2", ()),
        ("scheme-3", ()),
        ("scheme-2", LATE),
        ("scheme-1", ("gnc.control.deadband_m=0.02",)),
        ("scheme-1", ("rig.io.thruster_lines=5", "rig.bench.park_after_run=true")),
        ("scheme-1", ("rig.io.driver=none", "step_s=0.05")),
        ("scheme-1", CROWDED),
        ("scheme-1", SLOW_RAILS),
        ("scheme-1", ("rig.rails.x.lead_s=-0.01", "rig.vmu.bench_sigma_m=0.002")),
        ("scheme-1", (*RATES, *LATE, "rig.vmu.rate_hz=7.0", "rig.rails.x.lead_s=0.01")),
        ("scheme-1", (*ALL_ERRORS, *LATE, "imu.rate_hz=100.0", "rig.guard.enabled=false")),
        ("tumbling-3", ("imu.rate_hz=100.0",)),
        ("limit-cycle", ()),
        ("scheme-1", ("monitor.source=model", _fault("monitor", "offset", "value = [0.1, 0.0, 0.0], until_s = 9.0"))),
    ],
    ids=[
        "scheme-1",
        "scheme-2",
        "scheme-3",
        "late, lost and repeated poses",
        "other dead band",
        "five lines, parked at the end",
        "no digital lines, other step",
        "more poses than a cycle takes",
        "limited setpoints",
        "lead, other sigma",
        "fast axes and IMU",
        "all terms of the error models",
        "target that tumbles, fast IMU",
        "target in a limit cycle",
        "docking monitor that disagrees for a time",
    ],
)
def test_compiled_session_equals_the_cycle_in_python(check: Check, scheme: str, settings: tuple[str, ...]) -> None:
    found = check(make_job(14.0, settings, scenario=scheme, seed=3))
    assert found.outcome.stop == COMPLETED
    used = sum(topic == "/vmu/frames" for topic, *_ in found.messages)
    assert used >= found.summary["vision"]["frames"] > 60
    assert (found.outcome.limited_cycles > 0) == (settings == SLOW_RAILS)
    if settings == CROWDED:
        assert found.outcome.history["pose"]["fresh"].max() == 4


def test_ring_that_leaves_the_images_costs_both_loops_the_same_poses(check: Check) -> None:
    found = check(make_job(22.0, ("rig.vmu.camera.width_px=160", "vmu.latency_s=0.07")))
    lost = 22.0 * 6.25 - found.summary["vision"]["frames"]
    assert 5 < lost < 100


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "duration_s"),
    [("scheme-1", 400.0), ("scheme-2", 400.0), ("scheme-3", 400.0), ("tumbling-5", 150.0), ("inspection", 400.0)],
)
def test_compiled_session_equals_the_cycle_in_python_to_the_end(check: Check, scheme: str, duration_s: float) -> None:
    assert check(make_job(duration_s, scenario=scheme)).outcome.stop == COMPLETED


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("gnc.abort.at_s=8.0",), "abort: ordered"),
        (
            ("initial.velocity_mps=[0.0, 0.12, 0.0]", "gnc.control.correction_rate_mps=0.001"),
            "reaction hold: the corridor",
        ),
        (("vmu.reported_sigma_scale=0.3",), "innovations are larger"),
    ],
    ids=["abort in time", "hold outside the corridor", "inconsistent innovations"],
)
def test_events_come_in_the_same_cycles(check: Check, settings: tuple[str, ...], words: str) -> None:
    found = check(make_job(30.0, settings))
    assert any(event.text.startswith(words) for event in found.outcome.events)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (("rig.rails.following_error_max_m=0.00002",), "rails."),
        (("rig.rails.x.travel_m=[-0.2, 3.93]", "rig.rails.following_error_max_m=1e-9"), "rails."),
        (("rig.rails.following_error_max_m=0.000005", "rig.bench.axes_rate_hz=250.0"), "rails."),
        (PUSHED, "bench: range to the target"),
        ((_fault("vmu", "offset", "value = [0.3, 0.0, 0.0]"),), "vmu: pose against encoders, x"),
        ((_fault("rails.x", "stuck"), "rig.bench.axes_rate_hz=250.0"), "rails.x: distance from the demand"),
        ((*SLOW_RAILS[:2], WIDE_AXES, "rig.guard.pose_error_max_m=1.0"), "bench: limited setpoints"),
        (
            (_fault("rails.y", "stuck"), WIDE_AXES, "rig.guard.pose_error_max_m=0.0001"),
            "bench: distance from the truth",
        ),
    ],
    ids=[
        "following error",
        "travel",
        "following error between two cycles",
        "keep-out",
        "vision unit beside the encoders",
        "stuck rail",
        "limited setpoints",
        "beside the truth",
    ],
)
def test_fault_raises_the_same_alarm_in_the_same_cycle(check: Check, settings: tuple[str, ...], text: str) -> None:
    found = check(make_job(20.0, settings))
    assert found.outcome.mode is Mode.SAFE_STOP
    assert found.outcome.alarms[0].text.startswith(text)


def test_setpoint_that_is_not_finite_raises_the_same_alarm(check: Check) -> None:
    def spoil(runner: Runner) -> None:
        runner.loop.now.truth.w_CI_C[:] = np.nan

    found = check(make_job(4.0), spoil)
    assert "a finite number" in found.outcome.stop


def test_order_before_the_start_acts_in_the_first_cycle(check: Check) -> None:
    def order(runner: Runner) -> None:
        runner.loop.gnc.order_abort()
        runner.loop.gnc.order_go()

    assert check(make_job(4.0), order).outcome.history["supervision"]["aborted"][0] == 3


def test_axes_that_are_homed_first_delay_both_loops_alike(check: Check) -> None:
    settings = ("rig.rails.x.encoder=incremental", "rig.rails.x.home_m=3.0")
    found = check(make_job(6.0, settings))
    assert found.outcome.stop == COMPLETED


def test_case_of_a_campaign_is_equal(check: Check) -> None:
    scenario, rig = load_scenario("scheme-2"), load_rig("mock")
    truth, known = (design := Design(scenario, 11)).apply(design.values(5))
    job = Job(replace(scenario, value=known), rig, case_seed(11, 5), 10.0, 1.0, truth)
    assert check(job).outcome.stop == COMPLETED


@pytest.mark.parametrize(
    ("put", "words"),
    [
        ("", COMPLETED),
        ('if (input->cycle % 60 == 0) strcpy(output->text, "tick");', COMPLETED),
        ('if (input->cycle == 150) output->state = 2, strcpy(output->text, "tracker");', "asks for it: tracker"),
        ('if (input->cycle == 150) output->state = 3, strcpy(output->text, "tracker");', "gnc other.so: tracker"),
        ("if (input->cycle == 150) return 7;", "its step returned 7"),
        ("output->cycle += input->cycle == 150;", "answers cycle 151 to the input of cycle 150"),
        ("output->direct = 1; output->on[20] = input->cycle >= 7;", "opens thruster 21 of 16"),
    ],
    ids=["good", "texts", "hold", "fault", "code", "cycle", "thruster"],
)
def test_library_gives_the_same_results(check: Check, tmp_path: Path, put: str, words: str) -> None:
    library = c_example(tmp_path, "other.so", f"{STEP} => {STEP} {put}")
    found = check(make_job(8.0, (f"gnc.library={library}", "gnc.abort.at_s=2.0", *LATE[:1]), seed=3))
    assert words in found.outcome.stop
    texts = [event for event in found.outcome.events if event.source == "gnc other.so"]
    assert bool(texts) == ("text" in put)


class Alternating:
    """Runs compiled blocks and cycles in Python in turn."""

    def __init__(self, compiled: CompiledCycles) -> None:
        self._turns = [compiled, compiled._python]

    def advance(self, held_s: float) -> Tick:
        self._turns.reverse()
        return self._turns[0].advance(held_s)


@pytest.mark.parametrize("rates", [(), RATES], ids=["one rate", "fast axes and IMU"])
def test_compiled_cycles_and_cycles_in_python_can_follow_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rates: tuple[str, ...]
) -> None:
    monkeypatch.setattr(cycles, "_BLOCK_S", 0.14)

    def alternate(runner: Runner) -> None:
        assert isinstance(runner.cycles, CompiledCycles)
        turns: Cycles = Alternating(runner.cycles)
        runner.cycles = turns

    job = make_job(12.0, (*LATE, *rates, "gnc.abort.at_s=8.0"), seed=3)
    assert_equal(run(job, tmp_path / "a", True, alternate), run(job, tmp_path / "b", False))


def test_library_that_fails_as_a_phase_is_decided_gives_the_same_events(check: Check, tmp_path: Path) -> None:
    library = c_example(tmp_path, "other.so", f"{STEP} => {STEP} return 7;")
    settings = (f"gnc.library={library}", "initial.position_m=[0.4, 0.0, 0.0]", "initial.attitude_deg=[0.0, 0.0, 0.0]")
    found = check(make_job(4.0, settings), lambda runner: runner.loop.gnc.order_go())
    assert [event.text for event in found.outcome.events][1:] == [
        "docking: no-go, the ready state does not hold",
        "phase ready begins",
    ]
    assert len(found.outcome.history) == 0


@pytest.mark.parametrize("compiled", [True, False])
def test_ctrl_c_while_a_row_is_recorded_ends_the_history_before_it(compiled: bool) -> None:
    class Sink:
        rows = 0

        def put(self, row: np.ndarray) -> None:
            if self.rows == 123:
                raise KeyboardInterrupt
            self.rows += 1

    with build.runner(replace(make_job(4.0), compiled=compiled), sinks=RecordingSinks(cycles=Sink())) as runner:
        outcome = runner.run()
    assert outcome.stop == STOPPED_BY_OPERATOR
    assert len(outcome.history) == 123


def test_ctrl_c_stops_a_compiled_run_between_two_blocks(tmp_path: Path) -> None:
    def press(mode: Mode, fraction: float) -> None:
        if mode is Mode.RUNNING and fraction > 0.3:
            raise KeyboardInterrupt

    job = make_job(100.0)
    with recording_session.recording(job, "mock", tmp_path, lambda _: None) as taken:
        with build.runner(job, press, sinks=taken.sinks) as runner:
            outcome = runner.run()
        stats = taken.break_off("test")
    assert outcome.faults == [STOPPED_BY_OPERATOR]
    assert 1000 < len(outcome.history) < 5001
    assert stats.cycles == len(outcome.history)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ((*PLAIN, "gnc.shadow.enabled=true"), "shadow filter"),
        (("vmu.source=rendered",), "rendered images"),
        (("rig.safety.command_age_max_s=0.03",), "setpoints that expire within two cycles"),
        ((), ""),
    ],
)
def test_job_that_needs_the_cycle_in_python_gives_the_reason(settings: tuple[str, ...], reason: str) -> None:
    assert python_only(make_job(1.0, settings)) == reason


def test_operator_and_real_time_need_the_cycle_in_python() -> None:
    job = make_job(1.0)
    assert python_only(replace(job, paced=True)) == "real time"
    assert python_only(replace(job, compiled=False)) != ""
    assert python_only(make_job(1.0, rig="emulated")) == "devices on wires"
