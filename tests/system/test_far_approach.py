"""The approach from 100 m: phases, sensors, a bench without a jump, and a fault of each kind of sensor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hil

pytestmark = pytest.mark.xdist_group("campaign")


@pytest.fixture(scope="module")
def run() -> hil.Run:
    return hil.run("far-approach", seed=12)


def test_approach_is_accepted_in_all_parts(run: hil.Run) -> None:
    assert run.accepted
    assert run.summary["passed_all_parts"]
    assert run.summary["decision"]["nees_ok"]
    error = np.abs(run.navigation.r_CT_H - run.truth.r_CT_H)
    assert (error <= run.navigation.protection_level_m)[50:].all()


def test_each_sensor_is_used_where_it_measures(run: hil.Run) -> None:
    for name, found in run.summary["sensors"].items():
        assert found["rejected"] + found["excluded"] <= 0.01 * found["accepted"], name
        assert found["mean_nis"] == pytest.approx(1.0, abs=0.1), name
    poses = run.truth.r_CT_H[run.history["pose"]["fresh"] > 0]
    assert np.linalg.norm(poses, axis=1).max() < 8.51


def test_bench_has_no_jump_between_its_scale_and_full_scale(run: hil.Run) -> None:
    rails = run.history["setpoint"]["rail_m"][1:]  # the first row is before the first setpoint
    assert np.abs(np.diff(rails, axis=0)).max() < 0.02 * 0.25  # m in a cycle of 0.02 s
    assert np.abs(np.diff(rails, n=2, axis=0)).max() < 0.02**2 * 0.05
    assert run.summary["bench"]["limited_cycles"] < 50
    assert rails[:, 0].max() < 11.5


@pytest.mark.parametrize(
    "fault",
    [
        {"device": "sensor.gnss", "kind": "offset", "value": [1.0, 0.0, 0.0], "at_s": 300.0},
        {"device": "sensor.lidar", "kind": "drift", "value": 0.002, "at_s": 500.0},
        {"device": "sensor.stars", "kind": "drift", "value": [1e-5, 0.0, 0.0], "at_s": 400.0},
    ],
)
def test_fault_of_one_sensor_does_not_mislead(fault: dict[str, Any]) -> None:
    run = hil.run("far-approach", seed=3, faults=[fault])
    assert run.summary["integrity"]["hmi_cycles"] == 0
    assert not run.summary["decision"]["error"]
    assert np.linalg.norm(run.truth.r_CT_H, axis=1).min() > 0.25
