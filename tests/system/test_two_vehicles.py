"""Two driven vehicles: the approach that one shows, checks of both, keep-out, recording, campaign and lock-step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.cli.main import execute
from hil.core.modes import Mode
from hil.errors import BadInput, BenchError
from hil.recording.read import load
from hil.session import build
from tests.support.run_settings import make_job

pytestmark = pytest.mark.xdist_group("campaign")

RIG = "mock-two-vehicles"
PATH = {
    "rig.target_manipulator.sharing": "path",
    "rig.target_manipulator.path_s": [0.0, 8.0],
    "rig.target_manipulator.path_m": [[-2.5, 0.0, 0.0], [-2.2, 0.3, 0.0]],
    "rig.rails.x.travel_m": [-3.0, 3.0],
}
EMULATED = """extends = "emulated-planar"
name = "two vehicles"
[bench]
bodies = []
[rails.x]
travel_m = [-0.5, 3.0]
park_m = 2.0
[target_manipulator]
driver = "modbus"
sharing = "travel"
servo = { gain_per_s = 25.0, lag_s = 0.008 }
x = { travel_m = [-3.0, 0.2], rate_max_mps = 0.5, acceleration_max_mps2 = 0.6 }
y = { travel_m = [-1.0, 1.0], rate_max_mps = 0.5, acceleration_max_mps2 = 0.6 }
"""


def test_two_vehicles_show_what_one_shows() -> None:
    both, one = hil.run("planar", RIG, 1, 20.0), hil.run("planar", "mock-planar", 1, 20.0)
    assert both.stop == "completed"
    np.testing.assert_allclose(both.history["truth"]["r_CT_H"], one.history["truth"]["r_CT_H"], atol=0.05)
    assert both.summary["bench"]["pose_error_mm"]["rms"] < 1.5 * one.summary["bench"]["pose_error_mm"]["rms"]
    assert np.abs(both.summary["bench"]["unseen_m"]).max() < 0.005  # by the encoders
    largest = both.summary["manipulator"]
    assert 2.0 < largest["position_max_m"][0] < 3.0
    assert largest["rate_max_mps"][0] > 0.003


@pytest.mark.parametrize("path", [{}, PATH])
def test_target_moves_and_the_chaser_shows_the_rest(path: dict[str, object], tmp_path: Path) -> None:
    run = hil.run("planar", RIG, 1, 10.0, path, record=tmp_path)
    assert run.stop == "completed"
    (file,) = tmp_path.glob("*.mcap")
    recorded = load(file)
    target, relative = recorded.held_samples["position"][:, :2], recorded.cycles["feedback"]["rail_m"][:, :2]
    assert len(target) == len(relative)
    moved = np.ptp(target, axis=0)
    assert moved[0] == pytest.approx(0.3, abs=0.02) if path else moved[0] > 0.01
    chaser = relative + target
    assert (np.abs(chaser[:, 0]) < 3.0).all()
    assert np.abs(relative[:, 0] - recorded.cycles["truth"]["r_CT_H"][:, 0]).max() < 0.01
    assert execute(["replay", str(file)]) == 0


def test_plan_beyond_the_travel_of_both_is_refused_with_where_the_target_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["run", "planar", "--rig", RIG, "--set", "initial.position_m=[6.5, 0.0, 0.3]"]) == 2
    shown = " ".join(capsys.readouterr().err.split())
    assert "rails.x would go to" in shown
    assert "with target_manipulator at x -3.000" in shown


def test_scaled_distance_is_refused_with_a_target_that_moves(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["run", "planar", "--rig", RIG, "--set", "bench.scaled_beyond_m=4.0"]) == 2
    assert "does not go with target_manipulator.sharing" in " ".join(capsys.readouterr().err.split())


def test_keep_out_is_that_of_the_relative_position() -> None:
    """The target runs towards a chaser whose rail stands: the bench guard stops both."""
    with build.runner(make_job(20.0, scenario="planar", rig=RIG)) as runner:
        (target,) = runner.loop.target.groups
        zone = runner.loop.memory.params.bench_guard.zone
        zone.radius, zone.plane = 4.9, 4.9  # m, just nearer than the start
        outcome = runner.run()
        assert np.abs(target.axes.servo.rate).max() < 1e-6
    assert outcome.mode is Mode.SAFE_STOP
    assert outcome.stop.startswith("bench: distance from the target along the docking axis 4.9")


def test_two_vehicles_fly_in_campaigns(tmp_path: Path) -> None:
    campaign = hil.campaign("planar", 2, tmp_path, duration_s=1.0, rig=RIG)
    assert campaign.summary["runs"] == 2


def test_two_vehicles_run_in_lock_step(tmp_path: Path) -> None:
    rig = tmp_path / "two.toml"
    rig.write_text(EMULATED, encoding="utf-8")
    run = hil.run("planar", str(rig), 1, 1.0, {"rig.host.time": "lock_step"})
    assert run.stop == "completed"
    assert len(run.history) == 51


def _box(x_low: float, x_high: float) -> list[list[float]]:
    return [[x, y, z] for x in (x_low, x_high) for y in (-0.3, 0.3) for z in (-0.3, 0.3)]


@pytest.mark.parametrize(
    ("target", "wall", "pair"),
    [((-1.0, 0.0), (-5.0, -4.2), ""), ((-1.0, 4.5), (-5.0, -4.2), "1 and 2"), ((-1.0, 0.0), (-5.0, -3.3), "2 and 3")],
)
def test_what_carries_the_target_stays_apart_from_chaser_and_lab(
    target: tuple[float, float], wall: tuple[float, float], pair: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies = {"carriage": (0.3, 1.2), "target": target, "lab": wall}
    table = {"rig.bench.bodies": [{"on": on, "vertices_m": _box(*ends)} for on, ends in bodies.items()]}
    if pair:
        with pytest.raises(BadInput, match=f"rig.bench.bodies: {pair} would be") as refused:
            hil.run("planar", RIG, 1, 10.0, table)
        assert len(refused.value.problems) == 1
        monkeypatch.setattr(build, "check_bodies", lambda *_: [])
    run = hil.run("planar", RIG, 1, 60.0 if pair else 10.0, table)
    assert run.stop.partition(" 0")[0] == ("bench: distance of bodies" if pair else "completed")
    assert not pair or f"bench.bodies {pair}" in run.stop


@pytest.mark.parametrize(("axis", "inwards"), [("rails.x", -1), ("target.x", 1)])
def test_jog_keeps_what_carries_the_target_apart_from_the_chaser_and_may_lead_away(axis: str, inwards: int) -> None:
    bodies = {"carriage": (0.3, 1.2), "target": (-1.0, 0.0)}
    table = {"rig.bench.bodies": [{"on": on, "vertices_m": _box(*ends)} for on, ends in bodies.items()]}
    with hil.Bench(RIG, "planar", overrides=table) as bench:
        bench.home()
        if axis == "target.x":
            bench.jog("rails.x", -1, 51.0)
        with pytest.raises(BenchError, match=r"bench: distance of bodies 0.1\d+ m \(bench.bodies 1 and 2\)"):
            bench.jog(axis, inwards, 60.0)
        bench.reset()
        stopped, _ = bench.axis_feedback(axis)
        bench.jog(axis, -inwards, 2.0)
        assert inwards * (stopped - bench.axis_feedback(axis)[0]) > 0.02


def test_target_on_rails_and_gimbals_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "both.toml"
    rig.write_text(
        f'extends = "{RIG}"\nname = "both"\n[rotary_manipulator]\ndriver = "mock"\n'
        "servo = { gain_per_s = 30.0, lag_s = 0.006 }\n"
        "yaw = { travel_deg = [-170.0, 170.0], rate_max_degps = 10.0, acceleration_max_degps2 = 5.0 }\n"
    )
    assert execute(["run", "planar", "--rig", str(rig)]) == 2
    shown = " ".join(capsys.readouterr().err.split())
    assert "gimbals and rails of target_manipulator do not move the target together" in shown
    assert "are linear_axes.NAME" in shown


def test_body_of_the_target_requires_that_it_moves(capsys: pytest.CaptureFixture[str]) -> None:
    bodies = "rig.bench.bodies=[{on='target', vertices_m=[[0,0,0],[1,0,0],[0,1,0],[0,0,1]]}, "
    bodies += "{on='lab', vertices_m=[[5,0,0],[6,0,0],[5,1,0],[5,0,1]]}]"
    assert execute(["run", "planar", "--rig", "mock-planar", "--set", bodies]) == 2
    assert 'on = "target" requires target_manipulator.sharing' in " ".join(capsys.readouterr().err.split())
