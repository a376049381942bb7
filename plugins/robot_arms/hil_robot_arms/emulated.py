"""Mechanics of an emulated robot: the axes that it stands for behind one controller, with the lag of this."""

from __future__ import annotations

import threading
from collections import deque
from contextlib import suppress

import numpy as np

from hil.config.rig import Rig
from hil.core.clock import BenchClock
from hil.core.messages import Array
from hil.drivers.arm.model import ArmKinematics, FlangePose, Unreachable
from hil.drivers.datagrams import DatagramSender
from hil.maths.random_streams import stream
from hil.parts.emulation.emulated_axes import EmulatedAxes
from hil.parts.emulation.fault_injection import Faults, FaultyChannel
from hil.parts.emulation.shared_state import SharedAxisState
from hil_robot_arms.settings import arm_model


class EmulatedRobot:
    """Robot ``name`` of ``rig``, whose controller gives it a pose of the flange per cycle, followed after ``lag_s``.

    faults: of the controller's wire and of the n axes. channel: what the controller sends, under these faults.
    """

    def __init__(self, rig: Rig, clock: BenchClock, shared: SharedAxisState, seed: int, name: str) -> None:
        self._kinematics, self._model = ArmKinematics(rig, name), arm_model(rig.robots[name])
        parts = self._kinematics.parts
        self._names = tuple(axis for part in parts.values() for axis in part.axis_names)
        self.faults = Faults(name, ("wire", "drive"), self._names)
        self.channel = FaultyChannel(self.faults, stream(seed, "wire"))
        self.lag_s = 0.0
        self._groups = [EmulatedAxes(*part, clock, shared, self.faults, seed=seed) for part in parts.items()]
        self._coming: deque[tuple[float, Array, Array]] = deque()
        self.given: Array | None = None
        """Axes of the last pose that the controller was given, (n,); None while it brakes."""
        self._joints: Array | None = None

    @property
    def torque_off(self) -> bool:
        """Whether the safety chain has stopped the robot."""
        return any(group.torque_off for group in self._groups)

    @property
    def drive_fault(self) -> bool:
        """Whether the drive of an axis has failed since the last call."""
        return any(self.faults.pop("drive_fault", name) is not None for name in self._names)

    def pose(self, now_s: float) -> FlangePose:
        """Return the flange by the encoders; joints of the last pose that has some."""
        position, axes = self._kinematics.flange(self.axes)
        with suppress(Unreachable):
            self._joints = self._model.joints_of(position, axes, self._joints)
        return FlangePose(now_s, position, axes, self._joints)

    @property
    def axes(self) -> Array:
        """The axes by the encoders, (n,), m and rad."""
        return np.concatenate([group.position for group in self._groups])

    def follow(self, flange: FlangePose, now_s: float, period_s: float) -> None:
        """Take the next pose of the controller, ``period_s`` after the last one."""
        axes = self._kinematics.axes_of(flange, self.axes)
        rate = np.zeros(len(axes)) if self.given is None else (axes - self.given) / period_s
        self.given = axes
        self._coming.append((now_s + self.lag_s, axes, rate))

    def follow_joints(self, joints: Array, now_s: float, period_s: float) -> None:
        """Take the next joints (6,), rad, of the controller."""
        pose = FlangePose(now_s, self._model.points(joints)[3], self._model.flange_axes(joints), joints)
        self.follow(pose, now_s, period_s)

    def brake(self) -> None:
        """Brake all axes at their acceleration limits, then hold."""
        self._coming.clear()
        self.given = None
        for group in self._groups:
            for axis in range(len(group.names)):
                group.brake(axis)

    def advance(self, now_s: float) -> None:
        """Advance the axes to ``now_s``; each setpoint acts when it is due."""
        while self._coming and self._coming[0][0] <= now_s:
            due_s, axes, rate = self._coming.popleft()
            self._advance(due_s)
            setpoints = iter(zip(axes, rate, strict=True))
            for group in self._groups:
                for axis in range(len(group.names)):
                    group.follow(axis, *next(setpoints), due_s)
        self._advance(now_s)
        for group in self._groups:
            group.overdue = [False] * len(group.names)

    def _advance(self, now_s: float) -> None:
        for group in self._groups:
            group.advance(now_s)


class EmulatedController:
    """Controller of a ``robot`` on a UDP port of 127.0.0.1, a telegram per ``period_s``. A make gives its content."""

    def __init__(self, robot: EmulatedRobot, clock: BenchClock, period_s: float) -> None:
        self.robot, self.faults = robot, robot.faults
        self._clock, self._period_s = clock, period_s
        self._wire = DatagramSender(clock)

    def supervise(self) -> None:
        """Stop for what the robot, or silence, asks for."""
        raise NotImplementedError

    def telegram(self, now_s: float) -> bytes:
        """Return the telegram of the cycle that begins."""
        raise NotImplementedError

    def accept(self, data: bytes) -> bool:
        """Apply an answer; return whether it was one to this cycle."""
        raise NotImplementedError

    def end_cycle(self, answered: bool) -> None:
        """Note whether the cycle that ends was ``answered``."""

    def start(self) -> dict[str, str]:
        """Return the address to which the controller sends."""
        return {self.faults.device: self._wire.path}

    def run(self, stop: threading.Event) -> None:
        """Send a telegram per cycle, as the faults of the wire let it pass, until ``stop`` is set."""
        next_s = self._clock.now_s()
        while not stop.is_set():
            self.robot.advance(self._clock.now_s())
            self.supervise()
            now_s = self._clock.now_s()
            self.robot.channel.put(self.telegram(now_s), now_s)
            for packet in self.robot.channel.due(now_s):
                self._wire.write(packet)
            next_s = max(next_s + self._period_s, self._clock.now_s())
            answered = False
            while (now_s := self._clock.now_s()) < next_s:
                if data := self._wire.read(self._clock.wall_s(next_s - now_s)):
                    answered = self.accept(data) or answered
            self.end_cycle(answered)

    def close(self) -> None:
        """Close the wire. Idempotent."""
        self._wire.close()
