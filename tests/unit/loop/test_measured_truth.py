"""Truth of a floating vehicle by its poses: fitted rates, prediction, the plane, and a loss of the poses."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import POSE, new
from hil.errors import SafetyTrip
from hil.loop.core_memory import CoreMemory
from hil.loop.floating import MeasuredTruth
from hil.maths import euler, quat
from hil.params import dynamics as dynamics_params
from hil.sensors.vision_unit.pose import write_pose
from hil.session.assembly import core_memory
from tests.support.run_settings import make_job

RATE_HZ = 50.0
V, W = np.array([-0.02, 0.0, 0.01]), np.array([0.0, 0.005, 0.0])


SCENARIO = load_scenario("planar-floating").value
START = dynamics_params.initial_truth(SCENARIO)


def memory() -> CoreMemory:
    return core_memory(make_job(1.0, scenario="planar-floating", rig="mock-floating"), load_rig("mock-floating").value)


def measured(of: CoreMemory) -> MeasuredTruth:
    settings = load_rig("mock-floating").value.floating
    assert settings is not None
    return MeasuredTruth(of, settings, RATE_HZ)


def pose(t_s: float, *, along_y_m: float = 0.0) -> np.recarray:
    """Return (1,) of POSE of a vehicle in steady motion from the start of the scenario."""
    q0 = euler.to_quaternion(np.radians(SCENARIO.initial.attitude_deg), euler.YAW_PITCH_ROLL)
    record = new(POSE)
    r = np.array(SCENARIO.initial.position_m) + t_s * V + np.array([0.0, along_y_m, 0.0])
    write_pose(r, quat.multiply(quat.from_rotation_vector(t_s * W), q0), 1e-3, 1e-3, record)
    record.t_s = t_s
    return np.array([record]).view(np.recarray)


def test_rates_are_those_of_the_poses_and_carry_the_truth_on() -> None:
    core = memory()
    truth = measured(core)
    for k in range(100):
        truth.update(pose(k / RATE_HZ), k / RATE_HZ)
    truth.write(2.5)
    now = core.now.truth
    np.testing.assert_allclose(now.v_CT_H, V, atol=1e-12)
    np.testing.assert_allclose(now.w_CI_C, W, atol=1e-9)
    expected = pose(2.5)[0]
    np.testing.assert_allclose(now.q_CH, expected.q_CH, atol=1e-9)
    np.testing.assert_allclose(-quat.transform(now.q_CH, now.r_CT_H), expected.z_TC_C, atol=1e-9)


def test_sigma_of_the_fitted_rate_is_that_of_many_noisy_runs() -> None:
    core = memory()
    truth, random, speeds = measured(core), np.random.default_rng(1), []
    for _ in range(50):
        truth.begin()
        for k in range(52):  # none of the poses before the first one is in the window
            noisy = pose(k / RATE_HZ)
            noisy.z_TC_C += 1e-3 * random.standard_normal(3)
            truth.update(noisy, k / RATE_HZ)
        speeds.append(core.now.truth.v_CT_H - V)
        core.now.row["truth"] = START
    sigma, numbers = np.std(np.array(speeds)[:, [0, 2]]), truth.numbers()  # of 100 numbers: within 7 %, 1 sigma
    assert sigma == pytest.approx(numbers["sigma_mps"] * 1e-3 / numbers["sigma_m"], rel=0.15)


def test_truth_stays_in_the_plane() -> None:
    core = memory()
    truth = measured(core)
    truth.update(pose(0.0, along_y_m=0.01), 0.0)
    assert core.now.truth.r_CT_H[1] == 0.0


def test_late_and_broken_poses_are_not_the_truth() -> None:
    core = memory()
    truth = measured(core)
    truth.update(pose(0.1), 0.1)
    broken = pose(0.2)
    broken.z_TC_C[0, 1] = np.nan
    truth.update(broken, 0.2)
    truth.update(pose(0.05), 0.2)
    assert truth.numbers()["sigma_m"] > 0.0
    np.testing.assert_allclose(core.now.truth.r_CT_H[0], pose_x(0.1), atol=1e-9)


def pose_x(t_s: float) -> float:
    return float(SCENARIO.initial.position_m[0] + t_s * V[0])


def test_silence_stops_the_bench() -> None:
    truth = measured(memory())
    truth.update(pose(0.1), 0.1)
    truth.update(pose(0.1), 0.6)
    with pytest.raises(SafetyTrip, match=r"vmu: measured pose none for 0.520 s, allowed one within 0.5 s"):
        truth.update(pose(0.1), 0.62)


def test_vehicle_must_be_at_the_start_of_the_plan() -> None:
    truth = measured(memory())
    with pytest.raises(SafetyTrip, match=r"vehicle: start pose 0.300 m from the plan, allowed 0.2 m"):
        truth.update(pose(0.0, along_y_m=0.3), 0.0)
