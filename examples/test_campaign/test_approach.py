"""Test campaign of eight tests for any rig: pytest examples/test_campaign --rig mock|emulated|FILE."""

import pytest

import hil

NEAR = {
    "initial.position_m": [0.7, -0.03, 0.03],
    "rig.rails.x.park_m": 0.6,
    "duration_s": 70.0,
    "requirements.required_ready_s": 20.0,
    "requirements.required_parts": ["control_precision", "security", "decision"],
}
LOST = [{"device": "vmu", "kind": "no_pose", "at_s": 4.0}]
OFF_AXIS = hil.RunRequirement("RVD-021", "Never more than 60 mm off the axis", "|truth.r_CT_H[1]|", at_most=0.06)
CLOSEST = hil.RunRequirement("RVD-030", "Never nearer than 0.35 m", "truth.r_CT_H[0]", at_least=0.35)

pytestmark = pytest.mark.scenario("scheme-1", overrides=NEAR)


@pytest.mark.requirement("RVD-001")
def test_approach_is_accepted(run):
    """The approach is accepted."""
    assert run.accepted


@pytest.mark.requirement(OFF_AXIS, CLOSEST)
def test_approach_stays_within_its_limits(run):
    """The approach stays within its limits."""
    assert run.stop == "completed"


@pytest.mark.requirement("RVD-020")
def test_approach_takes_little_propellant(run):
    """The approach takes less than 0.1 kg."""
    assert run.summary["thrusters"]["propellant_kg"] < 0.1


@pytest.mark.requirement("RVD-040")
def test_docking_is_a_go(run):
    """Docking is a go."""
    assert run.summary["docking_go_s"] is not None


def test_bench_homes_jogs_and_disarms(bench):
    """The operator's commands move the bench."""
    bench.home()
    before_m = bench.feedback().rail_m[0]
    bench.jog("rails.x", 1, 0.5)
    assert bench.feedback().rail_m[0] > before_m
    bench.arm()
    bench.disarm()


def test_run_is_held_and_resumed(bench):
    """A run is held and resumed."""
    bench.home()
    bench.arm()
    assert bench.start(until=2.0).stop == "on hold"
    assert bench.resume(until=4.0).t_s[-1] >= 4.0


@pytest.mark.scenario("scheme-1", overrides=NEAR | {"duration_s": 20.0}, faults=LOST)
@pytest.mark.requirement("RVD-041")
def test_lost_poses_never_give_a_go(bench):
    """Without poses docking is never a go."""
    bench.home()
    bench.arm()
    assert bench.start(until=15.0).summary["docking_go_s"] is None


def test_start_before_arming_is_rejected(bench):
    """The loop is not closed before the bench is armed."""
    with pytest.raises(hil.errors.BenchError, match="cannot start in standby"):
        bench.start()
