"""Vision unit of this host: cameras and solver in processes of their own, poses in shared memory."""

from __future__ import annotations

import contextlib
from typing import Any, Final

import numpy as np

from hil.config.rig import Vmu
from hil.core.child_process import ChildProcess
from hil.core.clock import WallClock
from hil.core.messages import VMU_FRAME, PoseFrame
from hil.drivers.cameras.processes import raise_failure
from hil.drivers.remote import io_layout
from hil.drivers.vmu import COUNTERS, NAME
from hil.errors import LinkLost, LinkTimeout
from hil.frmn.mailbox import MailboxBlock
from hil.frmn.ring import Ring

MAILBOXES: Final = {"failure": io_layout.FAILURE, "counters": io_layout.COUNTERS}
"""What the vision process reports; ``counters`` are also its heartbeat."""
FRAMES: Final = 64
HEARTBEAT_S: Final = 0.05
_READY_WALL_S: Final = 25.0
_BLOCK, _RING = "vision", "vision-poses"


def attach(descriptors: list[int]) -> tuple[MailboxBlock, Ring]:
    """Return the memory behind ``descriptors``, in the vision process."""
    block, ring = descriptors
    return MailboxBlock(block, MAILBOXES, _BLOCK), Ring(ring, VMU_FRAME, FRAMES, _RING)


class CamerasVmu:
    """Pose source that solves the images of ``[vmu.cameras]`` on this host, in the vision process that it starts."""

    def __init__(self, config: Vmu, clock: WallClock) -> None:
        self.name = NAME
        self._config = config
        self._clock = clock
        self._child: ChildProcess | None = None
        self._failure = np.zeros(1, io_layout.FAILURE)
        self._counters = np.zeros(1, io_layout.COUNTERS)
        self.processes: dict[str, ChildProcess] = {}
        """The vision process, while it is open."""
        self.pids: dict[str, int] = {}
        """Processes of the cameras."""

    def open(self, now_s: float) -> None:
        """Start the vision process and the cameras. Raises DeviceError, in the name of a camera that fails."""
        self.close()
        self._block, self._ring = MailboxBlock.create(MAILBOXES, _BLOCK), Ring.create(VMU_FRAME, FRAMES, _RING)
        descriptors = [self._block.descriptor, self._ring.descriptor]
        self._frames = self._ring.reader()
        configuration: dict[str, Any] = {
            "vmu": self._config.model_dump(mode="json"),
            "epoch_ns": self._clock.epoch_ns,
            "speed": self._clock.speed,
            "descriptors": descriptors,
        }
        self._child = ChildProcess("vision process", "hil.parts.vision.process", configuration, descriptors)
        self.processes = {"vision": self._child}
        try:
            ready = self._child.wait_ready(_READY_WALL_S)
            raise_failure(ready)
        except BaseException:
            self.close()
            raise
        self.pids = ready["pids"]
        self._opened_s = self._clock.now_s()

    def poll(self, now_s: float) -> list[PoseFrame]:
        """Return the poses since the last call, oldest first; never waits. Raises DeviceError."""
        if self._child is None:
            raise LinkLost(self.name, "is closed")
        if self._block["failure"].read(self._failure)[0]:
            raise io_layout.failure_of(self._failure)
        if ended := self._child.end_text():
            raise LinkLost(self.name, f"vision process {ended}")
        number, beat_s = self._block["counters"].read(self._counters)
        age_s = now_s - (beat_s if number else self._opened_s)
        if age_s > self._config.timeout_s:
            raise LinkTimeout(
                self.name, f"vision process silent for {age_s:.3f} s, allowed {self._config.timeout_s:g} s"
            )
        return [PoseFrame.from_record(record) for record in self._frames.read()]

    def counters(self) -> dict[str, int]:
        """Return the counters since ``open``: the common ones of vision units, and ``LiveVision``'s."""
        if self._child is not None:
            self._block["counters"].read(self._counters)
        return dict.fromkeys(COUNTERS, 0) | io_layout.counters_of(self._counters)

    def close(self) -> None:
        """End the vision process and its cameras. Idempotent, never raises."""
        self.counters()
        child, self._child, self.processes = self._child, None, {}
        if child is None:
            return
        with contextlib.suppress(Exception):
            child.close(exit_wall_s=1.0)
        self._block.close()
        self._ring.close()
