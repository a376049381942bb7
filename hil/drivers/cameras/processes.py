"""The processes of cameras, for the process that measures on their images."""

from __future__ import annotations

import os
import select
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from hil.config.camera_identity import CameraIdentity, identity_doubt, identity_problem
from hil.config.rig import Vmu
from hil.config.tables.cameras import CameraSettings
from hil.core.child_process import ChildProcess, Message
from hil.core.clock import WallClock
from hil.drivers.cameras.base import SIDES
from hil.drivers.cameras.frame_memory import frame_of, frame_ring
from hil.drivers.cameras.pairing import Pairing, TimedFrame
from hil.errors import DeviceError, LinkLost, LinkTimeout, PlugInError, ProtocolError

_READY_WALL_S: Final = 20.0
_KINDS: Final[dict[str, type[DeviceError]]] = {
    kind.__name__: kind for kind in (LinkLost, LinkTimeout, PlugInError, ProtocolError)
}


class CameraProcesses:
    """Starts a process per camera; ``close`` ends them.

    cameras: identifiers by name. rate_hz: of the exposures. timeout_s: longest time without an image. sizes: (width,
    height) of the images of each, px. Raises DeviceError that names the camera.
    """

    def __init__(
        self,
        cameras: Mapping[str, str | None],
        settings: CameraSettings,
        rate_hz: float,
        timeout_s: float,
        sizes: Sequence[tuple[int, int]],
        clock: WallClock,
    ) -> None:
        self._names = tuple(cameras)
        self._clock = clock
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._children: list[ChildProcess] = []
        self._timeout_s = timeout_s
        self._trigger_source = settings.trigger_source if settings.trigger == "hardware" else ""
        self.jumps = [0] * len(cameras)
        """Jumps of the cameras' clocks."""
        self.skipped = 0
        """Frames that were overwritten before they were read."""
        self.identities: dict[str, CameraIdentity | None] = {}
        """Identities of the cameras by their names."""
        self.shutters: dict[str, str] = {}
        """Shutters of the cameras by their names, empty for one that reports none."""
        self._rings = [frame_ring(size) for size in sizes]
        try:
            for (name, identifier), size, ring in zip(cameras.items(), sizes, self._rings, strict=True):
                if identifier is None:
                    raise LinkLost(name, "no camera is set in the rig file")
                configuration = {
                    "name": name,
                    "identifier": identifier,
                    "settings": settings.model_dump(mode="json", include=set(CameraSettings.model_fields)),
                    "rate_hz": rate_hz,
                    "size": size,
                    "epoch_ns": clock.epoch_ns,
                    "speed": clock.speed,
                    "ring": ring.descriptor,
                    "wake": self._wake,
                }
                descriptors = (ring.descriptor, self._wake)
                self._children.append(
                    ChildProcess(f"{name} camera", "hil.parts.cameras.process", configuration, descriptors)
                )
            for camera, child in zip(cameras, self._children, strict=True):
                ready = child.wait_ready(_READY_WALL_S)
                raise_failure(ready)
                self.shutters[camera] = ready["shutter"]
                self.identities[camera] = CameraIdentity.model_validate(ready["identity"], strict=False)
        except BaseException:
            self.close()
            raise
        self._readers = [ring.reader(from_now=True) for ring in self._rings]  # not of one camera without the other
        self._arrived_s = [clock.now_s()] * len(cameras)

    @property
    def pids(self) -> dict[str, int]:
        """Processes of the cameras by their names."""
        return {name: child.pid for name, child in zip(self._names, self._children, strict=True)}

    def frames(self, timeout_s: float) -> Iterator[tuple[int, TimedFrame]]:
        """Yield the new frames, each with the index of its camera; waits up to ``timeout_s`` of wall time for one."""
        if select.select([self._wake], [], [], timeout_s)[0]:
            os.eventfd_read(self._wake)
        for side, reader in enumerate(self._readers):
            for record in reader.read():
                self._note(side, record)
                yield side, frame_of(record)
        self.skipped = sum(reader.lost for reader in self._readers)

    def skip(self) -> None:
        """Skip the frames so far without copying them, which takes tens of milliseconds after a pause of seconds."""
        for side, reader in enumerate(self._readers):
            for record in reader.newest(1):
                self._note(side, record)

    def _note(self, side: int, record: np.void) -> None:
        self.jumps[side] = int(record["jumps"])
        self._arrived_s[side] = max(self._arrived_s[side], float(record["arrived_s"]))

    def check_identities(self, stated: Mapping[str, CameraIdentity | None]) -> str:
        """Return "" if the cameras are those of a geometry or scene file, else that this is not proven.

        stated: by the names of the cameras. Raises DeviceError for a camera that is another one.
        """
        if problem := identity_problem(stated, self.identities):
            name, key, here, there = problem
            text = f"{key} {there}: its geometry or scene file has identity.{key} {here}: calibrate this camera"
            raise DeviceError(name, text)
        return identity_doubt(stated, self.identities)

    def check(self, now_s: float) -> None:
        """Raise DeviceError for a camera whose process has ended, or that has sent nothing for ``timeout_s``."""
        for name, arrived_s, child in zip(self._names, self._arrived_s, self._children, strict=True):
            if ended := child.exit_status():
                try:
                    raise_failure(child.receive(0.0))
                except (LinkTimeout, ProtocolError):
                    pass
                except LinkLost as lost:
                    if lost.device == name:
                        raise
                raise LinkLost(name, f"camera process {ended}")
            age_s = now_s - arrived_s
            if age_s > self._timeout_s:
                hint = f"; trigger at {self._trigger_source}?" if self._trigger_source else ""
                raise LinkTimeout(name, f"no image for {age_s:.3f} s, allowed {self._timeout_s:g} s{hint}")

    def close(self) -> None:
        """End the processes. Idempotent."""
        for child in self._children:
            child.ask_to_end()
        for child in self._children:
            child.close()
        self._children.clear()
        for ring in self._rings:
            ring.close()
        self._rings.clear()
        if self._wake >= 0:
            os.close(self._wake)
            self._wake = -1


def vision_cameras(vmu: Vmu, sizes: Sequence[tuple[int, int]], clock: WallClock) -> CameraProcesses:
    """Return the cameras of ``[vmu.cameras]``, ``vmu.left`` and ``vmu.right``; raises as ``CameraProcesses`` does."""
    cameras = {f"vmu.{side}": getattr(vmu.settings, side) for side in SIDES}
    return CameraProcesses(cameras, vmu.settings, vmu.rate_hz, vmu.timeout_s, sizes, clock)


def vision_pairing(vmu: Vmu) -> Pairing:
    """Return what makes pairs of the frames of ``vision_cameras``."""
    return Pairing(vmu.settings.pair_within_s, vmu.settings.pair_wait_s, vmu.rate_hz)


def raise_failure(message: Message) -> None:
    """Raise the DeviceError that a child's message holds, if it does."""
    if "failure" in message:
        kind, device, what = message["failure"]
        raise _KINDS.get(kind, DeviceError)(device, what)
