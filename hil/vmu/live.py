"""Stereo pairs of two video files or of two cameras."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from hil.errors import BadInput
from hil.vmu.folder import Pair

CAMERAS: Final = "camera:"
_SIDES: Final = ("left", "right")


def names_two(source: str) -> bool:
    """Return whether ``source`` names two streams, ``camera:0,1`` or ``left.mkv,right.mkv``, and no folder."""
    return source.startswith(CAMERAS) or ("," in source and not Path(source).is_dir())


class StreamPairs:
    """The pairs of two streams that were exposed together, frame by frame, until one of them ends.

    source: ``camera:L,R``, two numbers of cameras, or the paths of two videos, left first. A camera's frames are
    taken from both as close to each other as the system lets it (the cameras are to be triggered together).
    Raises BadInput where a stream cannot be opened.
    """

    def __init__(self, source: str) -> None:
        self.live = source.startswith(CAMERAS)
        names = source.removeprefix(CAMERAS).split(",")
        if len(names) != 2:
            raise BadInput.single("SOURCE", "", f"{source}: name two streams, left and right, with a comma between")
        self._streams = [self._open(name.strip(), source) for name in names]
        counts = [int(stream.get(cv2.CAP_PROP_FRAME_COUNT)) for stream in self._streams]
        self.count = None if self.live or min(counts) <= 0 else min(counts)
        """How many pairs there are, as far as the files tell."""

    def __iter__(self) -> Iterator[Pair]:
        frame = 0
        while self._grab():
            images = [_grey(stream) for stream in self._streams]
            unreadable = tuple(side for side, image in zip(_SIDES, images, strict=True) if image is None)
            yield Pair(frame, images[0], images[1], unreadable)
            frame += 1

    def _grab(self) -> bool:
        """Take both exposures before either is decoded; return whether both were there."""
        left, right = (stream.grab() for stream in self._streams)
        return bool(left and right)

    def close(self) -> None:
        """Let go of both streams. Idempotent."""
        for stream in self._streams:
            stream.release()

    def _open(self, name: str, source: str) -> cv2.VideoCapture:
        if not self.live:
            if not Path(name).is_file():
                raise BadInput.single("SOURCE", "", f"{name}: no such file (of {source})")
            stream = cv2.VideoCapture(name)
        elif name.isdecimal():
            stream = cv2.VideoCapture(int(name))
        else:
            raise BadInput.single("SOURCE", "", f"{source}: cameras are given by their numbers, camera:0,1")
        if not stream.isOpened():
            what = f"camera {name} cannot be opened" if self.live else f"{name}: is no video that can be read"
            raise BadInput.single("SOURCE", "", what)
        return stream


def _grey(stream: cv2.VideoCapture) -> np.ndarray | None:
    whole, image = stream.retrieve()
    if not whole or image is None or image.dtype != np.uint8:
        return None
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
