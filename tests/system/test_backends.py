"""Backends of navigation and of control of the user's own: flown, in campaigns, replayed, refused, stopped."""

from __future__ import annotations

import sys
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.api.jobs import job_of
from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE
from hil.errors import BadInput
from hil.loop.outcome import Outcome
from hil.loop.runner import COMPLETED, STOPPED_BY_OPERATOR
from hil.params import gnc as gnc_params
from hil.parts.campaigns.case_runner import CaseRunner
from hil.report.summary import summarise
from hil.session import build
from hil.session.assembly import make_gnc
from hil.session.live_tuning import with_setting
from tests.support.backends import DEAD_BAND, EKF, LQR, OBSERVER, kernel_file, observer_fmu, observer_library
from tests.support.rows import OF_DIGITAL_LINES, assert_same_bits
from tests.support.run_settings import make_job

pytestmark = pytest.mark.xdist_group("campaign")

LATE = ("vmu.latency_s=0.07", "vmu.loss_probability=0.2", "rig.vmu.timeout_s=2.0")
SHORT_S = 8.0


def named(navigation: str = "", control: str = "") -> tuple[str, ...]:
    given = {"navigation": navigation, "control": control}
    return tuple(f'gnc.{part}.backend="{name}"' for part, name in given.items() if name)


def flown(settings: tuple[str, ...], duration_s: float = SHORT_S, compiled: bool = False, seed: int = 3) -> Outcome:
    """Return the outcome of the cycle in Python, or of the compiled loop of a session."""
    job = make_job(duration_s, settings, seed=seed)
    build.check(job)
    with build.runner(replace(job, compiled=compiled)) as runner:
        return runner.run()


def case(settings: tuple[str, ...], duration_s: float = SHORT_S, seed: int = 3) -> tuple[np.ndarray, str]:
    """Return rows and end of a campaign's case, after another one that must leave no trace."""
    scenario, rig = load_scenario("scheme-1", settings).value, load_rig("mock", settings).value
    runner = CaseRunner(scenario, rig, duration_s)
    runner.run(scenario, 4)
    history = np.zeros(runner.cycles, CYCLE)
    stats, stop = runner.run(scenario, seed, history)
    return history[: stats.cycles], stop


@pytest.mark.parametrize(
    "settings",
    [
        named(control=LQR),
        named(navigation=OBSERVER),
        named(navigation=EKF, control=LQR),
        named(control=DEAD_BAND),
        (*named(OBSERVER, LQR), "gnc.abort.at_s=6.0"),
        (*named(EKF), "imu.rate_hz=200.0"),
    ],
    ids=["kernel of control", "kernel of navigation", "class and kernel", "class of control", "abort", "fast IMU"],
)
def test_cycle_compiled_session_and_campaign_have_the_same_bits(settings: tuple[str, ...]) -> None:
    settings = (*settings, *LATE)
    one, session = flown(settings), flown(settings, compiled=True)
    history, stop = case(settings)
    assert one.stop == session.stop == stop == COMPLETED
    assert_same_bits(one.history, session.history)
    assert_same_bits(one.history, history, OF_DIGITAL_LINES)


@pytest.mark.parametrize("settings", [named(control=LQR), named(EKF), named(control=DEAD_BAND)], ids=str)
def test_examples_fly_scheme_1_through_every_part(settings: tuple[str, ...]) -> None:
    scenario = load_scenario("scheme-1", settings).value
    outcome = flown(settings, scenario.duration_s, compiled=True)
    summary, _ = summarise(outcome, scenario, load_rig("mock").value, "mock", 3, 50.0)
    assert summary["passed"]
    assert summary["passed_all_parts"]


def test_library_of_navigation_has_the_bits_of_the_same_kernel(tmp_path: Path) -> None:
    library = observer_library(tmp_path)
    for more in ((), ("gnc.navigation.settings.position_gain=0.07",)):
        kernel, _ = case((*named(OBSERVER), *LATE, *more))
        assert_same_bits(kernel, case((*named(str(library)), *LATE, *more))[0])


@pytest.mark.parametrize("version", [2, 3])
def test_fmu_of_navigation_has_the_bits_of_the_same_library(tmp_path: Path, version: int) -> None:
    library, fmu = observer_library(tmp_path), observer_fmu(tmp_path, version)
    for more in ((), ("gnc.navigation.settings.position_gain=0.07",)):
        settings = (*LATE, *more)
        expected, stop = case((*named(str(library)), *settings))
        found, same = case((*named(str(fmu)), *settings))
        assert_same_bits(expected, found)
        assert stop == same == COMPLETED
    outcome = flown((*named(str(fmu)), *LATE, "gnc.navigation.settings.position_gain=0.07"), compiled=False)
    assert_same_bits(outcome.history, found, OF_DIGITAL_LINES)


def test_built_in_parts_are_those_of_a_run_without_backends() -> None:
    """The backend of one part leaves the other as it is: a law that copies the built-in one's demands is not needed."""
    free, other = flown(()), flown(named(control=LQR))
    first = np.flatnonzero((free.history["command"]["on"] != other.history["command"]["on"]).any(axis=1))[0]
    assert_same_bits(free.history["navigation"][: first + 1], other.history["navigation"][: first + 1])


@pytest.mark.parametrize("backend", [{"control": LQR}, {"navigation": EKF}, {"navigation": OBSERVER, "control": LQR}])
def test_recording_is_replayed_with_its_backends(backend: dict[str, str], tmp_path: Path) -> None:
    run = hil.run("scheme-1", seed=3, duration_s=SHORT_S, record=tmp_path, **backend)  # type: ignore[arg-type]
    (file,) = tmp_path.glob("*.mcap")
    again = hil.open(file).replay()
    assert again.identical
    assert not again.changed
    for part, name in backend.items():
        assert run.summary["gnc"][part]["backend"] == name
        assert len(run.summary["gnc"][part]["sha256"]) == 64


class Watcher:
    """Navigation that reports no estimate and keeps its inputs."""

    def __init__(self) -> None:
        self.inputs: list[Any] = []

    def step(self, inp: Any) -> None:
        self.inputs.append(inp)


def test_replay_gives_navigation_the_thrusters_that_were_recorded(tmp_path: Path) -> None:
    run = hil.run("scheme-1", seed=3, duration_s=SHORT_S, record=tmp_path)
    (file,) = tmp_path.glob("*.mcap")
    watcher = Watcher()
    hil.open(file).replay(navigation=watcher, control=LQR)
    fired = run.history["command"]["on"]
    assert fired.any()
    given = np.array([inp.commanded for inp in watcher.inputs])
    np.testing.assert_array_equal(given[1:], fired[:-1])


def test_input_of_navigation_is_what_the_bench_has() -> None:
    watcher = Watcher()
    run = hil.run("scheme-1", seed=3, duration_s=4.0, navigation=watcher, overrides={"imu.rate_hz": 200.0})
    first, second = watcher.inputs[:2]
    assert (first.cycle, first.t_s, first.n_samples) == (0, 0.0, 0)
    assert (second.cycle, second.t_s, second.n_samples) == (1, 0.02, 4)
    mean = np.mean([sample.force_mps2 for sample in second.samples[:4]], axis=0)
    np.testing.assert_allclose(mean, run.history["imu"]["force_C"][1], rtol=1e-12)
    poses = sum(inp.n_poses for inp in watcher.inputs)
    assert poses == run.history["pose"]["fresh"].sum() > 20
    with_pose = next(inp for inp in watcher.inputs if inp.n_poses)
    pose, row = with_pose.poses[0], run.history["pose"][with_pose.cycle]
    np.testing.assert_array_equal(pose.r_TC_C_m, row["z_TC_C"])
    np.testing.assert_array_equal(pose.covariance_cross_m_rad, row["covariance_cross"])
    assert first.setup.mass_kg == run.scenario.chaser.mass_kg
    assert {"t_s", "samples", "poses", "commanded", "setup"} <= set(dir(first))
    assert "m/s^2, in c" in (type(second.samples[0]).force_mps2.__doc__ or "")
    assert not run.history["navigation"]["valid"].any()


class Failing:
    """Control that fails after a time."""

    settings = (hil.Setting("after_s", 1.0, "s", 0.0, 100.0, "of the failure"),)

    def start(self, setup: Any, settings: Any) -> None:
        self.settings = settings

    def step(self, inp: Any) -> None:
        if inp.t_s > self.settings.after_s:
            raise ZeroDivisionError("no law")


class FailingGnc:
    def step(self, inp: Any) -> None:
        raise LookupError("no GNC")


@pytest.mark.parametrize(
    ("given", "kind", "line"),
    [({"control": Failing}, ZeroDivisionError, "no law"), ({"gnc": FailingGnc()}, LookupError, "no GNC")],
    ids=["control", "gnc"],
)
def test_what_an_object_raises_reaches_the_caller_with_its_line(
    given: dict[str, Any], kind: type[Exception], line: str
) -> None:
    with pytest.raises(kind, match=line) as raised:
        hil.run("scheme-1", duration_s=4.0, **given)
    frame = traceback.extract_tb(raised.value.__traceback__)[-1]
    assert Path(frame.filename) == Path(__file__)
    assert line in (frame.line or "")


def test_object_that_raises_fails_its_case_and_the_first_traceback_is_kept(tmp_path: Path) -> None:
    overrides = {
        "dispersions": {"gnc": {"control": {"settings": {"after_s": {"kind": "uniform", "low": 1.0, "high": 5.0}}}}}
    }
    found = hil.campaign("scheme-1", 6, tmp_path, duration_s=3.0, control=Failing, overrides=overrides, workers=1)
    late = found.column("gnc.control.settings.after_s") >= 3.0
    stops = np.array(found.cases.column("stop").to_pylist())
    assert 0 < late.sum() < 6
    assert set(stops[late]) == {COMPLETED}
    (stop,) = set(stops[~late])
    assert stop.startswith("control Failing: step raised ZeroDivisionError: no law (test_backends.py, line ")
    error = found.summary["first_error"]
    assert error["case"] == int(np.flatnonzero(~late)[0])
    assert 'raise ZeroDivisionError("no law")' in error["traceback"]


def test_campaign_makes_a_new_object_for_each_case(tmp_path: Path) -> None:
    overrides = {"initial.position_m": [0.7, 0.0, 0.0]}
    found = hil.campaign("scheme-1", 3, duration_s=6.0, navigation=EKF, overrides=overrides, workers=1)
    alone = hil.run("scheme-1", duration_s=6.0, navigation=EKF, overrides=overrides)
    assert alone.summary["stop"] == COMPLETED
    rmse = found.column("position_rmse_m_x")
    assert len(set(rmse)) == 3
    assert found.run_case(2).summary["navigation"]["position_rmse_m"][0] == pytest.approx(rmse[2], rel=1e-9)


WRONG = "return HIL_BACKENDS_PROTOCOL; => return 99;"


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (
            lambda _: 'gnc.control.backend="lqr"',
            'gnc.control.backend: "lqr": no such backend: must be "builtin", "predictive", pack',
        ),
        (lambda _: 'gnc.control.backend="vision_alone"', '"vision_alone": no such backend'),
        (lambda _: 'gnc.control.backend="no_package:lqr"', "no such entry point: those of hil.control are none"),
        (lambda _: 'gnc.control.backend="none.py:lqr"', "no such file: give file.py:name"),
        (lambda _: f'gnc.control.backend="{LQR[:-4]}:pid"', "has no pid: its classes and kernels are lqr"),
        (lambda _: 'gnc.navigation.backend="none.so"', "no such file: give the path of a shared library"),
        (lambda folder: f'gnc.control.backend="{observer_library(folder)}"', "has no function hil_control_open"),
        (
            lambda folder: f'gnc.navigation.backend="{observer_library(folder, "v.so", WRONG)}"',
            "has version 99 of the records, this bench has 2",
        ),
        (
            lambda folder: f'gnc.control.backend="{kernel_file(folder, "pass", "inp, out")}"',
            "law(inp, out): a kernel takes (settings, inp, out, memory)",
        ),
        (
            lambda folder: f'gnc.control.backend="{kernel_file(folder, "out.thrust[0] = 1")}"',
            "law does not compile: a record has no field 'thrust' (line 6)",
        ),
        (lambda folder: f'gnc.control.backend="{kernel_file(folder, "pass", options="1")}"', "settings: 1 is no hil.S"),
        (lambda folder: f'gnc.control.backend="{kernel_file(folder, "if")}"', "cannot be imported: SyntaxError"),
        (lambda _: "gnc.control.settings.gain=2.0", 'gnc.control.backend = "builtin" declares none'),
    ],
    ids=range(13),
)
def test_backend_that_cannot_fly_is_refused_in_one_line(make: Any, text: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput) as error:
        build.check(make_job(1.0, (make(tmp_path),)))
    (problem,) = error.value.problems
    assert text in str(problem)
    assert str(problem).startswith("--set: gnc.")


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        (
            "gnc.control.settings.gain=2.0",
            "unknown key: known here: bandwidth_radps, attitude_bandwidth_radps, period_s",
        ),
        ("gnc.control.settings.period_s=99.0", "99: must be 0.02 to 10 s"),
        ('gnc.library="x.so"', "library replaces navigation and control; allowed is one of both"),
        ('console.adjustable=["gnc.control.settings.gain"]', '"gnc.control.settings.gain": no setting of a backend'),
    ],
)
def test_settings_that_do_not_suit_the_backend_are_refused(setting: str, text: str) -> None:
    with pytest.raises(BadInput) as error:
        build.check(make_job(1.0, (*named(control=LQR), setting)))
    (problem,) = error.value.problems
    assert text in str(problem)


def test_defaults_are_part_of_the_scenario_of_a_run() -> None:
    job = make_job(1.0, (*named(control=LQR), "gnc.control.settings.period_s=0.2"))
    settings = job.scenario.value.gnc.control.settings
    assert list(settings)[:3] == ["bandwidth_radps", "attitude_bandwidth_radps", "period_s"]
    assert (settings["bandwidth_radps"], settings["period_s"]) == (0.25, 0.2)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("output->valid = m->started; => return input->t_s > 1.0 ? 7 : 0;", "navigation other.so: its step returned 7"),
        (
            "output->valid = m->started; => if (input->t_s > 1.0) { output->state = HIL_GNC_FAULT;"
            ' snprintf(output->text, 64, "lost"); }',
            "navigation other.so: lost",
        ),
        (
            "output->valid = m->started; => output->valid = 1; output->r_CT_H[0] = 0.0 / 0.0; return 0;",
            "navigation other.so: estimated r_CT_H[0] is nan, allowed finite numbers",
        ),
    ],
    ids=["code", "fault", "not finite"],
)
def test_failed_step_stops_the_bench_and_the_case_with_the_same_words(change: str, text: str, tmp_path: Path) -> None:
    settings = named(str(observer_library(tmp_path, "other.so", change)))
    one, session, (_, stop) = flown(settings, 4.0), flown(settings, 4.0, compiled=True), case(settings, 4.0)
    assert text in one.stop
    assert one.stop == session.stop == stop.replace(" (case)", "")
    assert [alarm.text for alarm in one.alarms] == [alarm.text for alarm in session.alarms]


@pytest.mark.parametrize(
    ("body", "text"),
    [
        (
            "out.force[:] = out.on[:2]",
            "could not broadcast input array from shape (2,) into shape (3,) (law.py, line 6)",
        ),
        ("out.on[30 * inp.mode] = 1", "index 60 is out of bounds for axis 0 with size 24 (law.py, line 6)"),
        (
            "out.on[:] = out.on[:16]",
            "could not broadcast input array from shape (16,) into shape (24,) (law.py, line 6)",
        ),
    ],
    ids=["two demands", "index", "16 of 24"],
)
def test_value_of_another_shape_in_a_kernel_stops_the_bench_with_its_line(body: str, text: str, tmp_path: Path) -> None:
    settings = named(control=kernel_file(tmp_path, body))
    one, session, (_, stop) = flown(settings, 4.0), flown(settings, 4.0, compiled=True), case(settings, 4.0)
    assert one.stop.startswith("control law: step raised ")
    assert text in one.stop
    assert one.stop == session.stop == stop.replace(" (case)", "")


def test_text_of_a_backend_is_an_event_and_it_can_ask_for_a_hold(tmp_path: Path) -> None:
    said = (
        'output->valid = m->started; => output->valid = m->started; if (input->t_s > 1.0) strcpy(output->text, "in");'
    )
    include = "#include <stdio.h> => #include <stdio.h>\n#include <string.h>"
    settings = named(str(observer_library(tmp_path, "text.so", said, include)))
    for compiled in (False, True):
        events = [
            (e.t_s, e.source, e.text) for e in flown(settings, 4.0, compiled).events if e.source.startswith("nav")
        ]
        assert events == [(1.02, "navigation text.so", "in")]
    asks = "output->valid = m->started; => if (input->t_s > 1.0) output->state = HIL_GNC_ASKS_FOR_HOLD;"
    settings = named(str(observer_library(tmp_path, "hold.so", asks)))
    one, session, (_, stop) = flown(settings, 4.0), flown(settings, 4.0, compiled=True), case(settings, 4.0)
    assert "navigation hold.so asks for it" in one.stop
    assert one.stop == session.stop == stop


def test_estimate_without_poses_is_lost_whatever_its_backend_reports() -> None:
    settings = (*named(OBSERVER), 'faults=[{device="vmu", kind="no_pose", at_s=3.0}]', "rig.vmu.timeout_s=60.0")
    health = flown(settings, 8.0).history["navigation"]["health"]
    lost = np.flatnonzero(health & 1)
    assert 2.84 + 2.0 < lost[0] * 0.02 < 3.0 + 2.1


def test_console_changes_a_setting_between_two_cycles() -> None:
    job = make_job(1.0, named(control=DEAD_BAND))
    gnc = make_gnc(job.scenario.value)
    gnc.open(0.0)
    changed = with_setting(job.scenario.value, "gnc.control.settings.deadband_m=0.02", "test")
    gnc.adjust(gnc_params.gnc(changed.value))
    instance = gnc._backends._instances["control"]
    assert instance._made.settings.deadband_m == 0.02  # type: ignore[attr-defined]
    gnc.close()


class Interrupted:
    """Control in whose step Ctrl-C arrives."""

    def step(self, inp: Any) -> None:
        raise KeyboardInterrupt


def test_ctrl_c_in_the_step_of_an_object_is_the_operators_stop() -> None:
    job = job_of("scheme-1", "mock", None, duration_s=2.0, control=Interrupted)
    for compiled in (False, True):
        with build.runner(replace(job, compiled=compiled)) as runner:
            assert runner.run().stop == STOPPED_BY_OPERATOR
    with pytest.raises(KeyboardInterrupt):
        hil.run("scheme-1", duration_s=2.0, control=Interrupted)


def test_kernel_of_a_file_that_was_edited_since_it_was_compiled_flies_in_another_process(tmp_path: Path) -> None:
    path = tmp_path / "law.py"
    law = "@hil.kernel_backend()\ndef idle(settings, inp, out, memory):\n    out.force[0] = 0\n"
    for comment in ("# before\n", "# after\n"):
        path.write_text(f"{comment}import hil\n\n\n{law}")
        assert flown(named(control=f"{path}:idle"), 0.1).stop == COMPLETED
        for name in [name for name in sys.modules if name.startswith("hil_own_")]:
            del sys.modules[name]  # as in another process
