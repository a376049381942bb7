"""Shared memory through which a process with cameras sends its images: a ring of images, and the time of the run."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.config.rig import Rig
from hil.core.camera_images import IMAGE, ImageEncoder, ImagePolicy
from hil.frmn.mailbox import SharedMailbox
from hil.frmn.ring import Ring


class RunTime(SharedMailbox):
    """Conversion of bench time to time of the run for other processes: a mailbox that the loop writes.

    It holds the bench time at which the run's time is zero; nan before the run and while the run's time is held.
    """

    layout = np.dtype([("zero_s", "f8")])
    label = "run-time"

    def set_zero(self, zero_s: float) -> None:
        """Set the bench time at which the run's time is zero; nan while it is held. One writer."""
        self._row["zero_s"] = zero_s
        self._mailbox.write(self._row, 0.0)

    def at(self, bench_s: float) -> float:
        """Return the time of the run at ``bench_s``, nan while it is held."""
        row = np.full(1, math.nan, self.layout)
        self._mailbox.read(row)
        return bench_s - float(row["zero_s"][0])


class ImageMemory(NamedTuple):
    """Descriptors of a ring of images and of the run's time (``pass_fds``)."""

    ring: int
    slots: int
    run_time: int

    @property
    def descriptors(self) -> tuple[int, int]:
        """Descriptors to pass to the other process."""
        return self.ring, self.run_time

    def encoder(self, rig: Rig) -> ImageEncoder | None:
        """Return, in the other process, the encoder of the images that ``rig`` selects; None for no images."""
        policy = image_policy(rig)
        if policy.encoding == "none":
            return None
        return ImageEncoder(Ring(self.ring, IMAGE, self.slots, "images"), policy, RunTime(self.run_time))


def image_policy(rig: Rig) -> ImagePolicy:
    """Return the images that ``rig`` selects."""
    return ImagePolicy(rig.recording.images, rig.recording.image_interval_s)
