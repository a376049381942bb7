"""Floating vehicle of a session: its stages of the loop, and its simulation in place of the real one."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hil.bench.kinematics import axes_of_pose
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.kernel_record import kernel_record
from hil.core.messages import AXES, MAX_THRUSTERS, new
from hil.dynamics.floating import step_on_floor
from hil.dynamics.thrusters import STANDARD_GRAVITY_MPS2
from hil.dynamics.truth import TRUTH_MEMORY, rate_against_hill
from hil.maths import elementary
from hil.params import bench as bench_params
from hil.params import dynamics as dynamics_params


class SimulatedVehicle:
    """Vehicle on the level floor of a floating ``rig``: mock and emulator move it by the thruster lines.

    It stands at the start of ``scenario``, the truth, until the first valve opens, at which its time of faults begins
    as well. Equal calls give equal numbers.
    """

    def __init__(self, scenario: Scenario, rig: Rig, seed: int) -> None:
        assert rig.floating is not None
        self._dss, self._field = (
            kernel_record(dynamics_params.dss_as_built(scenario, seed)),
            dynamics_params.field(scenario),
        )
        self._step_s = float(self._dss.dt_s)
        self._bench = kernel_record(bench_params.bench(rig, scenario.step_s, scenario.bench))
        self._truth, self._memory = (
            kernel_record(dynamics_params.initial_truth(scenario)),
            kernel_record(new(TRUTH_MEMORY)),
        )
        slope_x, slope_z = (STANDARD_GRAVITY_MPS2 * elementary.sin(math.radians(deg)) for deg in rig.floating.tilt_deg)
        self._pull, self._friction_mps2 = np.array([slope_x, 0.0, slope_z]), rig.floating.friction_mps2
        self._axes, self._rate = kernel_record(new(AXES)), np.zeros(3)
        self._on, self._lines = np.zeros(MAX_THRUSTERS, np.int64), b""
        self._changes: deque[tuple[float, bytes]] = deque()
        self._t_s = 0.0
        self._floats = False

    def fire(self, lines: bytes, now_s: float) -> None:
        """Set the thruster ``lines`` that have power, one byte each, 0 or 1, from bench time ``now_s`` on."""
        if lines.rstrip(b"\0") != self._lines:
            self._lines = lines.rstrip(b"\0")
            self._changes.append((now_s, self._lines))

    def axes_at(self, t_s: float) -> np.record:
        """Return AXES of a bench that shows the pose of the vehicle at bench time ``t_s``, valid until the next call.

        Times do not go back: for an earlier one the pose is the newest.
        """
        while self._changes and self._changes[0][0] <= t_s:
            changed_s, lines = self._changes.popleft()
            self._move_to(changed_s)
            self._floats = self._floats or bool(lines)
            self._on[:] = 0
            self._on[: len(lines)] = list(lines[:MAX_THRUSTERS])
        self._move_to(t_s)
        truth = self._truth
        rate_against_hill(truth, self._rate)
        axes_of_pose(self._bench, truth.r_CT_H, truth.v_CT_H, truth.q_CH, self._rate, self._axes)
        if not self._floats:
            self._axes.rail_mps = self._axes.gimbal_radps = 0.0
        return self._axes

    def _move_to(self, t_s: float) -> None:
        remaining_s = t_s - self._t_s
        self._t_s = max(self._t_s, t_s)
        while self._floats and remaining_s > 0.0:
            self._dss.dt_s = dt_s = min(remaining_s, self._step_s)
            step_on_floor(
                self._dss, self._field, self._memory, self._truth, self._on, self._pull, self._friction_mps2
            )  # fmt: skip
            remaining_s -= dt_s
