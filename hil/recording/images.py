"""Reader of the images of a recording, one at a time: a long recording exceeds the memory."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Message

from hil.core.camera_images import LEFT, RIGHT
from hil.core.files import parse_json
from hil.core.image_files import decode_grey
from hil.errors import BadInput
from hil.recording import foxglove_images
from hil.recording.read import directory
from hil.recording.scan import Scan


@dataclass(frozen=True)
class RecordedImage:
    """A recorded image; times, number and status as in ``hil.core.camera_images.IMAGE``."""

    camera: str
    t_s: float
    bench_s: float
    number: int
    status: str
    encoding: str
    data: bytes

    def image(self, path: Path) -> np.ndarray:
        """Return the image (h, w), uint8, grey; path: of its recording. Raises BadInput."""
        pixels = decode_grey(self.data)
        if pixels is None:
            raise BadInput.single(str(path), f"{self.camera} {self.number}", "cannot be decoded as an image")
        return pixels


def recorded_images(path: Path, *cameras: str) -> Iterator[RecordedImage]:
    """Yield the images of ``cameras`` in the order of recording. Raises BadInput for a file that is not a recording.

    Damaged blocks and everything after a truncation are skipped.
    """
    topics = {f"{foxglove_images.PICTURE_TOPICS}{camera}" for camera in cameras}
    channels = {number: channel for number, channel in directory(path)[1].items() if channel.topic in topics}
    for record in Scan(path).records():
        if isinstance(record, Message) and record.channel_id in channels:
            yield _image(path, record)


def _image(path: Path, message: Message) -> RecordedImage:
    try:
        content = parse_json(message.data)
        return RecordedImage(
            content["frame_id"],
            _time(content["t_s"]),
            _time(content["bench_s"]),
            content["number"],
            content["status"],
            content["format"],
            base64.b64decode(content["data"]),
        )
    except (ValueError, LookupError, TypeError) as error:
        raise BadInput.single(str(path), "", f"an image in it cannot be read: {error}") from error


def _time(value: float | None) -> float:
    return math.nan if value is None else value


def pairs(path: Path) -> Iterator[tuple[RecordedImage, RecordedImage]]:
    """Yield left and right image of each exposure of the vision unit of which both were recorded."""
    left: RecordedImage | None = None
    for image in recorded_images(path, LEFT, RIGHT):
        if image.camera == LEFT:
            left = image
        elif left is not None and left.number == image.number:
            yield left, image
            left = None


def no_images(path: Path, of: str) -> BadInput:
    """Return the error for a recording without images; of: their source."""
    text = (
        f"has no images of {of}: a run has some with {source_key(of)} = rendered "
        "on a rig whose recording.images is jpeg or png"
    )
    return BadInput.single(str(path), "", text)


def source_key(of: str) -> str:
    """Return the key of the scenario that selects rendered images."""
    return "monitor.source" if "monitor" in of else "vmu.source"
