"""What holds a planar chaser takes from its thrusters: the acceleration across the plane, by the truth's own motion."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.config.scenario import Scenario
from hil.core.kernel_record import kernel_record
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics.floating import step_on_floor
from hil.dynamics.truth import TRUTH_MEMORY
from hil.params import dynamics as dynamics_params

STEP_S: Final = 1.0
_LEAST_MPS: Final = 1e-6  # about a hundredth of a smallest firing


class HeldBack:
    """Free motion of a planar chaser of ``scenario`` with its thrusters closed, across the plane that holds it.

    largest_mps2: largest acceleration; impulse_mps: integral of its size.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._axis = scenario.chaser.held - 1
        self.largest_mps2 = self.impulse_mps = 0.0
        self._last = -1.0
        self._params = kernel_record(dynamics_params.dss(scenario))
        self._params.dt_s, self._params.held, self._params.n_thrusters = STEP_S, 0, 0
        self._params.target_faults.n = self._params.thruster_faults.n = 0
        self._field = dynamics_params.field(scenario)
        self._closed, self._none = np.zeros(MAX_THRUSTERS, dtype=np.int64), np.zeros(3)

    def add(self, truth: np.record) -> None:
        """Add ``STEP_S`` of motion from ``truth`` (TRUTH) on, which is moved by it."""
        memory = kernel_record(new(TRUTH_MEMORY))
        step_on_floor(self._params, self._field, memory, truth, self._closed, self._none, 0.0)
        speed_mps = abs(float(truth.v_CT_H[self._axis]))  # from 0
        self.largest_mps2 = max(self.largest_mps2, speed_mps / STEP_S)
        self.impulse_mps += speed_mps

    def add_rows(self, rows: np.ndarray) -> None:
        """Add the truth of ``rows`` (n,) of CYCLE, one in each ``STEP_S``."""
        steps = rows["t_s"] // STEP_S
        for k in np.flatnonzero(np.diff(steps, prepend=self._last)):
            self.add(kernel_record(rows["truth"][k].copy()))
        self._last = steps[-1]


def held_back_text(largest_mps2: float, impulse_mps: float) -> str:
    """Return what the plane holds back as text, "" if it is nothing to mention."""
    if impulse_mps < _LEAST_MPS:
        return ""
    return f"the plane holds back up to {largest_mps2:.2g} m/s2, {impulse_mps:.2g} m/s in all, which no thruster gives"
