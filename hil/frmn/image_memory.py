"""The way of pictures out of a process that has them: what is handed to it, and what it makes of that."""

from __future__ import annotations

from typing import NamedTuple

from hil.config.rig import Rig
from hil.core.camera_images import PICTURE, ImageEncoder, ImagePolicy
from hil.frmn.ring import Ring
from hil.frmn.run_time import RunTime


class PictureMemory(NamedTuple):
    """Ring of pictures and cell of the run's time, by their descriptors (``pass_fds``)."""

    ring: int
    slots: int
    run_time: int

    @property
    def descriptors(self) -> tuple[int, int]:
        """What the other process must be given."""
        return self.ring, self.run_time

    def maker(self, rig: Rig) -> ImageEncoder | None:
        """Return, in the other process, what takes pictures as ``rig`` wants them; None where it wants none."""
        wanted = wanted_pictures(rig)
        if wanted.encoding == "none":
            return None
        return ImageEncoder(Ring(self.ring, PICTURE, self.slots, "pictures"), wanted, RunTime(self.run_time))


def wanted_pictures(rig: Rig) -> ImagePolicy:
    """Return which pictures ``rig`` wants."""
    return ImagePolicy(rig.recording.images, rig.recording.image_interval_s)
