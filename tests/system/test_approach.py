"""The approach as a whole, on the mock rig: phases, abort, docking decision, the four parts of the verdict."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.cli.main import execute
from hil.loop.outcome import Outcome
from hil.session import build
from tests.support.plain_filters import PLAIN
from tests.support.run_settings import make_job


def _run(scenario: str, seed: int, duration_s: float, *settings: str) -> Outcome:
    job = make_job(duration_s, settings, scenario=scenario, seed=seed)
    with build.runner(job) as runner:
        return runner.run()


def _texts(outcome: Outcome) -> list[str]:
    return [event.text for event in outcome.events]


@pytest.mark.parametrize(
    ("scenario", "at_s", "seed"),
    [("scheme-1", 3.0, 0), ("scheme-1", 20.0, 1), ("scheme-2", 5.0, 2), ("scheme-2", 40.0, 3), ("scheme-1", 10.0, 4)],
)
def test_retreat_is_never_nearer_than_the_trigger_minus_five_centimetres(scenario: str, at_s: float, seed: int) -> None:
    outcome = _run(scenario, seed, at_s + 25.0, *PLAIN, f"gnc.abort.at_s={at_s}")
    distance = np.linalg.norm(outcome.history["truth"]["r_CT_H"], axis=1)
    trigger = int(np.argmax(outcome.history["supervision"]["aborted"] != 0))
    assert outcome.history["t_s"][trigger] == pytest.approx(at_s)
    assert distance[trigger:].min() >= distance[trigger] - 0.05
    assert distance[-1] >= distance[trigger] - 0.02


@pytest.mark.parametrize(
    ("velocity", "words"),
    [
        ("[0.0, 0.12, 0.0]", "reaction hold: the corridor was left"),  # before it was entered
        ("[-0.12, 0.0, 0.0]", "abort: the closing rate was too high"),
    ],
)
def test_violated_limit_stops_the_approach(velocity: str, words: str) -> None:
    outcome = _run("scheme-1", 0, 40.0, f"initial.velocity_mps={velocity}", "gnc.control.correction_rate_mps=0.001")
    assert any(text.startswith(words) for text in _texts(outcome)), _texts(outcome)
    if words.startswith("abort"):
        assert outcome.history["reference"]["phase"][-1] >= 2


def test_aborted_run_is_complete_but_not_passed_and_gives_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    settings = ["--set", "gnc.abort.at_s=5", "--set", "initial.position_m=[2.0,0.0,0.0]"]
    assert execute(["run", "scheme-1", "--duration", "40", "--json", str(path), *settings]) == 1
    result = json.loads(path.read_text())
    assert (result["passed"], result["passed_all_parts"], result["stop"]) == (False, False, "completed")
    texts = [event["text"] for event in result["events"]]
    assert texts[1].startswith("abort: ordered")
    assert texts[2:5] == ["phase abort: brake begins", "phase abort: retreat begins", "phase abort: hold begins"]
    assert texts[-1] == "docking: no-go, the approach was aborted"
    abort = result["verdict"]["security"]["abort"]
    assert abort["range_at_end_m"] == pytest.approx(2.0, abs=0.02)
    assert abort["drift_from_end"]["nearest_m"] > 0.0
    assert result["verdict"]["security"]["passed"]


SHORT = (
    "initial.position_m=[0.7,0.0,0.0]",
    "initial.attitude_deg=[0.5,0.5,-0.5]",
    'gnc.guidance.sequence=["approach","pause","ready","dock"]',
    "gnc.guidance.phases.approach.point_m=[0.5,0.0,0.0]",
    "gnc.guidance.phases.pause.kind=hold",
    "gnc.guidance.phases.pause.duration_s=4.0",
    "gnc.guidance.phases.ready.kind=wait",
    "gnc.guidance.phases.dock.kind=final",
    "gnc.guidance.phases.dock.speed_mps=0.01",
    "requirements.axial_distance_m=0.5",
)


def test_phases_are_flown_in_order_and_docking_waits_for_the_ready_state() -> None:
    outcome = _run("scheme-1", 0, 80.0, *SHORT, "gnc.guidance.phases.ready.end_time_s=40.0")
    begun = [(event.t_s, event.text) for event in outcome.events if event.text.startswith("phase")]
    assert [text for _, text in begun] == [f"phase {name} begins" for name in ("approach", "pause", "ready", "dock")]
    assert begun[2][0] - begun[1][0] == pytest.approx(4.0, abs=0.021)
    ready = next(event.t_s for event in outcome.events if event.text.startswith("ready:"))
    assert begun[3][0] >= max(40.0, ready)


def test_docking_phase_is_refused_while_the_ready_state_does_not_hold() -> None:
    outcome = _run(
        "scheme-1", 0, 40.0, *SHORT, "gnc.guidance.phases.ready.end_time_s=15.0", "requirements.radial_distance_m=1e-6"
    )
    assert "phase dock begins" not in _texts(outcome)
    assert _texts(outcome)[-1].startswith("docking: no-go, the ready state does not hold: y 0.00")


@pytest.fixture(scope="module")
def scheme_1(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the JSON of scheme 1, seed 1."""
    path = tmp_path_factory.mktemp("run") / "run.json"
    assert execute(["run", "scheme-1", "--seed", "1", "--json", str(path)]) == 0
    result: dict[str, Any] = json.loads(path.read_text())
    return result


def test_shipped_scheme_passes_all_four_parts(scheme_1: dict[str, Any]) -> None:
    assert scheme_1["passed_all_parts"]
    parts = scheme_1["verdict"]
    assert list(parts) == ["control_precision", "security", "energy", "field_of_view"]
    assert all(part["passed"] for part in parts.values())
    assert parts["energy"]["least_line_mps"] == pytest.approx(0.06, abs=1e-6)
    assert parts["energy"]["propellant_kg"] == scheme_1["thrusters"]["propellant_kg"]
    assert parts["security"]["abort"] is None


def test_ready_phase_and_docking_decision_are_events(scheme_1: dict[str, Any]) -> None:
    texts = [event["text"] for event in scheme_1["events"]]
    assert texts[:2] == ["phase approach begins", "phase ready begins"]
    ready = next(event for event in scheme_1["events"] if event["text"].startswith("ready:"))
    assert ready["t_s"] == pytest.approx(scheme_1["ready_time_s"], abs=1.0)
    assert texts[-1].startswith("docking: go")
