"""Sources of stereo pairs: a folder (``left/NNNN.png``, ``right/NNNN.png``), two videos or two cameras."""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from hil.core.files import read_bytes
from hil.core.image_files import IMAGE_BYTES, decode_grey, depth_note
from hil.core.video import Video
from hil.errors import BadInput
from hil.vmu.unit import DARK

log = logging.getLogger("hil")

UNREADABLE, FROZEN = "rejected_image", "rejected_frozen"
FAULTS: Final = {UNREADABLE: "cannot be read", FROZEN: "equal to the one before", DARK: "black"}
"""Status of a pair without a usable image -> what is wrong with an image."""
MOST_FRAMES: Final = 100_000

CAMERAS: Final = "camera:"

_NAME = re.compile(r"(?:.*\D)?(\d+)\.(png|bmp|tif|tiff|pgm|jpg|jpeg)$", re.IGNORECASE)  # 0001.png, img_0001.png
_SIDES: Final = ("left", "right")


@dataclass(frozen=True, slots=True)
class Pair:
    """One frame. left, right: (h, w), uint8; None if the file is missing or invalid.

    faults: sides whose image is none to measure, with the status of FAULTS. t_s: of the exposure, None if not known.
    """

    frame: int
    left: np.ndarray | None
    right: np.ndarray | None
    faults: Mapping[str, str] = field(default_factory=dict)
    t_s: float | None = None


class ImageFolder:
    """The frames of a folder by number. Numbers missing on both sides are dropped frames."""

    def __init__(self, folder: Path, first: int | None = None) -> None:
        if not folder.is_dir():
            raise BadInput.single(str(folder), "", "no such folder: give one with left/NNNN.png and right/NNNN.png")
        self._files = {side: _numbered(folder / side) for side in _SIDES}
        numbers = sorted(set().union(*self._files.values()))
        if not numbers:
            raise BadInput.single(str(folder), "", "contains no images: expected left/NNNN.png and right/NNNN.png")
        if first is not None and first > numbers[-1]:
            raise BadInput.single("--start-frame", "", f"{first}: the last frame of {folder} is {numbers[-1]}")
        self.frames = range(numbers[0] if first is None else max(first, numbers[0]), numbers[-1] + 1)
        if len(self.frames) > MOST_FRAMES:
            text = f"frames {numbers[0]} to {numbers[-1]}: at most {MOST_FRAMES} numbers are allowed"
            raise BadInput.single(str(folder), "", text)

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[Pair]:
        return (self.pair(frame) for frame in self.frames)

    def depth_note(self) -> str:
        """Return how the levels of the first image are read, "" for 8 bits."""
        first = next(path for paths in self._files.values() for path in paths.values())
        return depth_note(read_bytes(first, IMAGE_BYTES))

    def pair(self, frame: int) -> Pair:
        """Return the images of ``frame``."""
        images: dict[str, np.ndarray | None] = {}
        faults = {}
        for side in _SIDES:
            path = self._files[side].get(frame)
            images[side] = None if path is None else read_grey(path)
            if path is not None and images[side] is None:
                faults[side] = UNREADABLE
        return Pair(frame, images["left"], images["right"], faults)


def exposures(pairs: Iterable[Pair]) -> Iterator[Pair]:
    """Yield ``pairs`` without images that are equal to the one before of their camera: these are no new exposures.

    Black ones stay, as faults. A warning at the end names the number of both.
    """
    shown: dict[str, np.ndarray] = {}
    counts = Counter[tuple[str, str]]()
    for pair in pairs:
        images = {side: image for side in _SIDES if (image := getattr(pair, side)) is not None}
        faults = {side: fault for side, image in images.items() if (fault := _fault(image, shown.get(side)))}
        shown |= images
        counts.update(faults.items())
        kept = [None if faults.get(side) == FROZEN else getattr(pair, side) for side in _SIDES]
        yield replace(pair, left=kept[0], right=kept[1], faults={**pair.faults, **faults}) if faults else pair
    for (side, fault), number in sorted(counts.items()):
        log.warning("%s images that are %s: %d", side, FAULTS[fault], number)


def _fault(image: np.ndarray, before: np.ndarray | None) -> str:
    if int(image.max()) - int(image.min()) <= 1:
        return DARK
    is_new = before is None or not (np.array_equal(before[::16], image[::16]) and np.array_equal(before, image))
    return "" if is_new else FROZEN


def read_grey(path: Path) -> np.ndarray | None:
    """Return the image at ``path`` as (h, w), uint8; None if it is truncated, too large or no image."""
    try:
        data = read_bytes(path, IMAGE_BYTES)
    except BadInput:
        return None
    return decode_grey(data) if _is_whole(path.suffix.lower(), data) else None


def _is_whole(suffix: str, data: bytes) -> bool:
    """Return whether a PNG is complete: decoders replace missing data by black."""
    return suffix != ".png" or data.rstrip(b"\0")[-8:-4] == b"IEND"


def _numbered(folder: Path) -> dict[int, Path]:
    paths: dict[int, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        name = _NAME.match(path.name)
        if name and path.is_file():
            number = int(name.group(1))
            if number in paths:
                raise BadInput.single(str(path), "", f"frame {number} is also in {paths[number].name}: keep one")
            paths[number] = path
    return paths


def names_two(source: str) -> bool:
    """Return whether ``source`` names two streams, ``camera:0,1`` or ``left.mkv,right.mkv``, not a folder."""
    return source.startswith(CAMERAS) or ("," in source and not Path(source).is_dir())


class StreamPairs:
    """Stereo pairs of two streams with common exposures, until one of them ends.

    source: ``camera:L,R``, two camera numbers, or the paths of two videos, left first. Frames of both cameras are
    grabbed as close in time as the system allows (use a common trigger); those of videos belong together by the times
    in the files, ``Pair.t_s`` from the first one, and one without its partner is alone. Raises BadInput if a stream
    cannot be opened.
    """

    def __init__(self, source: str) -> None:
        self.live = source.startswith(CAMERAS)
        names = [name.strip() for name in source.removeprefix(CAMERAS).split(",")]
        if len(names) != 2:
            raise BadInput.single("SOURCE", "", f"{source}: give two streams, left and right, separated by a comma")
        self.count: int | None = None
        """Number of pairs, None if not known from the files."""
        self._streams: list[Any] = []
        if self.live:
            self._streams = [_camera(name, source) for name in names]
            return
        for name in names:
            if not Path(name).is_file():
                raise BadInput.single("SOURCE", "", f"{name}: no such file (of {source})")
            self._streams.append(Video(Path(name)))
        counts = [video.count for video in self._streams]
        self.count = None if None in counts else min(counts)

    def __iter__(self) -> Iterator[Pair]:
        return self._grabbed() if self.live else self._by_time()

    def _by_time(self) -> Iterator[Pair]:
        """Yield the images of two videos whose times differ by less than half an image period."""
        left, right = self._streams
        rate_hz = left.rate_hz or right.rate_hz
        if not rate_hz:
            raise BadInput.single(str(left.path), "image rate", "is not stated, nor by the other video")
        streams = iter(left), iter(right)
        heads = [next(stream, None) for stream in streams]
        zero_s = min(head.t_s for head in heads if head is not None)
        alone = [0, 0]
        while (first := heads[0]) is not None and (second := heads[1]) is not None:
            apart = (second.t_s - first.t_s) * rate_hz
            uses = apart > -0.5, apart < 0.5
            for video, head in zip((left, right), (first, second), strict=True):
                if head.fields:
                    text = f"{head.fields}: the lines of an image are of two exposures: record whole images"
                    raise BadInput.single(str(video.path), "interlaced", text)
            t_s = (first.t_s if uses[0] else second.t_s) - zero_s
            images = [head.image if used and head else None for head, used in zip(heads, uses, strict=True)]
            for side, other in ((0, 1), (1, 0)):
                alone[side] += uses[side] and not uses[other]
            yield Pair(round(t_s * rate_hz), images[0], images[1], t_s=t_s)
            heads = [
                next(stream, None) if used else head for head, stream, used in zip(heads, streams, uses, strict=True)
            ]
        for video, number in zip((left, right), alone, strict=True):
            if number:
                log.warning("%s: %d images have no partner at their times in the other video", video.path, number)

    def _grabbed(self) -> Iterator[Pair]:
        """Yield the images of two cameras; both exposures are grabbed before either is decoded."""
        frame = 0
        while self._grab():
            images = [_grey(stream) for stream in self._streams]
            faults = {side: UNREADABLE for side, image in zip(_SIDES, images, strict=True) if image is None}
            yield Pair(frame, images[0], images[1], faults)
            frame += 1

    def _grab(self) -> bool:
        left, right = (stream.grab() for stream in self._streams)
        return bool(left and right)

    def close(self) -> None:
        """Release both streams. Idempotent."""
        for stream in self._streams:
            stream.release() if self.live else stream.close()


def _camera(name: str, source: str) -> cv2.VideoCapture:
    if not name.isdecimal():
        raise BadInput.single("SOURCE", "", f"{source}: give both cameras by number, camera:0,1, or both by address")
    stream = cv2.VideoCapture(int(name))
    if not stream.isOpened():
        raise BadInput.single("SOURCE", "", f"camera {name} cannot be opened")
    return stream


def _grey(stream: cv2.VideoCapture) -> np.ndarray | None:
    whole, image = stream.retrieve()
    if not whole or image is None or image.dtype != np.uint8:
        return None
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
