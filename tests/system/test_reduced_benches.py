"""Benches with fewer axes than six, or with rails that are not parallel to H: runs from their rig files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.cli.main import execute
from hil.config.load import load_scenario
from hil.errors import BadInput
from hil.session import build
from tests.support.lab_benches import BENCHES, rig_file
from tests.support.rows import assert_same_bits
from tests.support.run_settings import make_job

pytestmark = pytest.mark.xdist_group("campaign")

LOCK_STEP = {"rig.host.time": "lock_step"}
SIX = ("turned rails", "target on one axis")
"""Benches that show everything."""


@pytest.mark.parametrize("bench", BENCHES)
def test_bench_gives_a_verdict(bench: str, tmp_path: Path) -> None:
    run = hil.run("scheme-1", rig_file(tmp_path, bench), 1, 20.0)
    assert run.stop == "completed"
    unseen = run.summary["bench"]["unseen_m"]
    assert (unseen is None) == (bench in SIX)


def test_turned_rails_show_what_parallel_ones_show(tmp_path: Path) -> None:
    turned = hil.run("scheme-1", rig_file(tmp_path, "turned rails"), 1, 60.0)
    parallel = hil.run("scheme-1", "mock", 1, 60.0, {"rig.bench.bodies": []})
    np.testing.assert_allclose(turned.history["truth"]["r_CT_H"], parallel.history["truth"]["r_CT_H"], atol=0.02)
    assert turned.summary["bench"]["pose_error_mm"]["rms"] < 1.5 * parallel.summary["bench"]["pose_error_mm"]["rms"]


def test_motion_that_is_not_shown_is_reported_before_the_run_and_in_the_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    execute(["run", "scheme-1", "--rig", rig_file(tmp_path, "two rails"), "--duration", "10"])
    shown = capsys.readouterr()
    before, verdict = " ".join(shown.err.split()), " ".join(shown.out.split())
    assert "lab has no drive for rails.z: of the plan it does not show up to x y z 0.000 0.000" in before
    assert "not shown: up to x y z 0.000 0.000" in verdict
    largest = float(verdict.partition("not shown: up to x y z ")[2].split()[2])
    assert 0.25 < largest < 0.4  # the start is 0.3 m from the plane


def test_planar_scenario_is_flown_in_the_plane() -> None:
    run = hil.run("planar", "mock-planar", 1)
    assert run.accepted
    truth = run.history["truth"]
    assert not truth["r_CT_H"][:, 1].any()
    assert not truth["q_CH"][:, [0, 2]].any()
    assert np.abs(run.summary["bench"]["unseen_m"]).max() < 1e-12
    assert np.abs(run.summary["bench"]["unseen_deg"]).max() < 1e-9
    command = run.history["command"]
    assert not command["force"][:, 1].any()
    assert not command["torque"][:, [0, 2]].any()
    estimate = run.history["navigation"]
    for name, sigma, held in (("r_CT_H", "sigma_r_m", [1]), ("v_CT_H", "sigma_v_mps", [1]),
                              ("q_CH", "sigma_attitude_rad", [0, 2])):  # fmt: skip
        assert not estimate[name][:, held].any()
        assert not np.nan_to_num(estimate[sigma][:, held]).any()
    assert not estimate["w_CH_C"][:, [0, 2]].any()
    assert estimate["sigma_r_m"][-1, [0, 2]].all()
    assert run.nees().states == (7, 4)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        ([0.015, 0.0, 0.0], "poses stay on one side of it"),
        ([0.06, 0.0, 0.0], "out of it, up to "),
    ],
)
def test_pose_that_contradicts_the_plane_is_reported(error: list[float], text: str) -> None:
    run = hil.run("planar", "mock-planar", 1, 30.0, {"vmu.errors.bias_m": error})
    (said,) = (event.text for event in run.events if event.source == "vmu")
    assert said.startswith("measures another plane than that in which chaser.planar holds")
    assert text in said


def test_tumble_in_the_plane_is_estimated() -> None:
    tumble = {
        "truth.relative_motion": "nonlinear",
        "initial.position_m": [3.0, 0.0, 0.1],
        "target.motion": "tumble",
        "target.rate_degps": [0.0, 0.5, 0.0],
        "target.moments_kg_m2": [2000.0, 3000.0, 3500.0],
        "gnc.guidance.acceleration_mps2": 0.003,
        "gnc.guidance.deceleration_mps2": 0.003,
        "gnc.abort.hold_distance_m": 3.0,
        "gnc.abort.acceleration_mps2": 0.003,
    }
    run = hil.run("planar", "mock-planar", 1, 120.0, tumble)
    assert run.stop == "completed"
    assert not run.history["navigation"]["r_CT_H"][:, 1].any()
    assert run.summary["navigation"]["position_rmse_m"][0] < 0.003


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("initial.position_m=[5.0, 0.1, 0.0]", "initial.position_m: leaves the x-z plane of H"),
        ("initial.attitude_deg=[1.0, 0.0, 0.0]", "initial.attitude_deg: leaves the x-z plane of H"),
        ("target.attitude_deg=[1.0, 0.0, 0.0]", "target.attitude_deg: leaves the x-z plane of H"),
        ("gnc.guidance.ready_point_m=[0.4, 0.1, 0.0]", "gnc.guidance.ready_point_m: leaves the x-z plane"),
    ],
)
def test_planar_vehicle_stays_in_the_plane(setting: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["run", "planar", "--rig", "mock-planar", "--set", setting]) == 2
    shown = " ".join(capsys.readouterr().err.split())
    assert text in shown


def test_what_another_plane_holds_back_is_reported_before_the_run_and_in_the_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "xy.toml"
    turned = {
        key: [[x, -z, y] for x, y, z in getattr(load_scenario("planar").value.chaser.thrusters, key)]
        for key in ("position_m", "direction")
    }
    scenario.write_text(
        'extends = "planar"\nname = "xy"\n[initial]\nposition_m = [5.0, 0.3, 0.0]\nattitude_deg = [0.0, 0.0, 3.0]\n'
        '[chaser]\nplane = "xy"\n[chaser.thrusters]\n' + "".join(f"{key} = {rows}\n" for key, rows in turned.items())
    )
    rig = tmp_path / "level.toml"
    rig.write_text(
        'extends = "mock"\nname = "level"\n[bench]\nlever_arm_m = [0.0, 0.0, 0.0]\n'
        "[rails]\nz.fixed_m = 0.0\n[turntable]\nroll.fixed_deg = 0.0\npitch.fixed_deg = 0.0\n"
    )
    out = tmp_path / "run.json"
    assert execute(["run", str(scenario), "--rig", str(rig), "--json", str(out)]) == 0
    shown = capsys.readouterr()
    line = "the plane holds back up to 4.9e-05 m/s2, 0.0074 m/s in all, which no thruster gives"
    assert line in " ".join(shown.err.split())
    energy = json.loads(out.read_text())["verdict"]["energy"]
    assert energy["held_back_mps2"] == pytest.approx(4.9e-5, rel=0.1)
    assert energy["held_back_mps"] == pytest.approx(0.0074, rel=0.1)


@pytest.mark.parametrize(
    ("scenario", "bench"), [("planar", "plane"), ("scheme-1", "three rails and yaw"), ("scheme-1", "table of one axis")]
)
def test_compiled_loop_has_the_bits_of_the_python_cycle(scenario: str, bench: str, tmp_path: Path) -> None:
    job, rows = make_job(3.0, scenario=scenario, rig=rig_file(tmp_path, bench)), []
    for compiled in (True, False):
        with build.runner(replace(job, compiled=compiled)) as runner:
            rows.append(runner.run().history)
    assert_same_bits(*rows)


@pytest.mark.parametrize(
    ("scenario", "bench"),
    [("planar", "plane"), ("scheme-1", "table of one axis"), ("scheme-1", "target on one axis")],
)
def test_bench_runs_in_lock_step(scenario: str, bench: str, tmp_path: Path) -> None:
    run = hil.run(scenario, rig_file(tmp_path, bench, "emulated"), 1, 1.0, LOCK_STEP)
    assert run.stop == "completed"
    assert len(run.history) == 51


def test_planar_recording_is_replayed_to_the_bit(tmp_path: Path) -> None:
    hil.run("planar", "mock-planar", 1, 10.0, record=tmp_path)
    (recording,) = tmp_path.glob("*.mcap")
    assert execute(["replay", str(recording)]) == 0


PLANE_OF_A_LAB = """extends = "emulated-planar"
name = "lab"
[rotary_manipulator]
driver = "cia402"
servo = { gain_per_s = 30.0, lag_s = 0.006 }
pitch = { travel_deg = [-80.0, 80.0], rate_max_degps = 10.0, acceleration_max_degps2 = 5.0 }
[vmu]
driver = "udp"
[io]
driver = "none"
"""
"""Two rails, a table and a target of one axis, a camera of its own, no coupler."""


def test_plane_with_a_target_on_one_axis_runs_in_lock_step(tmp_path: Path) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text(PLANE_OF_A_LAB)
    with pytest.raises(BadInput, match=r"rig\.rotary_manipulator: cia402: is missing, the table of its bus"):
        hil.run("planar", str(rig), 1, 1.0, LOCK_STEP)
    rig.write_text(PLANE_OF_A_LAB + '[rotary_manipulator.cia402]\ninterface = "serial"\nnode_ids = [1]\n')
    assert hil.run("planar", str(rig), 1, 1.0, LOCK_STEP).stop == "completed"
