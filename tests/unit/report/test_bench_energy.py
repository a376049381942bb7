"""Energy that the axes add, from histories whose delay is known."""

from __future__ import annotations

import numpy as np
import pytest

from hil.bench.kinematics import axes_of_pose
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import AXES, CYCLE, new
from hil.maths import quat
from hil.params import bench as bench_params
from tests.support.verdicts import bench_error

DT, N = 0.02, 200
MASS, INERTIA = 1000.0, 500.0


def accelerated(rig: Rig, scenario: Scenario, motion: str, late_s: float) -> np.ndarray:
    """Return the history of a chaser that the first thruster accelerates or turns from rest, whose bench shows
    everything ``late_s`` late."""
    thrusters = scenario.chaser.thrusters
    force = thrusters.force_n * np.array(thrusters.direction[0]) * (motion == "translation")
    torque = thrusters.force_n * np.cross(thrusters.position_m[0], thrusters.direction[0]) * (motion == "rotation")
    params, axes = bench_params.bench(rig, DT), new(AXES)
    history = np.zeros(N, CYCLE)

    def pose(t_s: float) -> tuple[np.ndarray, np.ndarray]:
        half_square = 0.5 * t_s * t_s
        return np.array([5.0, 0.0, 0.0]) + half_square * force / MASS, quat.from_rotation_vector(
            half_square * torque / INERTIA
        )

    for k, row in enumerate(history):
        row["t_s"] = row["sampled_s"] = DT * k
        row["truth"]["r_CT_H"], row["truth"]["q_CH"] = pose(DT * k)
        row["truth"]["thrust_fraction"][0] = 1.0
        place, turn = pose(DT * k - late_s)
        axes_of_pose(params, place, np.zeros(3), turn, np.zeros(3), axes)
        row["feedback"]["rail_m"], row["feedback"]["gimbal_rad"] = axes.rail_m, axes.gimbal_rad
    return history


@pytest.mark.parametrize("motion", ["translation", "rotation"])
@pytest.mark.parametrize("late_s", [0.0, 0.04, 0.2, -0.04])
def test_late_axes_add_the_work_of_the_delay(late_s: float, motion: str, mock_rig: Rig, scheme_1: Scenario) -> None:
    """A constant force does the work F s(t) on the truth and F s(t - late) on the bench, where s is parabolic."""
    found = bench_error(accelerated(mock_rig, scheme_1, motion, late_s), scheme_1, mock_rig)["energy"]
    t_s = DT * (N - 1)
    share = (t_s * t_s - (t_s - late_s) ** 2 + late_s * late_s) / (t_s * t_s)
    work = found[f"{motion}_work_j"]
    assert work > 0.1
    assert found[f"{motion}_added_j"] == pytest.approx(share * work, rel=1e-3, abs=1e-9)


def test_run_too_short_for_a_step_has_no_work(mock_rig: Rig, scheme_1: Scenario) -> None:
    assert set(bench_error(np.zeros(1, CYCLE), scheme_1, mock_rig)["energy"].values()) == {0.0}
