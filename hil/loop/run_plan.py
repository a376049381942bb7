"""Plan of a run at the bench."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.loop.controlled_stop import BrakeTimes


@dataclass(frozen=True, slots=True)
class RunPlan:
    """Length of a run and its end points. step_s: period of the ``cycles`` cycles, s, of ``ticks`` setpoints each.

    frames_to_arm: poses required before the loop is closed. park_position: AXES, approached by PARK, and after each
    complete run if ``park_after_run``. brakes: holding brakes of the axes. until_stopped: the operator ends the closed
    loop, which is no fault. warning_s: duration of the warning before the first motion. step_timeout_s: wall time after
    which a step of a plug-in that does not return ends a run that does not keep real time. settle_s: for how long axes
    stand at their targets before a motion has ended.
    """

    step_s: float
    cycles: int
    frames_to_arm: int
    park_position: np.record | None = None
    park_after_run: bool = False
    brakes: BrakeTimes = field(default_factory=BrakeTimes)
    ticks: int = 1
    until_stopped: bool = False
    warning_s: float = 0.0
    step_timeout_s: float = 60.0
    settle_s: float = 0.0

    @property
    def tick_s(self) -> float:
        """Period of the rate keeper, s."""
        return self.step_s / self.ticks
