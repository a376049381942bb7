"""Shared memory through which a camera process hands its frames on."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.drivers.cameras.pairing import TimedFrame
from hil.frmn.ring import Ring

SLOTS: Final = 6


def frame_type(size: tuple[int, int]) -> np.dtype:
    """Return the record of a frame of ``size`` (width, height), px."""
    return np.dtype(
        [
            ("exposed_s", "f8"),  # bench time; nan if the frame arrived without its time stamp
            ("arrived_s", "f8"),
            ("number", "i8"),  # frame number of the camera
            ("complete", "i8"),
            ("jumps", "i8"),  # jumps of the camera's clock so far
            ("image", "u1", (size[1], size[0])),
        ]
    )


def frame_ring(size: tuple[int, int], descriptor: int | None = None) -> Ring:
    """Return the ring of frames of ``size``, a new one without ``descriptor``."""
    if descriptor is None:
        return Ring.create(frame_type(size), SLOTS, "frames")
    return Ring(descriptor, frame_type(size), SLOTS, "frames")


def frame_of(record: np.void) -> TimedFrame:
    """Return the frame of a record."""
    # a copy: kernels are compiled for arrays that can be written, the record cannot
    image = record["image"].copy() if record["complete"] else None
    return TimedFrame(float(record["exposed_s"]), float(record["arrived_s"]), int(record["number"]), image)
