"""The I/O process: has the real drivers, and moves what they say and hear through shared memory.

``python -m hil.processes.io_server`` is the child; it gets its configuration from its parent. It watches the
loop: when the loop's heartbeat ceases it stops all axes by itself, whatever became of the loop.
"""

from __future__ import annotations

import signal
import socket
from typing import Any

import numpy as np

from hil.config.rig import Rig
from hil.core.clock import WallClock
from hil.core.messages import VMU_FRAME, AxisFeedback
from hil.drivers.base import AxisGroup, Jogs, Parks, PoseSource
from hil.drivers.emulator_process import serve
from hil.drivers.remote import io_layout
from hil.drivers.remote.host import LOOP_SILENCE_MAX_S, DeviceServer, raise_priority
from hil.drivers.remote.io_layout import IoSharedMemory
from hil.errors import BenchError, LinkLost


def drivers(rig: Rig, clock: WallClock) -> tuple[AxisGroup, AxisGroup, PoseSource, AxisGroup | None]:
    """Return the drivers of a rig with wires: rails, turntable, vision unit, what moves the target."""
    target = rig.moved_target.make_driver(clock, "target") if rig.moved_target else None
    rails, turntable = rig.rails.make_driver(clock, "rails"), rig.turntable.make_driver(clock, "turntable")
    return rails, turntable, rig.vmu.make_driver(clock), target


class DeviceHost(DeviceServer):
    """Rails, turntable and vision unit, served for the loop; the axes are stopped when the loop falls silent."""

    def __init__(
        self,
        axes: dict[str, AxisGroup],
        poses: PoseSource,
        exchange: IoSharedMemory,
        requests: socket.socket,
        clock: WallClock,
    ) -> None:
        super().__init__({**axes, "vmu": poses}, exchange, requests, clock, io_layout.HOST)
        self._axes = axes
        self._poses = poses
        self._lost_loop = False
        self._setpoint = np.zeros(1, io_layout.SETPOINT)
        self._frame = np.zeros(1, VMU_FRAME)
        self._taken = dict.fromkeys(axes, 0)  # setpoints
        self._jogged = dict.fromkeys(axes, False)
        self._shown_s = dict.fromkeys(axes, -1.0)

    def serve(self, now_s: float) -> None:
        """Hand over setpoints, feedback and poses; listen for the loop."""
        for name in self._axes:
            self._serve_axes(name, now_s)
        self._serve_poses(now_s)
        self._watch_the_loop(now_s)

    def close(self) -> None:
        """Stop all axes, then let go of everything."""
        now_s = self.clock.now_s()
        for device in self._axes.values():
            device.stop(now_s)
        super().close()

    def begin(self, name: str) -> None:
        """Leave out setpoints from before the opening, and have feedback there when the opening is answered."""
        if name in self._axes:
            before = np.zeros(1, io_layout.SETPOINT)
            self._jogged[name] = False
            self._taken[name] = self.exchange.block[f"{name}.setpoint"].read(before)[0]
            self._show(name, self._axes[name].read(self.clock.now_s()))

    def _serve_axes(self, name: str, now_s: float) -> None:
        device, block = self._axes[name], self.exchange.block
        if self.stop_is_new(name):
            self.stop_soon(device, now_s)
        if name not in self.served:
            return
        try:
            number, sent_s = block[f"{name}.setpoint"].read(self._setpoint)
            if number != self._taken[name]:
                self._taken[name] = number
                self._pass_on(device, sent_s)
            feedback = device.read(now_s)
        except BenchError as error:
            self.fail(name, error, now_s)
            return
        if feedback.t_s != self._shown_s[name]:
            self._show(name, feedback)

    def _pass_on(self, device: AxisGroup, sent_s: float) -> None:
        position, rate, kind = self._setpoint["position"][0], self._setpoint["rate"][0], int(self._setpoint["kind"][0])
        if kind == io_layout.GOAL and isinstance(device, Parks):
            device.move_to(position, rate, sent_s)
            return
        if (kind == io_layout.JOGGED) != self._jogged[device.name] and isinstance(device, Jogs):
            self._jogged[device.name] = kind == io_layout.JOGGED
            device.set_jogging(kind == io_layout.JOGGED)
        device.send(position, rate, sent_s)

    def _show(self, name: str, feedback: AxisFeedback) -> None:
        self._shown_s[name] = feedback.t_s
        record = np.zeros(1, io_layout.FEEDBACK)
        io_layout.write_feedback(record, feedback)
        self.exchange.block[f"{name}.feedback"].write(record, feedback.t_s)

    def _serve_poses(self, now_s: float) -> None:
        if "vmu" not in self.served:
            return
        try:
            for frame in self._poses.poll(now_s):
                frame.write_to(self._frame)
                self.exchange.frames.put(self._frame)
        except BenchError as error:
            self.fail("vmu", error, now_s)

    def _watch_the_loop(self, now_s: float) -> None:
        """Stop everything when the loop has gone silent in a time in which it was to be heard."""
        silent_s = self.silent_s(io_layout.LOOP, now_s)
        if silent_s <= LOOP_SILENCE_MAX_S:
            self._lost_loop = False
            return
        if self._lost_loop:
            return
        self._lost_loop = True
        for name, device in self._axes.items():
            self.stop_soon(device, now_s)
            if name in self.served:
                self.fail(name, LinkLost(name, f"stopped: the loop has been silent for {silent_s:.3f} s"), now_s)


def make_host(configuration: dict[str, Any]) -> DeviceHost:
    """Return the host for the configuration that the parent sent; threads of this process get its priority."""
    raise_priority()
    rig = Rig.model_validate(configuration["rig"], strict=False)
    clock = WallClock(configuration["epoch_ns"], configuration["speed"])
    rails, turntable, poses, target = drivers(rig, clock)
    axes = {"rails": rails, "turntable": turntable} | ({"target": target} if target is not None else {})
    exchange = IoSharedMemory.attach(tuple(configuration["descriptors"]))
    requests = socket.socket(fileno=configuration["requests"])
    return DeviceHost(axes, poses, exchange, requests, clock)


if __name__ == "__main__":
    serve(make_host, when_orphaned=signal.SIGTERM)
