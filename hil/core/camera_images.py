"""Camera images: their record in shared memory, their encoding, and the sinks that a source of images writes to.

A process with cameras writes rows of IMAGE into a ring; console and recorder read it. Cameras are "vmu.left" and
"vmu.right", the vision unit's stereo pair of one exposure, and "monitor", the docking monitor's camera.
"""

from __future__ import annotations

import contextlib
import json
import math
import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, Protocol

import numpy as np

from hil.core.realtime import drop_priority
from hil.errors import BadInput

Encoding = Literal["jpeg", "png"]
Shape = dict[str, Any]
"""Overlay shape in pixels of the image (pixel centres at integers):

``{"kind": "circle", "at": [u, v], "radius": r}``, ``{"kind": "cross", "at": [u, v]}``,
``{"kind": "line", "from": [u, v], "to": [u, v]}`` or ``{"kind": "text", "at": [u, v], "text": "..."}``, each with
``"good": true`` or ``false``, and ``"part"``: the feature it marks, for viewers with a colour per feature."""

LEFT, RIGHT, MONITOR = "vmu.left", "vmu.right", "monitor"
CAMERAS: Final = (LEFT, RIGHT, MONITOR)
GEOMETRY_FILE, SCENE_FILE = "vmu_geometry.json", "monitor_scene.json"
"""Attachments of a recording: cameras and targets as assumed by vision unit and docking monitor."""

SLOTS: Final = 16
"""Capacity of a ring: 4 s of two pairs per second, or a burst of eight pairs."""
IMAGE_BYTES: Final = 2 * 1024 * 1024
OVERLAY_BYTES: Final = 16 * 1024
JPEG_QUALITY: Final = 90
_POLL_WALL_S: Final = 0.1

IMAGE: Final = np.dtype(
    [
        ("t_s", "f8"),  # exposure, time of the run; nan before the run and while it is held
        ("bench_s", "f8"),  # exposure, bench time of the source; nan if only the run's time is known
        ("number", "i8"),  # number of the exposure, counted by the source from 0; images of one exposure share it
        ("dropped", "i8"),  # images of this camera that the source has dropped so far
        ("camera", "S32"),
        ("encoding", "S8"),  # "jpeg" or "png"
        ("status", "S24"),  # result of the source: "ok", "too_few", "near", ...
        ("width_px", "i8"),
        ("height_px", "i8"),
        ("size", "i8"),  # valid bytes of data; 0 for an image that is too large
        ("overlay_size", "i8"),  # valid bytes of overlay
        ("overlay", "u1", OVERLAY_BYTES),  # UTF-8, a JSON list of Shape
        ("data", "u1", IMAGE_BYTES),
    ],
    align=True,
)
"""An encoded image with its overlay."""


class RowSink(Protocol):
    """Sink of rows: a ring or a file."""

    def put(self, row: np.ndarray) -> None:
        """Copy ``row``, shape (1,) of IMAGE; never waits."""


class RunClock(Protocol):
    """Conversion of bench time to time of the run."""

    def at(self, bench_s: float) -> float:
        """Return the time of the run at ``bench_s``; nan while the run's time is held."""


@dataclass(frozen=True)
class ImagePolicy:
    """Selection of images. encoding: "none" for no images. each_s: shortest time between two of a camera, 0: all."""

    encoding: Literal["none", "jpeg", "png"] = "none"
    each_s: float = 0.0


@dataclass(frozen=True)
class CameraImage:
    """An image before encoding. image: (h, w) or (h, w, 3), uint8, grey or BGR. Times as in IMAGE."""

    camera: str
    image: np.ndarray
    bench_s: float = math.nan
    t_s: float = math.nan
    number: int = 0
    status: str = ""
    shapes: Sequence[Shape] = ()


@dataclass(frozen=True)
class Exposure:
    """Exposure of an image; fields as in IMAGE."""

    bench_s: float = math.nan
    number: int = 0
    status: str = ""
    dropped: int = 0


def image_row(
    camera: str,
    t_s: float,
    data: bytes,
    encoding: Encoding = "jpeg",
    size_px: tuple[int, int] = (0, 0),
    shapes: Sequence[Shape] = (),
    exposure: Exposure = Exposure(),
    into: np.ndarray | None = None,
) -> np.ndarray:
    """Return an image as a row, shape (1,) of IMAGE; size_px: width, height; into: a row to overwrite.

    Shapes beyond OVERLAY_BYTES are dropped, the last ones first. Raises BadInput for data beyond IMAGE_BYTES.
    """
    if len(data) > IMAGE_BYTES:
        raise BadInput.single(
            camera, "", f"image of {len(data)} bytes, at most {IMAGE_BYTES}: increase the compression"
        )
    row = np.zeros(1, IMAGE) if into is None else into
    overlay = overlay_json(shapes)
    row["t_s"], row["bench_s"], row["number"], row["dropped"] = t_s, exposure.bench_s, exposure.number, exposure.dropped
    row["camera"], row["encoding"], row["status"] = camera.encode(), encoding.encode(), exposure.status.encode()[:24]
    row["width_px"], row["height_px"] = size_px
    row["size"], row["overlay_size"] = len(data), len(overlay)
    row["overlay"][0, : len(overlay)] = np.frombuffer(overlay, np.uint8)
    row["data"][0, : len(data)] = np.frombuffer(data, np.uint8)
    return row


def overlay_json(shapes: Sequence[Shape]) -> bytes:
    """Return the first of ``shapes`` that fit into a JSON list of OVERLAY_BYTES; shapes with a nan are dropped."""
    texts, remaining = [], OVERLAY_BYTES - 2
    for shape in shapes:
        try:
            text = json.dumps(shape, separators=(",", ":"), allow_nan=False).encode()
        except ValueError:
            continue
        remaining -= len(text) + 1
        if remaining < 0:
            break
        texts.append(text)
    return b"[" + b",".join(texts) + b"]"


def overlay_shapes(row: np.void) -> tuple[Shape, ...]:
    """Return the overlay of ``row``, one of IMAGE."""
    text = row["overlay"][: int(row["overlay_size"])].tobytes()
    return tuple(json.loads(text)) if text else ()


def image_data(row: np.void) -> bytes:
    """Return the encoded image of ``row``, one of IMAGE."""
    data: bytes = row["data"][: int(row["size"])].tobytes()
    return data


def encode(image: np.ndarray, encoding: Encoding, quality: int = JPEG_QUALITY) -> bytes:
    """Return ``image`` (h, w) or (h, w, 3), uint8, grey or BGR, as the bytes of a file; quality: of JPEG, 0 to 100.

    Raises ValueError for any other array.
    """
    import cv2

    if image.dtype != np.uint8 or image.ndim not in (2, 3) or not image.size:
        raise ValueError(f"{image.dtype} of shape {image.shape} is not an image")
    if encoding == "png":
        # camera noise has no repetitions: searching for them takes twice the time and gives files a third larger
        suffix, options = ".png", [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY]
        if hasattr(cv2, "IMWRITE_PNG_FILTER"):  # OpenCV 4 has none
            options += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
    else:
        suffix, options = ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality]
    written, code = cv2.imencode(suffix, image, options)
    if not written:
        raise ValueError(f"an image of shape {image.shape} cannot be encoded as {encoding}")
    return bytes(code.tobytes())


class ImageEncoder:
    """Encodes the images of a source that ``policy`` selects and puts them into ``out``. Not thread-safe.

    An image that is too large is counted as dropped, and its row has no data.
    """

    def __init__(self, out: RowSink, policy: ImagePolicy, run: RunClock | None = None) -> None:
        self._out = out
        self._policy = policy
        self._run = run
        self._last_s = -math.inf
        self._dropped: dict[str, int] = {}
        self._row = np.zeros(1, IMAGE)

    def due(self, exposed_s: float) -> bool:
        """Return whether images exposed at ``exposed_s``, by the source's clock, are selected.

        To be called once per exposure, whichever cameras it has.
        """
        if self._policy.encoding == "none":
            return False
        if exposed_s < self._last_s:  # the clock was set back
            self._last_s = -math.inf
        if exposed_s - self._last_s < self._policy.each_s - 1e-6:
            return False
        self._last_s = exposed_s
        return True

    def put(self, *images: CameraImage) -> None:
        """Encode the images of an exposure and put them into the sink, with the run's time if they lack it."""
        for image in self.timed(*images):
            self._put(image)

    def timed(self, *images: CameraImage) -> tuple[CameraImage, ...]:
        """Return ``images`` with the present time of the run if they lack it."""
        run = self._run
        if run is None:
            return images
        return tuple(replace(image, t_s=run.at(image.bench_s)) if math.isnan(image.t_s) else image for image in images)

    def _put(self, image: CameraImage) -> None:
        assert self._policy.encoding != "none"
        data = encode(image.image, self._policy.encoding)
        if len(data) > IMAGE_BYTES:
            self.count_dropped(image)
            data = b""
        height, width = image.image.shape[:2]
        exposure = Exposure(image.bench_s, image.number, image.status, self._dropped.get(image.camera, 0))
        size_px = (width, height)
        row = image_row(
            image.camera, image.t_s, data, self._policy.encoding, size_px, image.shapes, exposure, self._row
        )
        self._out.put(row)

    def count_dropped(self, *images: CameraImage) -> None:
        """Count ``images`` that are not put into the sink."""
        for image in images:
            self._dropped[image.camera] = self._dropped.get(image.camera, 0) + 1


class ImageSink(Protocol):
    """Sink of a source of images; ``ImageEncoder`` encodes in the caller, ``ThreadedImageSink`` in a thread."""

    def due(self, exposed_s: float) -> bool:
        """Return whether images exposed at ``exposed_s`` are selected; to be called once per exposure."""

    def put(self, *images: CameraImage) -> None:
        """Accept the images of an exposure; their arrays must not change afterwards."""


class ThreadedImageSink:
    """Encodes images in a thread of its own, for a source with deadlines: ``put`` never waits.

    The thread has no real-time priority. An exposure that arrives while QUEUE_MAX are queued is counted as dropped.
    """

    QUEUE_MAX: Final = 32  # 64 MB of pairs of 1024 x 1024

    def __init__(self, encoder: ImageEncoder) -> None:
        self._encoder = encoder
        self._queue: queue.Queue[tuple[CameraImage, ...] | None] = queue.Queue(self.QUEUE_MAX)
        self._thread: threading.Thread | None = None

    def due(self, exposed_s: float) -> bool:
        return self._encoder.due(exposed_s)

    def put(self, *images: CameraImage) -> None:
        """Queue the images of an exposure; their arrays must not change afterwards."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="images", daemon=True)
            self._thread.start()
        try:
            self._queue.put_nowait(self._encoder.timed(*images))
        except queue.Full:
            self._encoder.count_dropped(*images)

    def close(self) -> None:
        """Encode what is queued, then end the thread. Idempotent."""
        while self._thread is not None and self._thread.is_alive():
            with contextlib.suppress(queue.Full):
                self._queue.put(None, timeout=_POLL_WALL_S)
                self._thread.join()
        self._thread = None

    def _work(self) -> None:
        drop_priority()
        while (images := self._queue.get()) is not None:
            self._encoder.put(*images)
