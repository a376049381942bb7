"""Time offset between vision unit and IMU, from a run's poses and truth."""

from __future__ import annotations

import numpy as np
import pytest

from hil.core.messages import CYCLE
from hil.maths import quat
from hil.report.latency import pose_behind_imu_s

STEP_S, SPEED_MPS = 0.02, 0.07


def rows_with_poses(delay_s: float, speed_mps: float = SPEED_MPS, sigma_m: float = 0.0) -> np.ndarray:
    """Return 60 s of an approach along x with a pose, ``delay_s`` late, every 8 cycles."""
    rows, rng = np.zeros(3000, CYCLE), np.random.default_rng(0)
    rows["t_s"] = STEP_S * np.arange(len(rows))
    rows["truth"]["r_CT_H"][:, 0] = 5.0 - speed_mps * rows["t_s"]
    rows["truth"]["v_CT_H"][:, 0] = -speed_mps
    q = np.array([0.1, -0.2, 0.3, np.sqrt(1.0 - 0.14)])
    rows["truth"]["q_CH"] = q
    for k in range(8, len(rows), 8):
        exposed_s = rows["t_s"][k] - 0.05
        shown = np.array([5.0 - speed_mps * (exposed_s - delay_s), 0.0, 0.0]) + sigma_m * rng.standard_normal(3)
        pose = rows["pose"][k]
        pose["fresh"], pose["t_s"], pose["z_TC_C"] = 1, exposed_s, -quat.transform(q, shown)
    return rows


@pytest.mark.parametrize("delay_s", [0.03, -0.01, 0.0])
def test_it_is_the_delay_of_the_poses(delay_s: float) -> None:
    assert pose_behind_imu_s(rows_with_poses(delay_s)) == pytest.approx([delay_s] * 3, abs=1e-9)


def test_its_noise_is_that_of_the_poses_over_the_speed() -> None:
    found = pose_behind_imu_s(rows_with_poses(0.03, sigma_m=1e-3))
    assert np.abs(found - 0.03).max() < 4.0 * 1e-3 / SPEED_MPS / np.sqrt(125.0)


def test_a_chaser_at_rest_shows_none() -> None:
    assert not len(pose_behind_imu_s(rows_with_poses(0.03, speed_mps=1e-4, sigma_m=1e-3)))
    assert not len(pose_behind_imu_s(np.zeros(0, CYCLE)))
