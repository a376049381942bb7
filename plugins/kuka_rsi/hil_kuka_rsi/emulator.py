"""Emulated controller: owns IPOC, rejects answers to other cycles, counts late ones and stops after too many in a row.

After a stop a person restarts the program of a real controller; this one restarts by itself when valid answers begin
again after a pause.
"""

from __future__ import annotations

import numpy as np

from hil.config.rig import Rig
from hil.config.tables.arm import Arm
from hil.core.clock import BenchClock
from hil.core.messages import Array
from hil.drivers.arm.model import FlangePose
from hil.parts.emulation.shared_state import SharedAxisState
from hil_kuka_rsi import codec
from hil_kuka_rsi.codec import RobotState
from hil_kuka_rsi.entry import RsiSettings
from hil_robot_arms.emulated import EmulatedController, EmulatedRobot

_PAUSE_S = 0.3  # without a valid answer, after which the next one restarts the correction
_FIRST_IPOC = 123_456


class RsiController(EmulatedController):
    """Controller of a robot."""

    def __init__(
        self, arm: Arm, rig: Rig, clock: BenchClock, shared: SharedAxisState, seed: int = 0, name: str = "arm"
    ) -> None:
        settings: RsiSettings = arm.settings
        period_s = settings.period_s * settings.emulated_clock_factor
        super().__init__(EmulatedRobot(rig, clock, shared, seed, name), clock, period_s)
        self._settings = settings
        self.robot.lag_s = settings.emulated_lag_s
        self._ipoc, self._delayed, self._late_in_row = _FIRST_IPOC, 0, 0
        self._status = codec.STOPPED
        self._answered_s = -_PAUSE_S
        self._start = self._commanded = self._frame()
        self._corrected = np.zeros(6)

    def _frame(self) -> Array:
        pose = self.robot.pose(0.0)
        return codec.frame_of(pose.position_m, pose.axes)

    def telegram(self, now_s: float) -> bytes:
        """Return where the robot is."""
        pose = self.robot.pose(now_s)
        joints = None if pose.joints_rad is None else np.degrees(pose.joints_rad)
        actual = codec.frame_of(pose.position_m, pose.axes)
        self._ipoc += self._settings.period_ms
        return codec.encode_state(
            RobotState(self._ipoc, actual, self._commanded, joints, self._corrected, self._delayed, self._status)
        )

    def end_cycle(self, answered: bool) -> None:
        """Count a cycle without an answer as late; too many in a row end the correction."""
        if answered:
            self._late_in_row, self._answered_s = 0, self._clock.now_s()
        elif self._status == codec.RUNNING:
            self._delayed, self._late_in_row = self._delayed + 1, self._late_in_row + 1
            if self._late_in_row > self._settings.late_max:
                self._end(codec.STOPPED)

    def accept(self, data: bytes) -> bool:
        """Apply an answer; return False for one that is damaged, of another cycle or type."""
        try:
            ipoc, correction = codec.decode_answer(data, self._settings.sen_type)
        except ValueError:
            return False
        if ipoc != self._ipoc or self.faults.value("link_down") is not None:
            return False
        now_s = self._clock.now_s()
        if self._status != codec.RUNNING:
            if now_s - self._answered_s >= _PAUSE_S and not self.robot.torque_off:
                self._status, self._late_in_row = codec.RUNNING, 0
                self._start = self._commanded = self._frame()
                self._corrected = np.zeros(6)
            return True
        rotation = self._settings.rotation
        if self._settings.mode == "absolute":
            self._commanded = codec.corrected(self._start, correction, rotation)
        else:
            self._commanded = codec.corrected(self._commanded, correction, rotation)
        self._corrected = codec.correction_between(self._start, self._commanded, rotation)
        self.robot.follow(FlangePose(now_s, *codec.pose_of(self._commanded), None), now_s, self._settings.period_s)
        return True

    def supervise(self) -> None:
        """Stop for a safety stop or a failed drive."""
        if self.robot.torque_off:
            self._end(codec.SAFETY_STOP)
        elif self.robot.drive_fault:
            self._end(codec.STOPPED)
        elif self._status == codec.SAFETY_STOP:
            self._status = codec.STOPPED

    def _end(self, status: int) -> None:
        if self._status == codec.RUNNING:
            self.robot.brake()
        self._status = status
