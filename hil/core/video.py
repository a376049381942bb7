"""Images of a video file with the times that the file states, decoded by PyAV.

The grey image is the luma plane itself: the conversion to colours and back blackens images of interlaced files. Levels
of 16 to 235 become 0 to 255, as by that conversion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, Self

import numpy as np

from hil.core.files import check_regular
from hil.core.image_files import VIDEO_BYTES
from hil.errors import BadInput

UPPER_FIRST, LOWER_FIRST = "upper_first", "lower_first"
_ORDERS: Final = {2: UPPER_FIRST, 5: UPPER_FIRST, 3: LOWER_FIRST, 4: LOWER_FIRST}  # AVFieldOrder, as displayed
_FULL_RANGE: Final = 2  # AVColorRange
_MISSING: Final = 1.5  # image periods before the stated end at which a file is truncated
_LONGEST_S: Final = 1e8  # a container that states more has no valid number
_UPRIGHT: Final = np.array([1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30], np.int32).tobytes()  # display matrix
_EXPANDED: Final = np.clip(np.rint((np.arange(256) - 16.0) * 255.0 / 219.0), 0, 255).astype(np.uint8)


class TimedImage(NamedTuple):
    """Image (h, w), uint8, and its time in the file, s. fields: their order if it is interlaced, else ""."""

    t_s: float
    image: np.ndarray
    fields: str = ""


class Video:
    """The video file at ``path``. Raises BadInput if it cannot be read, or is to be rotated.

    rate_hz: images per second as stated, None if not known. resolution_s: of its times. count: number of images, None
    if not known: by the index of an MP4 file, which has what edit lists leave, otherwise by length and rate.
    """

    def __init__(self, path: Path) -> None:
        check_regular(path, VIDEO_BYTES)
        import av  # slow import

        self.path, self._error = path, av.error.FFmpegError
        av.logging.set_level(None)
        try:
            self._container = av.open(str(path), options={"fflags": "+discardcorrupt", "err_detect": "explode"})
            self._stream = self._container.streams.video[0]
        except (self._error, OSError, IndexError, ValueError) as error:
            raise BadInput.single(str(path), "", "not a readable video, or truncated") from error
        stream = self._stream
        self._ends_from_zero = "matroska" in self._container.format.name
        stream.thread_type = "AUTO"
        self.resolution_s = float(stream.time_base or 0)
        rate = stream.average_rate or stream.guessed_rate
        self.rate_hz = float(rate) if rate else None
        lengths = [float(stream.duration * stream.time_base)] if stream.duration and stream.time_base else []
        lengths += [stream.frames / self.rate_hz] if stream.frames and self.rate_hz else []  # as an AVI was begun
        if not lengths and self._container.duration:
            lengths = [self._container.duration * 1e-6]
        self._is_indexed = "mp4" in self._container.format.name and bool(stream.frames)
        self.count = sum(not entry.is_discard for entry in stream.index_entries) if self._is_indexed else None
        # from the first image, of Matroska from the time 0
        self._end_s = max((length for length in lengths if 0.0 < length < _LONGEST_S), default=None)
        if self.count is None and self._end_s is not None and self.rate_hz:
            self.count = max(1, round(self._end_s * self.rate_hz))

    def __iter__(self) -> Iterator[TimedImage]:
        """Yield the images; raise BadInput after the last one if the file states a later end, or has none."""
        number, first_s, last_s = 0, 0.0, -math.inf
        try:
            for image in self._images():
                if not image.t_s > last_s:
                    text = f"image {number} has the time {image.t_s:.6f} s, the one before {last_s:.6f} s"
                    raise BadInput.single(str(self.path), "", text)
                first_s = image.t_s if number == 0 else first_s
                last_s = image.t_s
                yield image
                number += 1
        finally:
            self.close()
        if number == 0:
            raise BadInput.single(str(self.path), "", "not a readable video: contains no complete image")
        end_s, count = self._end_s, self.count if self._is_indexed else None
        period_s = 1.0 / self.rate_hz if self.rate_hz else (last_s - first_s) / max(1, number - 1)
        begin_s = 0.0 if self._ends_from_zero else first_s
        is_early = end_s is not None and last_s - begin_s + period_s < end_s - _MISSING * period_s
        if number < count - 1 if count is not None else is_early:
            expected = "" if self.count is None else f", {self.count} expected"
            raise BadInput.single(str(self.path), "", f"truncated or damaged: {number} complete images{expected}")

    def close(self) -> None:
        """Close the file. Idempotent."""
        self._container.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _images(self) -> Iterator[TimedImage]:
        for frame in self._frames():
            turns = frame.side_data.get("DISPLAYMATRIX")
            if turns is not None and bytes(turns) != _UPRIGHT:
                raise _rotated(self.path, frame.rotation)
            if frame.time is None:
                raise BadInput.single(str(self.path), "", "has images without a time")
            order = _ORDERS.get(int(self._stream.codec_context.field_order or 0), UPPER_FIRST)
            yield TimedImage(float(frame.time), _luma(frame), order if frame.interlaced_frame else "")

    def _frames(self) -> Iterator[Any]:
        """Yield the frames without an error; a damaged file ends where its packets do."""
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets, None)
            except (self._error, OSError):
                return
            if packet is None:
                return
            with suppress(self._error):
                yield from (frame for frame in packet.decode() if not frame.is_corrupt)


def _luma(frame: Any) -> np.ndarray:
    """Return the luma of a frame of PyAV, (h, w), uint8."""
    import cv2

    kind = frame.format
    first = kind.components[0]
    if kind.is_rgb or kind.has_palette or first.plane != 0 or first.bits > 16:
        grey: np.ndarray = frame.reformat(format="gray").to_ndarray()
        return grey
    plane = frame.planes[0]
    size = 1 if first.bits <= 8 else 2
    kind_of_sample = np.dtype("u1" if size == 1 else ">u2" if kind.is_big_endian else "<u2")
    rows: np.ndarray = np.frombuffer(plane, kind_of_sample).reshape(plane.height, plane.line_size // size)[
        :, : frame.width
    ]
    if size == 2:
        depth = 16 if kind.name.startswith("p0") or kind.name.startswith("p2") else first.bits  # p010: upper bits
        rows = (rows >> (depth - 8)).astype(np.uint8)
    is_full = kind.name.startswith(("gray", "yuvj")) or int(frame.color_range or 0) == _FULL_RANGE
    return np.array(rows) if is_full else np.asarray(cv2.LUT(np.ascontiguousarray(rows), _EXPANDED))


def _rotated(path: Path, turn: float) -> BadInput:
    flag = f"{turn:g} deg" if turn else "mirrored"
    text = f"{flag}: signs of a pose depend on it: store the images as the camera has them, without the flag"
    return BadInput.single(str(path), "rotation flag", text)
