"""Takes the pictures out of a recording again, one after the other: a long one does not fit into memory."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from mcap.records import Message

from hil.core.camera_images import LEFT, RIGHT
from hil.errors import BadInput
from hil.recording import show_images
from hil.recording.read import Scan, directory


@dataclass(frozen=True)
class RecordedImage:
    """A recorded picture; times, number and status as of ``hil.core.camera_images.PICTURE``."""

    camera: str
    t_s: float
    bench_s: float
    number: int
    status: str
    encoding: str
    data: bytes

    def image(self, path: Path) -> np.ndarray:
        """Return the picture (h, w), uint8, grey; path: of its recording. Raises BadInput."""
        try:
            found = cv2.imdecode(np.frombuffer(self.data, np.uint8), cv2.IMREAD_GRAYSCALE) if self.data else None
        except cv2.error:
            found = None
        if found is None:
            raise BadInput.single(str(path), f"{self.camera} {self.number}", "is no picture that can be read")
        return np.asarray(found)


def pictures(path: Path, *cameras: str) -> Iterator[RecordedImage]:
    """Yield the pictures of ``cameras`` in the order of recording. Raises BadInput for a file that is no recording.

    Damaged blocks are left out, and what comes after a cut.
    """
    topics = {f"{show_images.PICTURE_TOPICS}{camera}" for camera in cameras}
    channels = {number: channel for number, channel in directory(path)[1].items() if channel.topic in topics}
    for record in Scan(path).records():
        if isinstance(record, Message) and record.channel_id in channels:
            yield _picture(path, record)


def _picture(path: Path, message: Message) -> RecordedImage:
    try:
        told = json.loads(message.data)
        return RecordedImage(
            told["frame_id"],
            _time(told["t_s"]),
            _time(told["bench_s"]),
            told["number"],
            told["status"],
            told["format"],
            base64.b64decode(told["data"]),
        )
    except (ValueError, LookupError, TypeError) as error:
        raise BadInput.single(str(path), "", f"a picture in it cannot be read: {error}") from error


def _time(value: float | None) -> float:
    return math.nan if value is None else value


def pairs(path: Path) -> Iterator[tuple[RecordedImage, RecordedImage]]:
    """Yield left and right picture of each exposure of the vision unit of which both were recorded."""
    left: RecordedImage | None = None
    for picture in pictures(path, LEFT, RIGHT):
        if picture.camera == LEFT:
            left = picture
        elif left is not None and left.number == picture.number:
            yield left, picture
            left = None


def no_pictures(path: Path, of: str) -> BadInput:
    """Return what is said of a recording without pictures; of: whose."""
    text = (
        f"holds no pictures of {of}: a run has some with {of_source(of)} = rendered "
        "on a rig whose recording.images is jpeg or png"
    )
    return BadInput.single(str(path), "", text)


def of_source(of: str) -> str:
    """Return the key of the scenario that lets pictures be drawn."""
    return "monitor.source" if "monitor" in of else "vmu.source"
