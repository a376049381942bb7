"""From plan to compensated run on a mock rig that is built wrong, by the commands."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hil.bench.machine_poses import poses_of_machines
from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.params import bench as bench_params
from hil.parts.geometry.measure import clearance
from hil.parts.geometry.model import rotations_between
from hil.parts.geometry.observations import read_observations
from hil.parts.geometry.plan import read_plan
from hil.session.build import Job, runner
from tests.support.rows import OF_DIGITAL_LINES, assert_same_bits

SHORT = "rig.rails.x.travel_m=[-0.2, 8.0]"
ERRORS = ("--set", "rig.bench.errors.seed=5")
POSES = 48


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with plan, observations and geometry file of a mock rig that is built wrong."""
    folder = tmp_path_factory.mktemp("geometry")
    plan, rows, geometry = folder / "plan.csv", folder / "rows.csv", folder / "geometry.toml"
    assert execute(["geometry", "plan", "mock", "-o", str(plan), "--poses", str(POSES), "--set", SHORT]) == 0
    measure = [
        "geometry",
        "measure",
        str(plan),
        "--rig",
        "mock",
        "-o",
        str(rows),
        "--set",
        SHORT,
        *ERRORS,
        "--average-s",
        "0.5",
    ]
    assert execute(measure) == 0
    assert execute(["geometry", "fit", str(rows), "--rig", "mock", "-o", str(geometry), "--set", SHORT]) == 0
    return folder


def job(*settings: str) -> Job:
    scenario = load_scenario("scheme-1", settings)
    return Job(scenario, load_rig("mock", [SHORT, *settings]), 1, 20.0, 1.0)


def off_truth(settings: list[str]) -> tuple[float, float]:
    """Return rms of the true bench pose against the truth of a run, per axis, m and rad."""
    made = job(*settings)
    rig, scenario = made.rig.value, made.scenario.value
    with runner(made) as run:
        history = run.run().history
    machine = bench_params.bench_as_built(rig, scenario.step_s, scenario.bench)
    rows = history[history["t_s"] > 5.0]
    machines = np.zeros(1, machine.dtype).view(np.recarray)
    machines[0] = machine
    r, q = np.empty((1, len(rows), 3)), np.empty((1, len(rows), 4))
    rails, gimbals = (np.ascontiguousarray(rows["feedback"][name]) for name in ("rail_m", "gimbal_rad"))
    poses_of_machines(machines, rails, gimbals, r, q)
    turned = rotations_between(q[0], np.ascontiguousarray(rows["truth"]["q_CH"]))
    off = r[0] - rows["truth"]["r_CT_H"]
    return float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(turned**2)))


def test_poses_of_the_plan_are_within_travel_and_clear(folder: Path) -> None:
    axes, is_clear = read_plan(str(folder / "plan.csv")), clearance(job())
    low, high = np.array([axis.limits[:2] for axis in (*job().rig.value.rails.axes, *job().rig.value.turntable.axes)]).T
    assert len(axes) > 0.9 * POSES
    assert ((axes > low) & (axes < high)).all()
    assert all(is_clear(a, b) for a, b in pairwise(axes))


def test_each_pose_has_its_reason(folder: Path) -> None:
    with (folder / "plan.csv").open(encoding="utf-8") as file:
        assert all("variance less by" in row["reason"] for row in csv.DictReader(file))


def test_observations_are_at_the_planned_places(folder: Path) -> None:
    rows = read_observations(str(folder / "rows.csv"))
    assert np.abs(rows.axes - read_plan(str(folder / "plan.csv"))).max() < 1e-3


def test_a_machine_built_wrong_is_right_with_its_geometry_file(folder: Path) -> None:
    lead = ["rig.rails.x.lead_s=-0.0107", "rig.rails.y.lead_s=-0.0107", "rig.rails.z.lead_s=-0.0107"]
    lead += [
        "rig.turntable.roll.lead_s=-0.0107",
        "rig.turntable.pitch.lead_s=-0.0107",
        "rig.turntable.yaw.lead_s=-0.0107",
    ]
    wrong = [ERRORS[1], *lead]
    before = off_truth(wrong)
    after = off_truth([*wrong, f"rig.bench.geometry_file={folder / 'geometry.toml'}"])
    assert before[0] > 5e-4
    assert after[0] < 5e-5
    assert after[1] < np.radians(0.005)


def test_the_compiled_loop_compensates_with_the_bits_of_the_cycle(folder: Path) -> None:
    histories = []
    for compiled in (True, False):
        made = job(ERRORS[1], f"rig.bench.geometry_file={folder / 'geometry.toml'}")
        with runner(replace(made, duration_s=3.0, compiled=compiled)) as run:
            histories.append(run.run().history)
    assert_same_bits(histories[1], histories[0], OF_DIGITAL_LINES)


def test_the_drift_check_of_the_same_bench_passes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    geometry = f"rig.bench.geometry_file={folder / 'geometry.toml'}"
    words = ["--rig", "mock", "--set", SHORT, "--set", geometry, "--json", "-", "--chart", str(folder / "chart.csv")]
    capsys.readouterr()
    code = execute(["geometry", "check", str(folder / "rows.csv"), *words])
    result = json.loads(capsys.readouterr().out)
    assert code == 0
    assert result["verdict"] == "no drift"


def test_a_geometry_file_that_is_missing_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--rig", "mock", "-o", str(folder / "none.csv"), "--set", "rig.bench.geometry_file=none.toml"]
    assert execute(["geometry", "measure", str(folder / "plan.csv"), *words]) == 2
    assert "none.toml" in capsys.readouterr().err
