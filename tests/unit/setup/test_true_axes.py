"""Camera's error by the true positions of emulated axes: what the encoders do not show is measured."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.bench import kinematics
from hil.config.load import load_rig
from hil.core.messages import AXES, CYCLE, new
from hil.params import bench as bench_params
from hil.parts.emulation.session import TrueAxesWatch
from hil.parts.emulation.shared_state import SharedAxisState

STEP_S = 0.02
NOW_S = 7.3


def test_an_offset_of_the_load_is_the_error_at_the_camera() -> None:
    rig = load_rig("emulated-machine").value
    row = np.zeros(1, CYCLE)
    row["truth"]["r_CT_H"], row["truth"]["q_CH"] = (2.0, 0.1, -0.2), (0.0, 0.0, 0.0, 1.0)
    row["t_s"], row["commanded_s"] = 1.0, 1.003
    axes, rest = new(AXES), np.zeros(3)
    kinematics.axes_of_pose(
        bench_params.bench(rig, STEP_S), row["truth"]["r_CT_H"][0], rest, row["truth"]["q_CH"][0], rest, axes
    )
    board = SharedAxisState.create()
    try:
        watch = TrueAxesWatch(board, rig, lambda: NOW_S, STEP_S)
        written_s = NOW_S - 0.003  # the truth's time on the clock of the bench: nothing to extrapolate
        for offset_m in (3e-5, 4e-5):
            board.write("rails", written_s, axes.rail_m + np.array([0.0, offset_m, 0.0]), rest)
            board.write("turntable", written_s, axes.gimbal_rad, rest)
            watch.put(row)
        moving = np.array([0.04, 0.0, 0.0])
        board.write("rails", written_s - 0.004, axes.rail_m - 0.004 * moving, moving)  # 4 ms old, and extrapolated
        watch.put(row)
    finally:
        board.close()
    found = watch.numbers()["true_pose_error_mm"]
    assert found["max"] == pytest.approx(0.04, rel=1e-6)
    assert found["rms"] == pytest.approx(math.sqrt((0.03**2 + 0.04**2) / 3.0), rel=1e-6)
    assert watch.numbers()["true_pose_error_deg"]["max"] < 1e-9
