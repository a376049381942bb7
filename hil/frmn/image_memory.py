"""Shared memory through which a process with cameras sends its images: a ring of images, and the time of the run."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from hil.config.rig import Rig
from hil.core.camera_images import IMAGE, ImageEncoder, ImagePolicy
from hil.frmn.mailbox import MailboxBlock
from hil.frmn.ring import Ring

_ZERO: Final = np.dtype([("zero_s", "f8")])
_MAILBOXES: Final = {"run": _ZERO}


class RunTime:
    """Conversion of bench time to time of the run for other processes: a mailbox that the loop writes.

    It holds the bench time at which the run's time is zero; nan before the run and while the run's time is held.
    """

    def __init__(self, descriptor: int) -> None:
        """Attach to the memory behind ``descriptor``, of which this object takes ownership."""
        self._attach(MailboxBlock(descriptor, _MAILBOXES, "run-time"))

    @classmethod
    def create(cls) -> RunTime:
        """Create the memory; pass ``descriptor`` to other processes (``pass_fds``)."""
        made = cls.__new__(cls)
        made._attach(MailboxBlock.create(_MAILBOXES, "run-time"))
        return made

    def _attach(self, block: MailboxBlock) -> None:
        self._block = block
        self._row = np.full(1, math.nan, _ZERO)

    @property
    def descriptor(self) -> int:
        return self._block.descriptor

    def set_zero(self, zero_s: float) -> None:
        """Set the bench time at which the run's time is zero; nan while it is held. One writer."""
        self._row["zero_s"] = zero_s
        self._block["run"].write(self._row, 0.0)

    def at(self, bench_s: float) -> float:
        """Return the time of the run at ``bench_s``, nan while it is held."""
        row = np.full(1, math.nan, _ZERO)
        self._block["run"].read(row)
        return bench_s - float(row["zero_s"][0])

    def close(self) -> None:
        """Release the memory; idempotent."""
        self._block.close()


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
