"""A GNC of the user's own as a shared library: flown, flown in a campaign, replayed, refused, stopped."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.core.gnc_records import GncState
from hil.core.messages import CYCLE
from hil.core.modes import Mode
from hil.core.operator_commands import Operator, OperatorCommand
from hil.loop.outcome import Outcome
from hil.loop.runner import COMPLETED
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.outcome import row_of
from hil.recording.read import load
from hil.recording.replay import replay
from hil.session import build
from hil.session.assembly import library_problems
from tests.support.external_gnc import MEASURED, PYTHON_EXAMPLE, USES_ALL, c_example
from tests.support.rows import OF_DIGITAL_LINES, assert_same_bits
from tests.support.run_settings import make_job, typed

pytestmark = pytest.mark.xdist_group("campaign")

LATE = ("vmu.latency_s=0.07", "vmu.loss_probability=0.2", "rig.vmu.timeout_s=2.0")
STEP = "    gnc_state *g = gnc;"
NO_ESTIMATE = "output->estimate = input->t_s > g->first_s + SETTLED_S; => "


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the C example as a shared library."""
    return c_example(tmp_path_factory.mktemp("gnc"))


def variant(folder: Path, *replacements: str) -> Path:
    """Return the C example with ``old => new`` put in."""
    return c_example(folder, "other.so", *replacements)


def flown(library: Path, duration_s: float, *settings: str, operator: Operator | None = None) -> Outcome:
    """Return the outcome of the cycle in Python."""
    chosen = (f"gnc.library={library}", *settings)
    job = make_job(duration_s, chosen, seed=3)
    build.check(job)
    with build.runner(replace(job, compiled=False), operator=operator) as runner:
        return runner.run()


def compiled(library: Path, duration_s: float, *settings: str) -> tuple[np.ndarray, np.record, str]:
    chosen = (f"gnc.library={library}", *settings)
    scenario, rig = load_scenario("scheme-1", chosen).value, load_rig("mock", chosen).value
    flight = CaseRunner(scenario, rig, duration_s)
    flight.run(scenario, 4)  # what was flown before leaves no trace
    history = np.zeros(flight.cycles, CYCLE)
    stats, stop = flight.run(scenario, 3, history)
    return history[: stats.cycles], stats, stop


def test_c_example_flies_scheme_1_through_table_iii(library: Path) -> None:
    scenario = load_scenario("scheme-1", [f"gnc.library={library}"]).value
    stats, stop = CaseRunner(scenario, load_rig("mock").value, scenario.duration_s).run(scenario, 0)
    row = row_of(stats, stop, scenario, scenario)
    assert row["passed"]
    assert row["ready_time_s"] < 170.0


@pytest.mark.slow
def test_c_example_flies_scheme_1_by_the_command(library: Path, tmp_path: Path) -> None:
    numbers = tmp_path / "run.json"
    assert execute(["run", "scheme-1", "--set", f"gnc.library={library}", "--json", str(numbers)]) == 0
    summary = json.loads(numbers.read_text())
    assert summary["passed"]
    assert summary["navigation"]["position_rmse_m"] is not None
    assert summary["navigation"]["position_sigma_m"] is None  # an estimate comes without covariance
    assert min(summary["navigation"]["position_bound_m"]) > 0.0  # but is measured by the bound of its sensors


def test_campaign_case_with_a_library_has_the_bits_of_the_run(library: Path) -> None:
    outcome = flown(library, 20.0, *LATE)
    history, _, stop = compiled(library, 20.0, *LATE)
    assert outcome.stop == stop == COMPLETED
    assert_same_bits(outcome.history, history, OF_DIGITAL_LINES)


@pytest.mark.parametrize("change", [(), (NO_ESTIMATE,)], ids=["with an estimate", "without one"])
def test_abort_with_a_library_has_the_same_bits_and_retreats(library: Path, tmp_path: Path, change: tuple[str]) -> None:
    chosen = variant(tmp_path, *change) if change else library
    outcome = flown(chosen, 40.0, "gnc.abort.at_s=15.0")
    history, _, _ = compiled(chosen, 40.0, "gnc.abort.at_s=15.0")
    assert_same_bits(outcome.history, history, OF_DIGITAL_LINES)
    assert history["supervision"]["aborted"][-1] != 0
    assert history["truth"]["v_CT_H"][-1, 0] > 0.0 > history["truth"]["v_CT_H"][700, 0]


def test_abort_is_reported_once_in_the_input_after_it_has_begun(tmp_path: Path) -> None:
    said = 'if (input->orders & HIL_GNC_ABORT) strcpy(output->text, "aborts");'
    outcome = flown(variant(tmp_path, f"{STEP} => {STEP} {said}"), 4.0, "gnc.abort.at_s=2.0")
    assert [(e.t_s, e.text) for e in outcome.events if e.source == "gnc other.so"] == [(2.02, "aborts")]


def test_run_without_an_estimate_is_judged_on_the_truth_and_never_claims_docking(tmp_path: Path) -> None:
    chosen, numbers, folder = variant(tmp_path, NO_ESTIMATE), tmp_path / "run.json", tmp_path / "runs"
    start = (
        "initial.position_m=[0.55, 0.01, -0.01]",
        "initial.attitude_deg=[0.3, 0.2, -0.2]",
        "requirements.required_ready_s=1.0",
    )
    settings = typed(*start, f"gnc.library={chosen}")
    options = ["--duration", "45", "--json", str(numbers), "--record", str(folder)]
    assert execute(["run", "scheme-1", *settings, *options]) == 0
    summary = json.loads(numbers.read_text())  # NaN would be no JSON
    assert "NaN" not in numbers.read_text()
    assert summary["navigation"]["position_rmse_m"] is None
    assert summary["gnc"] == {"library": str(chosen), "sha256": hashlib.sha256(chosen.read_bytes()).hexdigest()}
    assert [e["text"] for e in summary["events"] if "docking" in e["text"]] == [
        "docking: no-go, the ready state does not hold"
    ]
    (recording,) = folder.glob("**/*.mcap")
    recorded = load(recording)
    again = replay(recorded, load_scenario("scheme-1", [*start, f"gnc.library={chosen}"]).value)
    assert again.identical


def test_hold_is_reported_to_the_library_and_the_run_continues(tmp_path: Path) -> None:
    told = "if (input->mode == HIL_GNC_HOLD) g->first_s -= 1.0;"  # seen in the time at which the estimate is reported
    chosen = variant(tmp_path, f"{STEP} => {STEP} {told}")
    free, held = flown(chosen, 8.0), flown(chosen, 8.0, operator=_Holding())
    assert free.stop == held.stop == COMPLETED
    assert not free.history["navigation"]["valid"].any()
    assert held.history["navigation"]["valid"][101:].all()


class _Holding(Operator):
    """Starts the run, holds it after 100 cycles, and resumes it 20 cycles later."""

    def __init__(self) -> None:
        super().__init__(attended=True)
        self._cycles = -1

    def next_command(self, mode: Mode) -> OperatorCommand | None:
        order = super().next_command(mode)
        self._cycles = 0 if order is OperatorCommand.START else self._cycles
        return order

    def poll(self, now_s: float) -> None:
        self._cycles += self._cycles >= 0
        if self._cycles in (100, 120):
            self.submit(OperatorCommand.HOLD if self._cycles == 100 else OperatorCommand.RESUME)


@pytest.mark.parametrize(
    ("put", "words"),
    [
        ("control(g, input, output); => control(g, input, output); output->force[2] = 2;", "force demand along z is 2"),
        (f"{STEP} => {STEP} output->cycle += input->cycle == 50;", "answers cycle 51 to the input of cycle 50"),
        (f"{STEP} => {STEP} if (input->cycle == 50) return 7;", "its step returned 7"),
        (f"{STEP} => {STEP} output->direct = 1; output->on[20] = 1;", "opens thruster 21 of 16"),
        (
            "output->estimate = input->t_s > g->first_s + SETTLED_S; => output->estimate = 1; g->v[1] += 0.0 / 0.0;",
            "estimated v_CT_H_mps[1] is nan",
        ),
    ],
    ids=["range", "cycle", "code", "thruster", "nan"],
)
def test_output_that_cannot_be_right_stops_the_bench_with_the_same_words_everywhere(
    tmp_path: Path, put: str, words: str
) -> None:
    chosen = variant(tmp_path, put)
    outcome = flown(chosen, 4.0)
    history, _, stop = compiled(chosen, 4.0)
    assert outcome.stop == stop
    assert outcome.faults == [stop]
    assert stop.startswith("gnc other.so: ")
    assert words in stop
    assert len(history) == len(outcome.history)


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (GncState.FAULT, "gnc other.so: star tracker"),
        (GncState.ASKS_FOR_HOLD, "gnc other.so asks for it: star tracker"),
    ],
)
def test_library_that_reports_a_fault_or_requests_a_hold_takes_effect(
    tmp_path: Path, state: GncState, words: str
) -> None:
    said = f'if (input->cycle == 50) {{ output->state = {state.value}; strcpy(output->text, "star tracker"); }}'
    chosen = variant(tmp_path, f"{STEP} => {STEP} {said}")
    outcome = flown(chosen, 4.0)
    history, _, stop = compiled(chosen, 4.0)
    assert outcome.stop == stop
    assert words in stop
    assert_same_bits(outcome.history, history, OF_DIGITAL_LINES)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: folder / "none.so", "no such file"),
        (lambda folder: PYTHON_EXAMPLE, "cannot be loaded"),
        (lambda folder: variant(folder, "int hil_gnc_step( => int some_step("), "has no function hil_gnc_step"),
        (lambda folder: variant(folder, "return HIL_GNC_PROTOCOL; => return 99;"), "has protocol 99"),
        (
            lambda folder: variant(folder, 'if (g == NULL) => strcpy(reason, "no star"); return NULL; if (g == NULL)'),
            "refuses the scenario: no star",
        ),
    ],
    ids=["missing", "no library", "symbol", "protocol", "refused"],
)
def test_library_that_cannot_fly_is_refused_in_one_line(
    tmp_path: Path, make: Callable[[Path], Path], words: str
) -> None:
    (problem,) = library_problems(load_scenario("scheme-1", [f"gnc.library={make(tmp_path)}"]))
    assert words in problem.message
    assert (problem.source, problem.key) == ("--set", "gnc.library")
    assert "\n" not in str(problem)


def test_library_of_the_protocol_before_flies_the_same_but_not_with_sensors_that_it_does_not_receive(
    library: Path, tmp_path: Path
) -> None:
    older = variant(tmp_path, "return HIL_GNC_PROTOCOL; => return 3;")
    assert_same_bits(compiled(older, 4.0, *LATE)[0], compiled(library, 4.0, *LATE)[0])
    scenario = load_scenario("scheme-1", [f"gnc.library={older}", *MEASURED])
    (problem,) = library_problems(scenario)
    assert problem.key == "sensors.ranger"
    assert problem.message == "not available: other.so receives no measurements of further sensors"
    assert library_problems(load_scenario("scheme-1", [f"gnc.library={library}", *MEASURED])) == []


def test_library_receives_all_that_is_measured_in_each_loop(tmp_path: Path, library: Path) -> None:
    uses = variant(tmp_path, USES_ALL)
    outcome, (history, _, stop) = flown(uses, 6.0, *MEASURED), compiled(uses, 6.0, *MEASURED)
    assert outcome.stop == stop == COMPLETED
    assert_same_bits(outcome.history, history, OF_DIGITAL_LINES)
    plain = compiled(library, 6.0, *MEASURED)[0]
    assert (history["navigation"]["r_CT_H"] != plain["navigation"]["r_CT_H"]).any()


@pytest.mark.parametrize("command", ["run", "campaign", "gnc check"])
def test_every_command_refuses_it(tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    path = str(variant(tmp_path, "return HIL_GNC_PROTOCOL; => return 99;"))
    setting = ["--set", f"gnc.library={path}"]
    arguments = {
        "run": ["run", "scheme-1", *setting],
        "campaign": ["campaign", "scheme-1", "--runs", "2", "--out", str(tmp_path / "out"), *setting],
        "gnc check": ["gnc", "check", path],
    }
    assert execute(arguments[command]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert "gnc.library" in lines[-1]
    assert "has protocol 99" in lines[-1]


def test_path_of_a_library_counts_from_the_folder_of_its_scenario(library: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('extends = "scheme-1"\n[gnc]\nlibrary = "lib/mygnc.so"\n')
    found = load_scenario(str(tmp_path / "mine.toml")).value.gnc.library
    assert found == str(tmp_path / "lib" / "mygnc.so")
