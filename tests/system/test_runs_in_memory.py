"""Whole runs on the mock rig, through the command line."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.cli.main import execute
from hil.config.load import load_scenario
from hil.params.ready import ROW_NAMES
from hil.report.verdict import TABLE_V
from hil.session import build
from tests.support.run_settings import make_job, typed


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, dict[str, Any]]]:
    """Exit code and JSON of each scheme, seed 0."""
    folder = tmp_path_factory.mktemp("runs")
    found = {}
    for name in ("scheme-1", "scheme-2", "scheme-3"):
        path = folder / f"{name}.json"
        code = execute(["run", name, "--rig", "mock", "--json", str(path)])
        found[name] = (code, json.loads(path.read_text()))
    return found


def _history(scenario: str, seed: int, duration_s: float, *settings: str) -> np.ndarray:
    job = make_job(duration_s, settings, scenario=scenario, seed=seed)
    with build.runner(job) as runner:
        return runner.run().history


@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2"])
def test_fused_schemes_pass_and_stay_below_the_papers_table_v(runs: Any, scheme: str) -> None:
    code, result = runs[scheme]
    assert code == 0
    assert result["passed"]
    assert result["stop"] == "completed"
    for row in ROW_NAMES:
        assert np.all(np.array(result["ready_phase"][row]) < getattr(TABLE_V[scheme], row)), row


@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2"])
def test_ready_phase_is_reached_when_the_paper_reaches_it(runs: Any, scheme: str) -> None:
    paper = TABLE_V[scheme].ready_time_s
    assert paper is not None
    assert runs[scheme][1]["ready_time_s"] <= 1.05 * paper
    assert runs[scheme][1]["ready_time_s"] >= 0.9 * paper


def test_vision_alone_costs_attitude_and_little_else(runs: Any) -> None:
    fused, alone = runs["scheme-2"][1], runs["scheme-3"][1]
    angle = [max(run["navigation"]["attitude_rmse_deg"]) for run in (fused, alone)]
    assert angle[1] > 1.2 * angle[0]
    assert alone["thrusters"]["propellant_kg"] < 1.5 * fused["thrusters"]["propellant_kg"]
    assert alone["accepted"]


def test_json_holds_the_keys_that_others_read(runs: Any) -> None:
    result = runs["scheme-1"][1]
    top = {"scenario", "seed", "rig", "passed", "stop", "ready_time_s", "ready_phase", "navigation", "thrusters"}
    assert top | {"timing", "faults"} <= set(result)
    assert set(ROW_NAMES) <= set(result["ready_phase"])
    navigation = {"position_rmse_m", "velocity_rmse_mps", "attitude_rmse_deg", "position_bound_m", "attitude_bound_deg"}
    assert navigation | {"nees_pkf", "nees_akf"} <= set(result["navigation"])
    thrusters = {"force_on_time_s", "torque_on_time_s", "torque_on_time_360_400_s", "propellant_kg"}
    assert thrusters <= set(result["thrusters"])
    assert {"rate_hz", "cycles", "overruns", "lateness_us"} <= set(result["timing"])
    assert set(result["timing"]["lateness_us"]) == {"p50", "p99", "p999", "max"}


def test_navigation_without_an_error_budget_sits_near_its_bound() -> None:
    navigation = hil.run("scheme-1-paper", seed=2).summary["navigation"]
    ratio = np.array(navigation["position_rmse_m"]) / np.array(navigation["position_bound_m"])
    assert np.all(ratio < 1.5)
    assert max(navigation["attitude_rmse_deg"]) < 0.002


def test_same_seed_gives_the_same_run_bit_for_bit() -> None:
    first, second = (_history("scheme-2", 7, 40.0) for _ in range(2))
    assert first.tobytes() == second.tobytes()


def test_another_seed_gives_another_run() -> None:
    assert _history("scheme-1", 1, 4.0).tobytes() != _history("scheme-1", 2, 4.0).tobytes()


def test_schemes_2_and_3_see_the_same_sensor_noise_for_the_same_seed() -> None:
    fused, alone = (_history(name, 3, 2.0)["pose"] for name in ("scheme-2", "scheme-3"))
    assert np.array_equal(fused["z_TC_C"][0], alone["z_TC_C"][0])


def test_propellant_is_the_thrust_that_the_valves_let_through(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    execute(["run", "scheme-1", "--duration", "40", "--json", str(path), "--set", "truth.force_scatter_sigma=0.0"])
    thrusters = json.loads(path.read_text())["thrusters"]
    scenario = load_scenario("scheme-1").value
    flow = scenario.chaser.thrusters.force_n / (scenario.chaser.thrusters.specific_impulse_s * 9.80665)
    assert thrusters["propellant_kg"] == pytest.approx(flow * sum(thrusters["thruster_on_time_s"]), rel=1e-3)


@pytest.mark.parametrize(
    ("guard", "text"),
    [
        ("true", r"rails\.[xyz]: distance from the demand 0\.\d+ m, allowed 0\.\d+ m"),
        ("false", r"rails\.[xyz]: following error 0\.\d+ m, allowed 0\.002 m"),
    ],
)
def test_run_whose_bench_does_not_follow_is_stopped_and_names_the_axis(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, guard: str, text: str
) -> None:
    path = tmp_path / "run.json"
    slow = [f"rig.rails.servo.{key}" for key in ("gain_per_s=0.5", "lag_s=3.0")] + [
        "rig.rails.following_error_max_m=0.002",
        f"rig.guard.enabled={guard}",
    ]
    assert execute(["run", "scheme-1", "--duration", "30", "--json", str(path), *typed(*slow)]) == 3
    result = json.loads(path.read_text())
    assert re.match(text, result["stop"]), result["stop"]
    assert not result["passed"]
    capsys.readouterr()
