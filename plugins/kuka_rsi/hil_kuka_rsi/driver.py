"""Link to a KUKA controller: answers each of its cycles with a correction, and checks what it reports."""

from __future__ import annotations

import numpy as np

from hil.config.tables.arm import Arm
from hil.core.clock import BenchClock
from hil.core.messages import Array
from hil.drivers.arm.model import FlangePose
from hil.errors import DriveFault, FaultKind
from hil_kuka_rsi import codec
from hil_kuka_rsi.codec import RobotState
from hil_kuka_rsi.entry import RsiSettings
from hil_robot_arms.cycles import Cycle, RobotCycles
from hil_robot_arms.link import CycleLink


def _decode(data: bytes) -> Cycle[RobotState]:
    state = codec.decode_state(data)
    return Cycle(state.ipoc, 1e-3 * state.ipoc, state)


class RsiLink(CycleLink[RobotState]):
    """PoseLink of RSI; the port of ``[arm.kuka_rsi]``. Its controller ends the correction after ``late_max`` cycles."""

    not_followed = "its program does not correct (RSI_MOVECORR)"

    def __init__(self, arm: Arm, clock: BenchClock, name: str = "arm") -> None:
        settings: RsiSettings = arm.settings
        self._settings = settings
        cycles = RobotCycles(clock, _decode, settings.period_ms, settings.period_s, arm.timeout_s, name)
        super().__init__(cycles, (settings.host, settings.port), clock, name)
        self._delayed = self._delayed_before = 0

    def follows(self, state: RobotState) -> bool:
        """Return whether the controller corrects; if so its pose without correction is the start."""
        if state.status not in (None, codec.RUNNING):
            return False
        unit = np.zeros(6) if state.corrected is None else state.corrected
        self._start = codec.uncorrected(state.commanded, unit, self._settings.rotation)
        self._delayed_before = state.delayed
        return True

    def hold(self, state: RobotState) -> None:
        """Answer with the correction that holds."""
        still = state.corrected if self._settings.mode == "absolute" else None
        self._send(state.ipoc, np.zeros(6) if still is None else still)

    def lead(self, state: RobotState, target: FlangePose) -> None:
        """Answer with the correction to ``target``, from the start or from the last pose."""
        goal = codec.frame_of(target.position_m, target.axes)
        start = self._start if self._settings.mode == "absolute" else state.commanded
        self._send(state.ipoc, codec.correction_between(start, goal, self._settings.rotation))

    def check(self, state: RobotState) -> None:
        """Raise DriveFault for a robot that has stopped or is not corrected."""
        if state.status == codec.SAFETY_STOP:
            raise DriveFault(self._name, "safety stop of the controller", FaultKind.TORQUE_OFF)
        if state.status not in (None, codec.RUNNING):
            late = state.delayed - self._delayed_before
            raise DriveFault(self._name, f"the controller has ended the correction, {late} late answers")

    def flange(self, state: RobotState) -> FlangePose:
        """Return where the robot is."""
        self._delayed = state.delayed  # of every state, also once the correction has ended
        joints = None if state.joints is None else np.radians(state.joints)
        return FlangePose(self._cycles.t_s, *codec.pose_of(state.actual), joints)

    def counters(self) -> dict[str, int]:
        """Return the counts of both ends: ``late`` are answers that the controller rejected as late."""
        return {**super().counters(), "late": max(0, self._delayed - self._delayed_before)}

    def _send(self, ipoc: int, correction: Array) -> None:
        self._cycles.answer(codec.encode_answer(ipoc, correction, self._settings.sen_type))
