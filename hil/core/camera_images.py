"""A camera's picture as a record: on its way through shared memory to whoever shows or records it, and how it is made.

``Ring.create(PICTURE, SLOTS, "pictures")`` is the way from a process that has pictures to those that want them.
Cameras are "vmu.left" and "vmu.right", the vision unit's pair of one exposure, and "monitor", the docking monitor's.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, Protocol

import numpy as np

from hil.errors import BadInput

Encoding = Literal["jpeg", "png"]
Shape = dict[str, Any]
"""What is drawn over a picture, in its pixels (pixel centres at whole numbers):

``{"kind": "circle", "at": [u, v], "radius": r}``, ``{"kind": "cross", "at": [u, v]}``,
``{"kind": "line", "from": [u, v], "to": [u, v]}`` or ``{"kind": "text", "at": [u, v], "text": "..."}``, each with
``"good": true`` or ``false``, and ``"part"``: what it stands for, for who gives parts colours of their own."""

LEFT, RIGHT, MONITOR = "vmu.left", "vmu.right", "monitor"
CAMERAS: Final = (LEFT, RIGHT, MONITOR)

SLOTS: Final = 16
"""Of the ring: four seconds of a pair twice a second, and a burst of eight pairs."""
PICTURE_BYTES: Final = 2 * 1024 * 1024
OVERLAY_BYTES: Final = 16 * 1024
JPEG_QUALITY: Final = 90
_LOOK_WALL_S: Final = 0.1

PICTURE: Final = np.dtype(
    [
        ("t_s", "f8"),  # exposure, time of the run; nan before the run and while it is held
        ("bench_s", "f8"),  # exposure, bench time as its maker has it; nan where only the run's time is known
        ("number", "i8"),  # of the exposure, counted by its maker from 0; pictures of one exposure share it
        ("left_out", "i8"),  # pictures of this camera up to this one that their maker had to leave out
        ("camera", "S32"),
        ("encoding", "S8"),  # "jpeg" or "png"
        ("status", "S24"),  # what its maker said of it: "ok", "too_few", "near", ...
        ("width_px", "i8"),
        ("height_px", "i8"),
        ("size", "i8"),  # how many bytes of data count; 0 for a picture that has no room
        ("overlay_size", "i8"),  # how many bytes of overlay count
        ("overlay", "u1", OVERLAY_BYTES),  # UTF-8, a JSON list of Shape
        ("data", "u1", PICTURE_BYTES),
    ],
    align=True,
)
"""A picture with what was found in it."""


class Takes(Protocol):
    """Whoever is handed pictures: a ring, or a file."""

    def put(self, row: np.ndarray) -> None:
        """Take a copy of ``row``, shape (1,) of PICTURE; never waits."""


class RunsTime(Protocol):
    """Whoever knows the run's time."""

    def of(self, bench_s: float) -> float:
        """Return the time of the run at ``bench_s``; nan while no run's time goes."""


@dataclass(frozen=True)
class ImagePolicy:
    """Which pictures are taken. encoding: "none" for none. each_s: shortest time between two of a camera, 0: all."""

    encoding: Literal["none", "jpeg", "png"] = "none"
    each_s: float = 0.0


@dataclass(frozen=True)
class CameraImage:
    """A picture before it is encoded. image: (h, w) or (h, w, 3), uint8, grey or BGR. Times as of PICTURE."""

    camera: str
    image: np.ndarray
    bench_s: float = math.nan
    t_s: float = math.nan
    number: int = 0
    status: str = ""
    shapes: Sequence[Shape] = ()


def picture_row(
    camera: str,
    t_s: float,
    data: bytes,
    encoding: Encoding = "jpeg",
    size_px: tuple[int, int] = (0, 0),
    shapes: Sequence[Shape] = (),
    *,
    bench_s: float = math.nan,
    number: int = 0,
    status: str = "",
    left_out: int = 0,
    into: np.ndarray | None = None,
) -> np.ndarray:
    """Return a picture as a row, shape (1,) of PICTURE; size_px: width, height; into: a row to be written over.

    Shapes beyond OVERLAY_BYTES are cut, the last ones first. Raises BadInput for data beyond PICTURE_BYTES.
    """
    if len(data) > PICTURE_BYTES:
        raise BadInput.single(camera, "", f"picture of {len(data)} bytes, at most {PICTURE_BYTES}: compress it more")
    row = np.zeros(1, PICTURE) if into is None else into
    overlay = packed(shapes)
    row["t_s"], row["bench_s"], row["number"], row["left_out"] = t_s, bench_s, number, left_out
    row["camera"], row["encoding"], row["status"] = camera.encode(), encoding.encode(), status.encode()[:24]
    row["width_px"], row["height_px"] = size_px
    row["size"], row["overlay_size"] = len(data), len(overlay)
    row["overlay"][0, : len(overlay)] = np.frombuffer(overlay, np.uint8)
    row["data"][0, : len(data)] = np.frombuffer(data, np.uint8)
    return row


def packed(shapes: Sequence[Shape], room: int = OVERLAY_BYTES) -> bytes:
    """Return as many of ``shapes``, from the first on, as a JSON list of at most ``room`` bytes holds.

    One that has no place, because a number of it is nan, is left out.
    """
    found, left = [], room - 2
    for shape in shapes:
        try:
            text = json.dumps(shape, separators=(",", ":"), allow_nan=False).encode()
        except ValueError:
            continue
        left -= len(text) + 1
        if left < 0:
            break
        found.append(text)
    return b"[" + b",".join(found) + b"]"


def shapes_of(row: np.void) -> tuple[Shape, ...]:
    """Return what is drawn over the picture of ``row``, one of PICTURE."""
    text = row["overlay"][: int(row["overlay_size"])].tobytes()
    return tuple(json.loads(text)) if text else ()


def data_of(row: np.void) -> bytes:
    """Return the encoded picture of ``row``, one of PICTURE."""
    data: bytes = row["data"][: int(row["size"])].tobytes()
    return data


def encode(image: np.ndarray, encoding: Encoding, quality: int = JPEG_QUALITY) -> bytes:
    """Return ``image`` (h, w) or (h, w, 3), uint8, grey or BGR, as a file; quality: of JPEG, 0 to 100.

    Raises ValueError for what is no such image.
    """
    import cv2

    if image.dtype != np.uint8 or image.ndim not in (2, 3) or not image.size:
        raise ValueError(f"{image.dtype} of shape {image.shape} is no picture")
    if encoding == "png":
        # a camera's noise repeats nothing: searching it for repetitions costs twice the time and a third more room
        suffix, options = ".png", [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY]
        if hasattr(cv2, "IMWRITE_PNG_FILTER"):  # OpenCV 4 has none
            options += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
    else:
        suffix, options = ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality]
    written, code = cv2.imencode(suffix, image, options)
    if not written:
        raise ValueError(f"a picture of shape {image.shape} cannot be written as {encoding}")
    return bytes(code.tobytes())


class ImageEncoder:
    """Puts a maker's pictures, encoded, where ``out`` takes them; ``wanted`` says which.

    Not for two threads at once. A picture that has no room is counted, and its row has no data.
    """

    def __init__(self, out: Takes, wanted: ImagePolicy, run: RunsTime | None = None) -> None:
        self._out = out
        self._wanted = wanted
        self._run = run
        self._last_s = -math.inf
        self._left_out: dict[str, int] = {}
        self._row = np.zeros(1, PICTURE)

    def due(self, exposed_s: float) -> bool:
        """Return whether pictures exposed at ``exposed_s``, of whatever clock their maker has, are wanted.

        To be asked once an exposure, whichever cameras it has.
        """
        if self._wanted.encoding == "none":
            return False
        if exposed_s < self._last_s:  # the clock was set back
            self._last_s = -math.inf
        if exposed_s - self._last_s < self._wanted.each_s - 1e-6:
            return False
        self._last_s = exposed_s
        return True

    def put(self, *views: CameraImage) -> None:
        """Encode the ``views`` of an exposure and hand them over; a run's time that they do not have is looked up."""
        for view in self.timed(*views):
            self._put(view)

    def timed(self, *views: CameraImage) -> tuple[CameraImage, ...]:
        """Return ``views`` with the run's time as it is now, where they have none."""
        run = self._run
        if run is None:
            return views
        return tuple(replace(view, t_s=run.of(view.bench_s)) if math.isnan(view.t_s) else view for view in views)

    def _put(self, view: CameraImage) -> None:
        assert self._wanted.encoding != "none"
        data = encode(view.image, self._wanted.encoding)
        if len(data) > PICTURE_BYTES:
            self.leave_out(view)
            data = b""
        height, width = view.image.shape[:2]
        row = picture_row(
            view.camera, view.t_s, data, self._wanted.encoding, (width, height), view.shapes,
            bench_s=view.bench_s, number=view.number, status=view.status,
            left_out=self._left_out.get(view.camera, 0), into=self._row,
        )  # fmt: skip
        self._out.put(row)

    def leave_out(self, *views: CameraImage) -> None:
        """Count ``views`` that do not come."""
        for view in views:
            self._left_out[view.camera] = self._left_out.get(view.camera, 0) + 1


class MakesPictures(Protocol):
    """What a source of pictures asks and tells; ``ImageEncoder`` does it at once, ``ThreadedImageSink`` in a thread."""

    def due(self, exposed_s: float) -> bool:
        """Return whether pictures exposed at ``exposed_s`` are wanted; to be asked once an exposure."""

    def put(self, *views: CameraImage) -> None:
        """Take the pictures of an exposure; their images are not changed any more."""


class ThreadedImageSink:
    """A PictureMaker in a thread of its own, for a source that keeps time: ``put`` never waits.

    The thread gives way to whoever keeps time, at no real-time priority. An exposure that comes while WAITING_MOST
    wait is counted and left out.
    """

    WAITING_MOST: Final = 32  # 64 MB of a pair of 1024 x 1024

    def __init__(self, maker: ImageEncoder) -> None:
        self._maker = maker
        self._waiting: queue.Queue[tuple[CameraImage, ...] | None] = queue.Queue(self.WAITING_MOST)
        self._thread: threading.Thread | None = None

    def due(self, exposed_s: float) -> bool:
        """Return whether pictures exposed at ``exposed_s`` are wanted; to be asked once an exposure."""
        return self._maker.due(exposed_s)

    def put(self, *views: CameraImage) -> None:
        """Take the pictures of an exposure; their images are not changed any more."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="pictures", daemon=True)
            self._thread.start()
        try:
            self._waiting.put_nowait(self._maker.timed(*views))
        except queue.Full:
            self._maker.leave_out(*views)

    def close(self) -> None:
        """Hand over what waits, and end. Idempotent."""
        while self._thread is not None and self._thread.is_alive():
            with contextlib.suppress(queue.Full):
                self._waiting.put(None, timeout=_LOOK_WALL_S)
                self._thread.join()
        self._thread = None

    def _work(self) -> None:
        drop_priority()
        while (views := self._waiting.get()) is not None:
            self._maker.put(*views)


def drop_priority() -> None:
    """Take this thread out of real time, whatever the thread that started it runs at; its niceness stays."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
