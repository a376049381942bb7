"""Image sources of the docking monitor: a video file, a folder of images, or a television camera.

All yield the same frames: 8 bit grey, of the size of the scene's camera, each with its own time. Unusable input is
reported before the first frame if possible, otherwise after the last good one.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.config.load import Loaded
from hil.config.scene import Scene
from hil.core.files import read_bytes
from hil.core.image_files import IMAGE_BYTES, IMAGE_SUFFIXES, decode_grey
from hil.core.video import Video
from hil.errors import BadInput

log = logging.getLogger("hil")

Image = NDArray[np.uint8]
NumberedImage = tuple[int, Image, float]  # number in image periods, image, time after that of its number, s

WHOLE: Final = 0
UPPER: Final = 1  # lines 0, 2, 4 ...
LOWER: Final = 2  # lines 1, 3, 5 ...

_NUMBER: Final = re.compile(r"(\d+)$")
_RATE_TOLERANCE: Final = 0.05  # relative, of a file's stated rate, which some containers only estimate
_SAME_RATE: Final = 5e-4  # relative: a file with another rate has its own times
_UNEVEN: Final = 0.25  # image periods by which the time of an image may be off its place


@dataclass(frozen=True)
class VideoFrame:
    """One exposure: a full image, or one of its two fields.

    number counts the frames from 0; t_s, s, from the first one. image: (h, w), or (h/2, w) for a field, whose
    row i is line ``first_line + line_step * i`` of the full image.
    """

    number: int
    t_s: float
    image: Image
    field: int = WHOLE

    @property
    def first_line(self) -> int:
        return 1 if self.field == LOWER else 0

    @property
    def line_step(self) -> int:
        return 1 if self.field == WHOLE else 2


def lines_of(field: int) -> slice:
    """Return the lines of an image that belong to ``field``."""
    return slice(0, None, 1) if field == WHOLE else slice(field - UPPER, None, 2)


def exposure(scene: Scene, number: int) -> tuple[float, int]:
    """Return exposure time, s from the first one, and field of frame ``number`` of an uninterrupted recording."""
    if scene.fields == "whole":
        return number / scene.fps, WHOLE
    slot, half = divmod(number, 2)
    order = (UPPER, LOWER) if scene.fields == "upper_first" else (LOWER, UPPER)
    return (slot + 0.5 * half) / scene.fps, order[half]


class Source:
    """Frames of one recording or camera, for a single iteration. ``image_count``: None if not known.

    scene: with the rate of the images if the file states another one, which is then in ``note``. stamped: whether times
    are those of the file or of their arrival; else they rest on the scene's rate.
    """

    def __init__(
        self, name: str, scene: Scene, images: Iterator[NumberedImage], count: int | None, stamped: bool = True,
        note: str = "",
    ) -> None:  # fmt: skip
        self.name = name
        self.image_count = count
        self.scene, self.stamped, self.note = scene, stamped, note
        self._pictures = images
        self._first: NumberedImage | None = next(images)  # an invalid source raises when it is opened

    def __iter__(self) -> Iterator[VideoFrame]:
        if self._first is None:
            raise ValueError(f"{self.name}: a source can be read only once")
        first, self._first = self._first, None
        for number, frame in enumerate(self._frames(first)):
            yield replace(frame, number=number)

    def _frames(self, first: NumberedImage) -> Iterator[VideoFrame]:
        numbered: NumberedImage | None = first
        while numbered is not None:
            yield from _exposures(*numbered, self.scene)
            numbered = next(self._pictures, None)


def _exposures(slot: int, image: Image, after_s: float, scene: Scene) -> Iterator[VideoFrame]:
    """Yield the exposures of image number ``slot``, ``after_s`` after its time: one, or its two fields."""
    halves = 1 if scene.fields == "whole" else 2
    for number in range(halves * slot, halves * (slot + 1)):
        t_s, field = exposure(scene, number)
        yield VideoFrame(
            number, t_s + after_s, image if field == WHOLE else np.ascontiguousarray(image[lines_of(field)]), field
        )


def exposures_of(image: Image, slot: int, scene: Loaded[Scene]) -> Iterator[VideoFrame]:
    """Yield the exposures of ``image``, grey or BGR, number ``slot`` from 0. Raises BadInput for another size."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        text = f"{image.dtype} of shape {image.shape}: must be (h, w) or (h, w, 3) of uint8"
        raise BadInput.single("image", "", text)
    return _exposures(slot, _checked(image, "image", scene), 0.0, scene.value)


def open_source(name: str, scene: Loaded[Scene], clock: Callable[[], float] = time.monotonic) -> Source:
    """Return the source ``name``: a video file, a folder, or the number of a camera; raise BadInput.

    clock, s: of live cameras only; recorded images have times from the scene's rate.
    """
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    path = Path(name)
    if path.is_dir():
        return _folder(path, scene)
    if path.is_file():
        return _video(path, scene)
    if name.isdecimal():
        return _camera(int(name), scene, clock)
    raise BadInput.single(
        name, "", "no such file or folder: give a video, a folder of images or the number of a camera"
    )


def _checked(image: Any, name: str, scene: Loaded[Scene]) -> Image:
    """Return ``image`` as grey, of the size of the scene's camera; raise BadInput."""
    camera = scene.value.camera
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        text = f"{width} x {height}: must be {camera.width} x {camera.height}, the camera of {scene.source}"
        raise BadInput.single(name, "image size", text)
    grey: Image = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return grey


def _video(path: Path, scene: Loaded[Scene]) -> Source:
    video, expected = Video(path), scene.value.fps
    if video.rate_hz is not None and abs(video.rate_hz - expected) > _RATE_TOLERANCE * expected:
        text = f"{video.rate_hz:g} images per second: must be {expected:g}, fps of {scene.source}"
        raise BadInput.single(str(path), "image rate", text)
    note = ""
    if video.rate_hz is not None and abs(video.rate_hz - expected) > _SAME_RATE * expected:
        note = f"{video.rate_hz:.6g} images per second by the file, which count; fps of {scene.source} is {expected:g}"
        scene = replace(scene, value=scene.value.model_copy(update={"fps": video.rate_hz}))
    return Source(str(path), scene.value, _video_images(video, scene), video.count, note=note)


def _video_images(video: Video, scene: Loaded[Scene]) -> Iterator[NumberedImage]:
    """Yield images with the number of image periods elapsed: one that the file lacks leaves a gap, which is logged."""
    start_s, previous, lost = 0.0, -1, 0
    for number, each in enumerate(video):
        if number == 0:
            start_s = each.t_s
            _check_fields(each.fields, video.path, scene)
        periods = (each.t_s - start_s) * scene.value.fps
        slot = max(previous + 1, round(periods))
        if abs(periods - slot) > _UNEVEN + video.resolution_s * scene.value.fps:
            text = (
                f"image {number} at {each.t_s - start_s:.4f} s: must be evenly spaced, {scene.value.fps:g} per second"
            )
            raise BadInput.single(str(video.path), "image times", text)
        lost += slot - previous - 1
        previous = slot
        after_s = each.t_s - start_s - slot / scene.value.fps
        if abs(after_s) <= video.resolution_s:  # rounded
            after_s = 0.0
        yield slot, _checked(each.image, str(video.path), scene), after_s
    if lost:
        log.warning("%s: %d images are missing between the others: their times are left out", video.path, lost)


def _check_fields(order: str, path: Path, scene: Loaded[Scene]) -> None:
    """Raise BadInput if the file states another order of the half frames than the scene."""
    if order and order != scene.value.fields:
        text = f'"{scene.value.fields}": the video is interlaced, {order}'
        raise BadInput.single(str(path), f"fields of {scene.source}", text)


def _folder(path: Path, scene: Loaded[Scene]) -> Source:
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES and file.is_file())
    if not files:
        raise BadInput.single(str(path), "", f"no images: allowed are {', '.join(sorted(IMAGE_SUFFIXES))}")
    slots = _slots(files)
    ordered = sorted(zip(slots, files, strict=True))
    return Source(str(path), scene.value, _folder_images(ordered, scene), len(files), stamped=False)


def _slots(files: list[Path]) -> list[int]:
    """Return each image's number in image periods, from 0.

    This is the number at the end of its name, so that a lost image leaves a gap; names without numbers, or
    with numbers that are never consecutive, are counted.
    """
    numbers = [int(match[1]) for file in files if (match := _NUMBER.search(file.stem)) is not None]
    ordered = sorted(numbers)
    steps = [after - before for before, after in pairwise(ordered)]
    if len(numbers) < len(files) or (steps and min(steps) != 1):
        return list(range(len(files)))
    return [number - ordered[0] for number in numbers]


def _folder_images(files: list[tuple[int, Path]], scene: Loaded[Scene]) -> Iterator[NumberedImage]:
    for slot, file in files:
        image = decode_grey(read_bytes(file, IMAGE_BYTES))
        if image is None:
            raise BadInput.single(str(file), "", "not a readable image")
        yield slot, _checked(image, str(file), scene), 0.0


def _camera(index: int, scene: Loaded[Scene], clock: Callable[[], float]) -> Source:
    capture = cv2.VideoCapture(index)
    name = f"camera {index}"
    if not capture.isOpened():
        raise BadInput.single(name, "", "no such camera, or it is in use")
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, scene.value.camera.width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, scene.value.camera.height)
    capture.set(cv2.CAP_PROP_FPS, scene.value.fps)
    return Source(name, scene.value, _camera_images(capture, name, scene, clock), None)


def _camera_images(
    capture: cv2.VideoCapture, name: str, scene: Loaded[Scene], clock: Callable[[], float]
) -> Iterator[NumberedImage]:
    """Yield images with the number of image periods elapsed: a lost image leaves a gap.

    Times are integer multiples, so that a recording of these images, by number, has identical times.
    """
    slot, start_s = -1, 0.0
    try:
        while True:
            whole, image = capture.read()
            now_s = clock()
            if not whole:
                raise BadInput.single(name, "", "delivers no more images")
            if slot < 0:
                start_s = now_s
            slot = max(slot + 1, round((now_s - start_s) * scene.value.fps))
            yield slot, _checked(image, name, scene), 0.0
    finally:
        capture.release()
