"""Emulated controller: sends its state at 250 Hz, follows with a lag, and stops after a silence.

After a stop a person restarts the program of a real controller; this one restarts by itself when answers begin again
after a pause.
"""

from __future__ import annotations

from hil.config.rig import Rig
from hil.config.tables.arm import Arm
from hil.core.clock import BenchClock
from hil.drivers.arm.model import FlangePose
from hil.parts.emulation.shared_state import SharedAxisState
from hil_abb_egm import codec
from hil_abb_egm.codec import Posture, RobotState
from hil_abb_egm.entry import PERIOD_S, EgmSettings
from hil_robot_arms.emulated import EmulatedController, EmulatedRobot

_PAUSE_S = 0.3  # without an answer, after which the next one restarts the guidance


class EgmController(EmulatedController):
    """Controller of a robot."""

    def __init__(
        self, arm: Arm, rig: Rig, clock: BenchClock, shared: SharedAxisState, seed: int = 0, name: str = "arm"
    ) -> None:
        settings: EgmSettings = arm.settings
        period_s = PERIOD_S * settings.emulated_clock_factor
        super().__init__(EmulatedRobot(rig, clock, shared, seed, name), clock, period_s)
        self._settings = settings
        self.robot.lag_s = self._settings.emulated_lag_s
        self._number = self._answered = 0
        self._mci, self._rapid = codec.MCI_STOPPED, codec.RAPID_RUNNING
        self._answered_s = -_PAUSE_S
        self._planned = self._posture()

    def _posture(self) -> Posture:
        pose = self.robot.pose(0.0)
        return Posture(pose.position_m, pose.axes, pose.joints_rad)

    def telegram(self, now_s: float) -> bytes:
        """Return where the robot is."""
        self._number += 1
        motors = codec.MOTORS_OFF if self.robot.torque_off else codec.MOTORS_ON
        tm_ms = round(1e3 * PERIOD_S * self._number)
        state = RobotState(self._number, tm_ms, self._posture(), self._planned, motors, self._mci, self._rapid)
        return codec.encode_state(state)

    def accept(self, data: bytes) -> bool:
        """Apply an answer, unless it is damaged or older than one before."""
        now_s = self._clock.now_s()
        try:
            number, posture = codec.decode_answer(data)
        except ValueError:
            return False
        pause_s, self._answered_s = now_s - self._answered_s, now_s
        if self.faults.value("link_down") is not None or (number <= self._answered and pause_s < _PAUSE_S):
            return False
        self._answered = number
        if self._mci != codec.MCI_RUNNING:
            if pause_s >= _PAUSE_S and not self.robot.torque_off:
                self._mci, self._planned = codec.MCI_RUNNING, self._posture()
            return True
        if self._settings.mode == "joint" and posture.joints_rad is not None:
            self.robot.follow_joints(posture.joints_rad, now_s, PERIOD_S)
        elif self._settings.mode == "pose" and posture.position_m is not None and posture.axes is not None:
            flange = FlangePose(now_s, posture.position_m, posture.axes, None)
            self.robot.follow(flange, now_s, PERIOD_S)
        else:
            return False
        self._planned = posture
        return True

    def supervise(self) -> None:
        """Stop for a safety stop, a failed drive, or a silence."""
        silent = self._clock.now_s() - self._answered_s > self._settings.silence_max_s
        if self.robot.torque_off or self.robot.drive_fault or silent:
            if self._mci == codec.MCI_RUNNING:
                self.robot.brake()
            self._mci = codec.MCI_STOPPED
