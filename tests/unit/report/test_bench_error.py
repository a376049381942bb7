"""Pose error at the camera and latencies, from histories whose errors and delays are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.bench.kinematics import axes_of_pose
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import AXES, CYCLE, new
from hil.maths import quat
from hil.params import bench as bench_params
from hil.report.bench_error import encoders_at_truth
from hil.report.latency import encoder_behind_s, measured, percentiles
from tests.support.verdicts import bench_error

DT = 0.02
N = 400
SPEED = np.array([-0.05, 0.01, 0.002])


def flight(rig: Rig, sampled_early_s: float = 0.0) -> np.ndarray:
    """Return a history of an approach in a straight line whose axes are where they should be at every moment."""
    params = bench_params.bench(rig, DT)
    history = np.zeros(N, CYCLE)
    q = quat.from_rotation_vector(np.radians([3.0, -2.0, 4.0]))
    axes = new(AXES)
    for k, row in enumerate(history):
        t = DT * k
        row["t_s"] = t
        row["truth"]["r_CT_H"] = np.array([5.0, 0.1, -0.1]) + SPEED * t
        row["truth"]["q_CH"] = q
        row["navigation"]["valid"] = 1
        row["navigation"]["r_CT_H"] = row["truth"]["r_CT_H"]
        row["navigation"]["q_CH"] = q
        for moment, name in ((t, "setpoint"), (t - sampled_early_s, "feedback")):
            place = np.array([5.0, 0.1, -0.1]) + SPEED * moment
            axes_of_pose(params, place, SPEED, q, np.zeros(3), axes)
            row[name]["rail_m"], row[name]["rail_mps"] = axes.rail_m, axes.rail_mps
            row[name]["gimbal_rad"] = axes.gimbal_rad
        row["sampled_s"] = t - sampled_early_s
    return history


def test_axes_that_are_where_they_should_be_show_no_error(mock_rig: Rig, scheme_1: Scenario) -> None:
    found = bench_error(flight(mock_rig), scheme_1, mock_rig)
    assert found["pose_error_mm"].max < 1e-9
    assert found["pose_error_deg"].max < 1e-9


def test_encoders_that_are_read_most_of_a_cycle_old_are_not_taken_for_an_error(
    mock_rig: Rig, scheme_1: Scenario
) -> None:
    history = flight(mock_rig, sampled_early_s=0.019)
    found = bench_error(history, scheme_1, mock_rig)
    assert found["pose_error_mm"].max < 1e-9  # 1 mm where the sampling time is overlooked
    assert len(encoders_at_truth(history)[0]) == N - 1  # of the last moment nothing is known yet


def test_two_devices_that_answer_at_different_times_are_brought_together(mock_rig: Rig, scheme_1: Scenario) -> None:
    history, later = flight(mock_rig, 0.019), flight(mock_rig, 0.003)
    history["sampled_s"][:, 1] = later["sampled_s"][:, 1]
    history["feedback"]["gimbal_rad"] = later["feedback"]["gimbal_rad"]
    assert bench_error(history, scheme_1, mock_rig)["pose_error_mm"].max < 1e-9


def test_carriage_that_is_off_shows_its_distance_and_no_angle(mock_rig: Rig, scheme_1: Scenario) -> None:
    history = flight(mock_rig)
    history["feedback"]["rail_m"][:, 1] += 0.001
    history["feedback"]["rail_m"][7, 1] += 0.002
    found = bench_error(history, scheme_1, mock_rig)
    assert found["pose_error_mm"].max == pytest.approx(3.0)
    assert found["pose_error_mm"].rms == pytest.approx(math.sqrt((N - 1 + 9.0) / N))
    assert found["pose_error_deg"].max < 1e-9


def test_gimbal_that_is_off_turns_and_shifts_the_camera(mock_rig: Rig, scheme_1: Scenario) -> None:
    history = flight(mock_rig)
    history["feedback"]["gimbal_rad"][:, 2] += math.radians(0.02)  # yaw, the outermost: about z_L
    found = bench_error(history, scheme_1, mock_rig)
    assert found["pose_error_deg"].rms == pytest.approx(0.02, rel=1e-6)
    arm = np.array(mock_rig.bench.camera_position_m) + np.array(mock_rig.bench.lever_arm_m)
    arm_H = quat.transform_back(np.array(history["truth"]["q_CH"][0]), arm)
    assert found["pose_error_mm"].rms == pytest.approx(1e3 * math.hypot(*arm_H[:2]) * math.radians(0.02), rel=1e-6)


def test_fraction_of_the_navigation_error_counts_the_settled_part(mock_rig: Rig, scheme_1: Scenario) -> None:
    history = flight(mock_rig)
    history["feedback"]["rail_m"][:, 0] += 0.001
    history["navigation"]["r_CT_H"][:, 2] += 0.004
    history["navigation"]["r_CT_H"][: N // 2, 2] += 1.0
    found = bench_error(history, scheme_1, mock_rig, DT * (N // 2))
    assert found["share_of_navigation_error"] == pytest.approx(0.25)
    assert found["share_of_attitude_error"] is None  # the estimated attitude is the true one: the fraction is undefined


@pytest.mark.parametrize("rows", [0, 1])
def test_run_that_ended_at_once_has_numbers_or_none(mock_rig: Rig, scheme_1: Scenario, rows: int) -> None:
    history = flight(mock_rig)[:rows]
    found = bench_error(history, scheme_1, mock_rig, 100.0)
    assert found["pose_error_mm"].max is None if rows == 0 else found["pose_error_mm"].max < 1e-9
    assert percentiles(1e3 * measured(history, history, DT, DT)["setpoint_to_encoder_ms"])["p50"] is None


def test_pose_to_command_counts_the_cycles_that_used_a_pose(mock_rig: Rig) -> None:
    history = flight(mock_rig)
    history["commanded_s"] = history["t_s"] + 0.0003
    history["received_s"] = history["t_s"] - 0.5  # of a pose used long ago
    history["pose"]["fresh"][::8] = 1
    history["received_s"][::8] = history["t_s"][::8] - 0.0047
    history["received_s"][80] -= 0.01
    found = percentiles(1e3 * measured(history, history, DT, DT)["pose_to_command_ms"])
    assert found["p50"] == pytest.approx(5.0)
    assert found["max"] == pytest.approx(15.0)


def test_pose_to_wire_counts_the_changes_that_reached_the_coupler(mock_rig: Rig) -> None:
    history = flight(mock_rig)
    history["commanded_s"] = history["t_s"] + 0.0003
    history["on_wire_s"] = math.nan
    history["received_s"] = history["t_s"] - 0.004
    history["pose"]["fresh"][::8] = 1
    history["command"]["on"][80:, 0] = 1  # with a pose
    history["on_wire_s"][81:] = history["t_s"][80] + 0.002
    history["command"]["on"][101:, 1] = 1  # without one
    history["on_wire_s"][102:] = history["t_s"][101] + 0.003
    found = percentiles(1e3 * measured(history, history, DT, DT)["pose_to_wire_ms"])
    assert found["p50"] == found["max"] == pytest.approx(6.0)


@pytest.mark.parametrize(("delay_s", "sampled_early_s"), [(0.03, 0.0), (-0.01, 0.0), (0.03, 0.019)])
def test_setpoint_to_encoder_is_found_in_the_runs_own_motion(
    mock_rig: Rig, delay_s: float, sampled_early_s: float
) -> None:
    history = flight(mock_rig, sampled_early_s + delay_s)  # encoders show where the setpoint was so long ago
    history["sampled_s"] += delay_s
    found, axes = encoder_behind_s(history, DT)
    assert len(found) >= 20  # three rails, a window each second of 8
    np.testing.assert_allclose(found, delay_s, atol=1e-9)
    lead_s = np.array([0.03, 0.02, 0.01, 0.0, 0.0, 0.0])
    latencies = measured(history, history, DT, 0.5 * DT, lead_s)
    np.testing.assert_allclose(latencies["setpoint_to_encoder_ms"], delay_s + 0.5 * DT, atol=1e-9)
    np.testing.assert_allclose(latencies["encoder_behind_lead_ms"], delay_s - lead_s[axes], atol=1e-9)


def test_uninformative_windows_are_left_out(mock_rig: Rig) -> None:
    history = flight(mock_rig)
    history["setpoint"]["rail_mps"] *= 1e-3
    assert len(encoder_behind_s(history, DT)[0]) == 0
    noisy = flight(mock_rig)
    noisy["feedback"]["rail_m"] += 0.002 * np.random.default_rng(1).standard_normal((N, 3))
    assert len(encoder_behind_s(noisy, DT)[0]) < 4
