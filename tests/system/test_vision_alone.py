"""Scheme 3: dispersed approaches without an IMU, whose thrust is known to a few per cent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil

pytestmark = pytest.mark.xdist_group("campaign")
DIFFERENCES = Path(__file__).parents[2] / "sims/vision-differences.toml"


def test_dispersed_approaches_without_an_imu_pass_all_parts() -> None:
    found = hil.campaign("scheme-3", 12, seed=31, workers=1)
    assert found.column("accepted").all()
    assert np.median(found.column("propellant_kg")) < 0.08


def test_differences_of_poses_reach_the_ready_state_and_fire_more_torque_than_fusion() -> None:
    apart, fused = (hil.run(name, seed=0) for name in (DIFFERENCES, "scheme-2"))
    assert apart.accepted
    torque = [np.sum(run.summary["thrusters"]["torque_on_time_s"]) for run in (apart, fused)]
    late = [np.sum(run.summary["thrusters"]["torque_on_time_360_400_s"]) for run in (apart, fused)]
    assert torque[0] > 2.0 * torque[1]
    assert late[0] > 2.0 * late[1]
    assert not apart.summary["verdict"]["energy"]["passed"]
