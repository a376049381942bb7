"""A scenario that the bench cannot follow is refused before anything moves; one that is let through is followed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hil.checks.reachability import axis_demands, check_reachability
from hil.cli.main import execute
from hil.config.load import Loaded, load_rig, load_scenario
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, Rig
from hil.session import build
from tests.support.run_settings import typed

REFUSALS = {
    "rail's travel, by the dispersion": (
        ("rig.rails.y.travel_m=[-0.35, 1.5]",),
        "initial.position_m: rails.y would go to -0.412 m (planned -0.285 m) at 3.8 s, "
        "allowed -0.35 to 1.5 m by rig.rails.y.travel_m",
    ),
    "rail's travel, by a later phase": (
        (
            'gnc.guidance.sequence=["approach", "back", "ready"]',
            "gnc.guidance.phases.back.kind=retreat",
            "gnc.guidance.phases.back.point_m=[2.0, 1.6, 0.0]",
        ),
        "gnc.guidance.phases.back.point_m: rails.y would go to 1.674 m (planned 1.600 m) at 238.2 s, "
        "allowed -1.5 to 1.5 m by rig.rails.y.travel_m",
    ),
    "rail's travel, by the lever arm": (
        ("rig.bench.lever_arm_m=[0.0, 0.0, 4.0]",),
        "gnc.guidance.ready_point_m: rails.z would go to -4.019 m (planned -4.000 m) at 158.4 s, "
        "allowed -1.5 to 1.5 m by rig.rails.z.travel_m",
    ),
    "rail's travel, by the retreat of an abort alone": (
        ("gnc.corridor.axis=[0.995, 0.09987492177719089, 0.0]", "rig.rails.y.travel_m=[-0.5, 0.5]"),
        "gnc.abort.hold_distance_m: rails.y would go to 0.580 m (planned 0.454 m) at 257.6 s, "
        "in an abort begun at 158.4 s, allowed -0.5 to 0.5 m by rig.rails.y.travel_m",
    ),
    "rail's speed": (
        ("rig.rails.x.rate_max_mps=0.035",),
        "gnc.guidance.approach_speed_mps: rails.x would go at up to 0.04 m/s (planned 0.0299 m/s, the rest is "
        "control) at 5.1 s, allowed 0.035 m/s by rig.rails.x.rate_max_mps",
    ),
    "rail's speed, in the retreat of an abort": (
        ("rig.rails.x.rate_max_mps=0.058",),
        "gnc.abort.speed_mps: rails.x would go at up to 0.0597 m/s (planned 0.05 m/s, the rest is control) at 219.4 s, "
        "in an abort begun at 203.3 s, allowed 0.058 m/s by rig.rails.x.rate_max_mps",
    ),
    "rail's acceleration": (
        ("rig.rails.y.acceleration_max_mps2=0.015",),
        "chaser.thrusters.force_n: rails.y would be asked for up to 0.0251 m/s2 at 0.0 s, "
        "allowed 0.015 m/s2 by rig.rails.y.acceleration_max_mps2",
    ),
    "gimbal's range, by the initial attitude": (
        ("rig.turntable.roll.travel_deg=[-60.0, 3.5]",),
        "initial.attitude_deg: turntable.roll would go to 4.07 deg (planned 3.00 deg) at 0.0 s, "
        "allowed -60 to 3.5 deg by rig.turntable.roll.travel_deg",
    ),
    "gimbal's range, by the dispersion": (
        ("rig.turntable.pitch.travel_deg=[-0.5, 45.0]",),
        "initial.attitude_deg: turntable.pitch would go to -1.01 deg (planned 0.00 deg) at 9.9 s, "
        "allowed -0.5 to 45 deg by rig.turntable.pitch.travel_deg",
    ),
    "gimbal's speed": (
        ("rig.turntable.pitch.rate_max_degps=0.35",),
        "gnc.control.slew_rate_degps: turntable.pitch would go at up to 0.392 deg/s (all of it is control) at 0.0 s, "
        "allowed 0.35 deg/s by rig.turntable.pitch.rate_max_degps",
    ),
    "gimbal's acceleration": (
        ("rig.turntable.yaw.acceleration_max_degps2=0.5",),
        "chaser.thrusters.force_n: turntable.yaw would be asked for up to 0.796 deg/s2 at 0.0 s, "
        "allowed 0.5 deg/s2 by rig.turntable.yaw.acceleration_max_degps2",
    ),
    "field of view, by the place": (
        (
            "gnc.guidance.ready_point_m=[0.2, 0.0, 0.0]",
            "keep_out.radius_m=0.1",
            "keep_out.bodies=[]",
            "rig.bench.bodies=[]",
        ),
        "gnc.guidance.ready_point_m: vmu: an LED of the ring would be 25 px outside an image (planned: 32 px inside "
        "an image) at 165.0 s, allowed 0 px or more inside both images of 1024 x 1024 px",
    ),
    "field of view, by the attitude": (
        ("initial.attitude_deg=[0.0, 25.0, 0.0]",),
        "initial.attitude_deg: vmu: an LED of the ring would be 150 px outside an image (planned: 88 px outside "
        "an image) at 0.0 s, allowed 0 px or more inside both images of 1024 x 1024 px",
    ),
    "a start that carries the chaser off": (
        ("initial.velocity_mps=[0.0, 0.0, 0.15]",),
        "initial.velocity_mps: rails.z would go to 1.712 m (planned 1.691 m) at 19.1 s, "
        "allowed -1.5 to 1.5 m by rig.rails.z.travel_m",
    ),
    "a start that is too fast to catch up with": (
        ("initial.velocity_mps=[0.0, 0.0, 0.05]", "rig.rails.z.acceleration_max_mps2=0.1"),
        "initial.velocity_mps: rails.z would need 0.5 s at 0.0 s to catch up with 0.05 m/s at 0.1 m/s2, "
        "allowed 0.2 s by reachability.startup_lag_s",
    ),
}


@pytest.mark.parametrize("what", REFUSALS)
def test_scenario_that_the_bench_cannot_follow_is_refused_in_one_line_per_axis(
    capsys: pytest.CaptureFixture[str], what: str
) -> None:
    settings, words = REFUSALS[what]
    scheme = "scheme-2" if "abort.speed" in words else "scheme-1"
    assert execute(["run", scheme, *typed(*settings)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    where, _, told = printed.err.rstrip("\n").partition(": ")
    assert told == words
    assert where == "--set" or where.endswith("scheme-1.toml")


def test_refusal_names_the_files_that_disagree(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario, rig = tmp_path / "wide.toml", tmp_path / "short.toml"
    scenario.write_text('extends = "scheme-1"\nname = "wide"\n[initial]\nposition_m = [5.0, -0.3, 1.2]\n')
    rig.write_text(
        'extends = "mock"\nname = "short"\n[rails.x]\ntravel_m = [0.45, 12.0]\n[rails.z]\ntravel_m = [-1, 0.8]\n'
    )
    assert execute(["run", str(scenario), "--rig", str(rig)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].endswith("allowed 0.45 to 12 m by rig.rails.x.travel_m")
    assert ": gnc.guidance.ready_point_m: rails.x would go to 0.3" in lines[0]
    assert lines[1].startswith(f"{scenario}: initial.position_m: rails.z would go to 0.9")


def test_rail_without_the_oblique_retreat_is_long_enough() -> None:
    """The counterpart of the refusal by an abort alone: the same rail with the retreat along it."""
    settings = ("rig.rails.y.travel_m=[-0.5, 0.5]",)
    assert check_reachability(load_scenario("scheme-1", settings), load_rig("mock", settings)) == []


@pytest.mark.parametrize("rig", ["mock", "emulated"])
@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2", "scheme-3", "scheme-1-printed"])
def test_shipped_scenarios_suit_the_shipped_rigs(scheme: str, rig: str) -> None:
    assert check_reachability(load_scenario(scheme), load_rig(rig)) == []


def test_chaser_without_thrusters_for_an_axis_is_refused_by_its_layout(capsys: pytest.CaptureFixture[str]) -> None:
    thrusters = "chaser.thrusters.position_m=[[0.0, 1.0, 0.0]]", "chaser.thrusters.direction=[[1.0, 0.0, 0.0]]"
    assert execute(["run", "scheme-1", "--set", thrusters[0], "--set", thrusters[1]]) == 2
    assert "chaser.thrusters.position_m: no thrusters for the" in capsys.readouterr().err


def _random_settings(rng: np.random.Generator) -> tuple[str, ...]:
    """Return a scenario at random that starts at rest: start, speeds, control, and an abort at any time."""
    position = [rng.uniform(2.0, 8.0), *rng.uniform(-0.5, 0.5, 2)]
    numbers = {
        "initial.attitude_deg": rng.uniform(-8.0, 8.0, 3).tolist(),
        "gnc.guidance.approach_speed_mps": rng.uniform(0.01, 0.035),
        "gnc.guidance.acceleration_mps2": rng.uniform(0.002, 0.008),
        "gnc.control.slew_rate_degps": rng.uniform(0.2, 0.6),
        "gnc.abort.at_s": rng.uniform(10.0, 60.0),
        "gnc.abort.speed_mps": rng.uniform(0.02, 0.06),
        "rig.bench.lever_arm_m": rng.uniform(-0.4, 0.4, 3).tolist(),
    }
    order = ("zyx", "zxy", "yzx", "yxz", "xyz", "xzy")[rng.integers(6)]
    return (
        f"initial.position_m={[float(x) for x in position]}",
        f"rig.bench.gimbal_order={order}",
        *(f"{key}={value}" for key, value in numbers.items()),
    )


def _barely_enough(scenario: str, settings: tuple[str, ...]) -> Loaded[Rig]:
    """Return a mock rig whose every limit is what the check asks for, and no more."""
    loaded = load_rig("mock", settings)
    flown = load_scenario(scenario, settings).value
    hardest = axis_demands(flown, loaded.value).axes.acceleration.max(axis=0) * (1.0 + 1e-6)
    rig = _limited(loaded.value, {}, hardest)
    asked = axis_demands(flown, rig).axes  # the braking distance depends on the acceleration
    travel = np.stack([asked.low.min(axis=0), asked.high.max(axis=0)]) + np.array([[-1e-6], [1e-6]])
    rig = _limited(rig, {"travel": travel, "rate_max": asked.rate.max(axis=0) * (1.0 + 1e-6)}, hardest)
    return Loaded(rig, loaded.source, loaded.origin)


def _limited(rig: Rig, limits: dict[str, np.ndarray], hardest: np.ndarray) -> Rig:
    groups = {}
    for group, names, first, unit, scale in (
        ("rails", RAIL_NAMES, 0, "m", 1.0),
        ("turntable", GIMBAL_NAMES, 3, "deg", math.degrees(1.0)),
    ):
        axes = {}
        for k, name in enumerate(names, start=first):
            update = {f"acceleration_max_{unit}ps2": float(hardest[k]) * scale}
            if limits:
                low, high = limits["travel"][:, k] * scale
                update |= {f"travel_{unit}": (low, high), f"rate_max_{unit}ps": float(limits["rate_max"][k]) * scale}
            axes[name] = getattr(getattr(rig, group), name).model_copy(update=update)
        groups[group] = getattr(rig, group).model_copy(update=axes)
    return rig.model_copy(update=groups)


def _limited_cycles_of_a_random_run(seed: int, scenario: str, duration_s: float) -> int:
    settings = _random_settings(np.random.default_rng(seed))
    flown, rig = load_scenario(scenario, settings), _barely_enough(scenario, settings)
    assert check_reachability(flown, rig) == []
    job = build.Job(flown, rig, seed, duration_s, 1.0)
    with build.runner(job) as runner:
        outcome = runner.run()
    assert outcome.stop == "completed"
    return outcome.limited_cycles


@pytest.mark.parametrize(("seed", "scenario"), [(0, "scheme-1"), (1, "scheme-2"), (2, "scheme-3")])
def test_axes_that_are_barely_enough_are_never_limited(seed: int, scenario: str) -> None:
    assert _limited_cycles_of_a_random_run(seed, scenario, 80.0) == 0


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["scheme-1", "scheme-2", "scheme-3"])
@pytest.mark.parametrize("seed", range(100, 110))
def test_axes_that_are_barely_enough_are_never_limited_over_whole_runs(seed: int, scenario: str) -> None:
    assert _limited_cycles_of_a_random_run(seed, scenario, 400.0) == 0
