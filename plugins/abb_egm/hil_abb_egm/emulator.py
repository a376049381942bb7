"""Emulated controller: sends its state at 250 Hz, follows with a lag, and stops after a silence.

After a stop a person restarts the program of a real controller; this one restarts by itself when answers begin again
after a pause.
"""

from __future__ import annotations

import threading

from hil.config.rig import Rig
from hil.config.tables.arm import Arm
from hil.core.clock import BenchClock
from hil.drivers.arm.model import FlangePose
from hil.drivers.datagrams import DatagramSender
from hil.parts.emulation.shared_state import SharedAxisState
from hil_abb_egm import codec
from hil_abb_egm.codec import Posture, RobotState
from hil_abb_egm.entry import PERIOD_S, EgmSettings
from hil_robot_arms.emulated import EmulatedRobot

_PAUSE_S = 0.3  # without an answer, after which the next one restarts the guidance


class EgmController:
    """Controller of a robot, on a UDP port of 127.0.0.1."""

    def __init__(self, arm: Arm, rig: Rig, clock: BenchClock, shared: SharedAxisState, seed: int = 0) -> None:
        self._settings: EgmSettings = arm.settings
        self._clock = clock
        self.robot = self._robot = EmulatedRobot(rig, clock, shared, seed)
        self._robot.lag_s = self._settings.emulated_lag_s
        self.faults = self._robot.faults
        self._wire = DatagramSender(clock)
        self._number = self._answered = 0
        self._mci, self._rapid = codec.MCI_STOPPED, codec.RAPID_RUNNING
        self._answered_s = -_PAUSE_S
        self._planned = self._posture()

    def start(self) -> dict[str, str]:
        """Return the address to which the controller sends."""
        return {"arm": self._wire.path}

    def run(self, stop: threading.Event) -> None:
        """Send a message per cycle until ``stop`` is set."""
        next_s = self._clock.now_s()
        while not stop.is_set():
            self._robot.advance(self._clock.now_s())
            self._supervise()
            self._send()
            next_s = max(next_s + PERIOD_S, self._clock.now_s())
            while (now_s := self._clock.now_s()) < next_s:
                if data := self._wire.read(self._clock.wall_s(next_s - now_s)):
                    self._accept(data)

    def close(self) -> None:
        """Close the wire. Idempotent."""
        self._wire.close()

    def _posture(self) -> Posture:
        pose = self._robot.pose(0.0)
        return Posture(pose.position_m, pose.axes, pose.joints_rad)

    def _send(self) -> None:
        """Send where the robot is, as the faults of the wire let it pass."""
        now_s = self._clock.now_s()
        self._number += 1
        motors = codec.MOTORS_OFF if self._robot.torque_off else codec.MOTORS_ON
        tm_ms = round(1e3 * PERIOD_S * self._number)
        state = RobotState(self._number, tm_ms, self._posture(), self._planned, motors, self._mci, self._rapid)
        self._robot.channel.put(codec.encode_state(state), now_s)
        for packet in self._robot.channel.due(now_s):
            self._wire.write(packet)

    def _accept(self, data: bytes) -> None:
        """Apply an answer, unless it is damaged or older than one before."""
        now_s = self._clock.now_s()
        try:
            number, posture = codec.decode_answer(data)
        except ValueError:
            return
        pause_s, self._answered_s = now_s - self._answered_s, now_s
        if self.faults.value("link_down") is not None or (number <= self._answered and pause_s < _PAUSE_S):
            return
        self._answered = number
        if self._mci != codec.MCI_RUNNING:
            if pause_s >= _PAUSE_S and not self._robot.torque_off:
                self._mci, self._planned = codec.MCI_RUNNING, self._posture()
            return
        if self._settings.mode == "joint" and posture.joints_rad is not None:
            self._robot.follow_joints(posture.joints_rad, now_s, PERIOD_S)
        elif self._settings.mode == "pose" and posture.position_m is not None and posture.axes is not None:
            flange = FlangePose(now_s, posture.position_m, posture.axes, None)
            self._robot.follow(flange, now_s, PERIOD_S)
        else:
            return
        self._planned = posture

    def _supervise(self) -> None:
        silent = self._clock.now_s() - self._answered_s > self._settings.silence_max_s
        if self._robot.torque_off or self._robot.drive_fault or silent:
            if self._mci == codec.MCI_RUNNING:
                self._robot.brake()
            self._mci = codec.MCI_STOPPED
