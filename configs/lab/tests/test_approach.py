"""Test campaign: pytest --rig mock, --rig emulated, and at the bench --rig rigs/lab.toml."""

from pathlib import Path

import pytest

import hil

LIBRARY = Path(__file__).parents[1] / "gnc" / "observer.so"
OFF_AXIS = hil.RunRequirement("LAB-030", "Never more than 60 mm off the axis", "|truth.r_CT_H[1]|", at_most=0.06)


@pytest.mark.requirement("LAB-020")
def test_approach_is_accepted(run):
    """The approach is accepted."""
    assert run.accepted


@pytest.mark.requirement(OFF_AXIS)
def test_approach_stays_near_the_axis(run):
    """The approach stays near the axis."""


@pytest.mark.scenario("scenarios/approach.toml", faults=[{"device": "vmu", "kind": "no_pose", "at_s": 20.0}])
def test_lost_poses_never_give_a_go(bench):
    """Without poses docking is never a go."""
    bench.home()
    bench.arm()
    assert bench.start(until=60.0).summary["docking_go_s"] is None


@pytest.mark.skipif(not LIBRARY.exists(), reason="make -C gnc builds the library")
@pytest.mark.scenario("scenarios/approach-c.toml", overrides={"duration_s": 20.0})
def test_navigation_in_c_flies(run):
    """The navigation in C flies."""
    assert run.stop == "completed"
