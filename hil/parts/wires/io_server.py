"""I/O process: serves the axes and vision unit to the loop through shared memory.

``python -m hil.parts.wires.io_server`` is started by ``IoProcesses``. It monitors the loop's heartbeat: when that
ceases it stops all axes, whatever has happened to the loop.
"""

from __future__ import annotations

import signal
import socket
from contextlib import suppress

import numpy as np

from hil.config.rig import Rig
from hil.core.child_process import Message, serve
from hil.core.clock import BenchClock, clock_of
from hil.core.messages import VMU_FRAME, AxisFeedback
from hil.core.plug_ins import call
from hil.drivers.base import AxisGroup, Jogs, LimitsSetpoints, Parks, PoseSource
from hil.drivers.remote import io_layout
from hil.drivers.remote.io_layout import IoSharedMemory
from hil.drivers.remote.server import LOOP_SILENCE_MAX_S, DeviceServer, raise_priority
from hil.drivers.returned import checked_feedback, checked_frames, checked_setpoint
from hil.drivers.setpoint_limiter import compile_profile
from hil.drivers.split_axes import make_drivers
from hil.errors import BenchError, LinkLost


class IoServer(DeviceServer):
    """Server of rails, turntable and vision unit; stops the axes when the loop's heartbeat ceases."""

    def __init__(
        self,
        axes: dict[str, AxisGroup],
        poses: PoseSource,
        memory: IoSharedMemory,
        requests: socket.socket,
        clock: BenchClock,
    ) -> None:
        super().__init__({**axes, "vmu": poses}, memory, requests, clock, io_layout.IO)
        self._axes = axes
        self._poses = poses
        self._loop_lost = False
        self._frame = np.zeros(1, VMU_FRAME)
        self._setpoint_number = dict.fromkeys(axes, 0)
        self._jogging = dict.fromkeys(axes, False)
        self._feedback_s = dict.fromkeys(axes, -1.0)

    def step(self, now_s: float) -> None:
        """Pass on setpoints, feedback and poses; check the loop's heartbeat."""
        for name in self._axes:
            self._step_axes(name, now_s)
        self._step_poses(now_s)
        self._check_loop(now_s)

    def stop_all(self, now_s: float) -> None:
        """Stop all axes."""
        for name, device in self._axes.items():
            with suppress(BenchError):
                call(name, device.stop, now_s)

    def on_opened(self, name: str) -> None:
        """Skip setpoints from before the opening, and write the first feedback before the request is answered."""
        if name in self._axes:
            self._jogging[name] = False
            box = self.memory.block[f"{name}.setpoint"]
            self._setpoint_number[name] = box.read(np.zeros(1, box.dtype))[0]
            self._write_feedback(name, self._read(name, self.clock.now_s()))

    def _step_axes(self, name: str, now_s: float) -> None:
        device, block = self._axes[name], self.memory.block
        if kind := self.stop_requested(name):
            self.stop_in_thread(name, device.disable if kind == io_layout.DISABLE else device.stop, now_s)
        if name not in self.served:
            return
        try:
            box = block[f"{name}.setpoint"]
            if box.written != self._setpoint_number[name]:
                setpoint = np.zeros(1, box.dtype)
                self._setpoint_number[name], sent_s = box.read(setpoint)
                self._pass_on(name, setpoint[0], sent_s)
            feedback = self._read(name, now_s)
        except BenchError as error:
            self.fail(name, error, now_s)
            return
        if feedback.t_s != self._feedback_s[name]:
            self._write_feedback(name, feedback)

    def _read(self, name: str, now_s: float) -> AxisFeedback:
        device = self._axes[name]
        feedback = call(name, device.read, now_s)
        if getattr(feedback, "t_s", None) == self._feedback_s[name]:
            return feedback
        return checked_feedback(name, device.read, feedback, len(device.axis_names))

    def _pass_on(self, name: str, setpoint: np.void, sent_s: float) -> None:
        device = self._axes[name]
        position, rate, kind = setpoint["position"], setpoint["rate"], int(setpoint["kind"])
        if kind == io_layout.GOAL and isinstance(device, Parks):
            call(name, device.move_to, position, rate, sent_s)
            return
        if (kind == io_layout.JOGGED) != self._jogging[name] and isinstance(device, Jogs):
            self._jogging[name] = kind == io_layout.JOGGED
            call(name, device.set_jogging, kind == io_layout.JOGGED)
        if isinstance(device, LimitsSetpoints):
            call(name, device.set_limits, setpoint["rate_max"], setpoint["acceleration_max"])
        accepted = call(name, device.send, position, rate, sent_s)
        checked_setpoint(name, device.send, accepted, len(device.axis_names))

    def _write_feedback(self, name: str, feedback: AxisFeedback) -> None:
        self._feedback_s[name] = feedback.t_s
        box = self.memory.block[f"{name}.feedback"]
        record = np.zeros(1, box.dtype)
        io_layout.write_feedback(record, feedback)
        box.write(record, feedback.t_s)

    def _step_poses(self, now_s: float) -> None:
        if "vmu" not in self.served:
            return
        try:
            for frame in checked_frames("vmu", self._poses.poll, call("vmu", self._poses.poll, now_s)):
                frame.write_to(self._frame)
                self.memory.frames.put(self._frame)
        except BenchError as error:
            self.fail("vmu", error, now_s)

    def _check_loop(self, now_s: float) -> None:
        """Stop everything once the loop's heartbeat has ceased while it was due."""
        silent_s = self.silence_s(io_layout.LOOP, now_s)
        if silent_s <= LOOP_SILENCE_MAX_S:
            self._loop_lost = False
            return
        if self._loop_lost:
            return
        self._loop_lost = True
        for name, device in self._axes.items():
            self.stop_in_thread(name, device.stop, now_s)
            if name in self.served:
                text = f"stopped: the loop has been silent for {silent_s:.3f} s{self.own_pause()}"
                self.fail(name, LinkLost(name, text), now_s)


def make(configuration: Message) -> IoServer:
    """Return the server of the configured rig; the threads of this process get its priority."""
    compile_profile()  # the first kernel loads the compiler, which would keep the heartbeat waiting later
    clock = clock_of(configuration)
    raise_priority(clock)
    rig = Rig.model_validate(configuration["rig"], strict=False)
    memory = IoSharedMemory.attach(tuple(configuration["descriptors"]), rig.held_numbers)
    memory.note_calls(io_layout.IO)
    made = make_drivers(rig, clock, configuration["period_s"])
    return IoServer(made.axes, made.poses, memory, socket.socket(fileno=configuration["requests"]), clock)


def main() -> None:
    """Serve the devices until the parent ends this process."""
    serve(make, when_orphaned=signal.SIGTERM)


if __name__ == "__main__":
    main()
