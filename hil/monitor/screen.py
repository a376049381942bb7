"""The operator's screen (monitor paper, Fig. 7): the picture with what was found in it, numbers, growing plots.

``Screen`` paints on a canvas from messages alone; ``ScreenFile`` keeps the canvases as a video, or the last one as
a picture.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.config.scene import Camera
from hil.errors import BadInput
from hil.monitor import ink, plots
from hil.monitor.findings import Portion, Seen
from hil.monitor.ink import Canvas
from hil.monitor.sources import WHOLE, Frame

WIDTH: Final = 1600
HEIGHT: Final = 900
_PICTURE: Final = (800, 600)  # the place for the picture, px
_CODES: Final = {".mp4": "mp4v", ".mkv": "mp4v", ".avi": "MJPG"}
SUFFIXES: Final = (*_CODES, ".png")

_DEG: Final = 180.0 / math.pi
_NUMBERS: Final = (  # quantity, what stands before it, unit, what one unit is in SI, decimals
    ("range_m", "range", "m", 1.0, 3),
    ("range_rate_mps", "range rate", "m/s", 1.0, 4),
    ("pitch_passive_rad", "passive pitch", "deg", _DEG, 3),
    ("yaw_passive_rad", "passive yaw", "deg", _DEG, 3),
    ("los_right_rad", "target right", "deg", _DEG, 3),
    ("los_up_rad", "target up", "deg", _DEG, 3),
    ("phi1_rad", "active pitch", "deg", _DEG, 3),
    ("phi2_rad", "active yaw", "deg", _DEG, 3),
    ("phi3_rad", "active roll", "deg", _DEG, 3),
    ("d1_m", "d1", "m", 1.0, 4),
    ("d2_m", "d2", "m", 1.0, 4),
    ("d3_m", "d3", "m", 1.0, 4),
)


class Screen:
    """Paints one canvas (HEIGHT, WIDTH, 3), blue green red, which each message changes in its own part."""

    def __init__(self, camera: Camera, title: str) -> None:
        self.canvas: Canvas = np.full((HEIGHT, WIDTH, 3), ink.PAPER, np.uint8)
        self._title = title
        self._scale = min(_PICTURE[0] / camera.width, _PICTURE[1] / camera.height)
        self._size = (round(camera.width * self._scale), round(camera.height * self._scale))
        self._history = plots.History()
        self._draw_numbers(None)
        self._draw_plots()

    def show_frame(self, frame: Frame, seen: Seen) -> None:
        """Show a frame and what was seen in it."""
        image = frame.image
        if frame.field != WHOLE:
            image = np.repeat(image, 2, axis=0)  # the other half frame's lines are of another time
        width, height = self._size
        grey = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
        left = (_PICTURE[0] - width) // 2
        place = self.canvas[:height, left : left + width]
        cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR, dst=place)
        self._draw_seen(place, seen)

    def show_portion(self, portion: Portion) -> None:
        """Show the motion after a portion."""
        self._history.add(portion)
        self._draw_numbers(portion)
        self._draw_plots()

    def _place(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where points (n, 2) of the picture stand on the screen, px; pixel centres at whole numbers."""
        found: NDArray[np.float64] = (points + 0.5) * self._scale - 0.5
        return found

    def _draw_seen(self, place: Canvas, seen: Seen) -> None:
        if seen.region is not None:
            u, v, width, height = seen.region
            corners = np.array([[u, v], [u + width, v], [u + width, v + height], [u, v + height]])
            ink.line(place, self._place(corners), ink.YELLOW, closed=True)
        for circle in (seen.outline, seen.disc):
            if circle is not None:
                u, v = self._place(np.array([circle[:2]]))[0]
                ink.circle(place, u, v, circle[2] * self._scale, ink.SKY)
        if seen.cross is not None:
            reach = max(0.8 * seen.disc[2], 12.0) if seen.disc is not None else 24.0
            across = np.array([math.cos(seen.cross[2]), -math.sin(seen.cross[2])])
            centre = np.array(seen.cross[:2])
            for arm in (across, np.array([-across[1], across[0]])):
                ink.line(place, self._place(np.array([centre - reach * arm, centre + reach * arm])), ink.PINK)
        ink.dots(place, self._place(np.asarray(seen.edges, float).reshape(-1, 2)), ink.ORANGE)
        words = f"{seen.status}   t = {seen.t_s:.2f} s   frame {seen.number}"
        place[:24] = place[:24] // 3
        ink.text(place, words, 8, 17, ink.VERMILION if _is_bad(seen.status) else ink.WHITE, 0.5)

    def _draw_numbers(self, portion: Portion | None) -> None:
        panel = self.canvas[_PICTURE[1] :, : _PICTURE[0]]
        panel[:] = ink.PAPER
        ink.text(panel, self._title, 16, 24, ink.GREY, 0.45)
        status = "waiting" if portion is None else portion.status
        words = status if portion is None else f"{status}   t = {portion.t_s:.2f} s   {portion.frames} frames"
        ink.text(panel, words, 16, 54, ink.VERMILION if _is_bad(status) else ink.WHITE, 0.65)
        legend = "orange: edges   blue: circles   pink: cross   yellow: region   band: 2 sigma"
        ink.text(panel, legend, 16, 290, ink.GREY, 0.4)
        for number, (quantity, name, unit, factor, decimals) in enumerate(_NUMBERS):
            left, v = 16 + 396 * (number % 2), 92 + 32 * (number // 2)
            ink.text(panel, name, left, v, ink.GREY, 0.5)
            value = "-"
            if portion is not None and portion.observes(quantity):
                value = f"{portion.value(quantity) * factor:.{decimals}f}"
                spread = f"+- {portion.sigma(quantity) * factor:.{decimals}f} {unit}"
                ink.text(panel, spread, left + 242, v, ink.GREY, 0.45)
            ink.text_right(panel, value, left + 232, v, ink.WHITE, 0.55)

    def _draw_plots(self) -> None:
        width, height = (WIDTH - _PICTURE[0]) // 2, HEIGHT // (len(plots.PLOTS) // 2)
        for number, plot in enumerate(plots.PLOTS):
            top, left = height * (number // 2), _PICTURE[0] + width * (number % 2)
            plots.draw(self.canvas[top : top + height, left : left + width], plot, self._history)


def _is_bad(status: str) -> bool:
    return status == "no_target" or status.startswith("rejected")


class ScreenFile:
    """Keeps canvases: .mp4, .mkv, .avi every one of them, .png the last."""

    def __init__(self, path: str, rate_hz: float) -> None:
        """Raise BadInput where ``path`` cannot be written."""
        self._path = Path(path)
        suffix = self._path.suffix.lower()
        if suffix not in SUFFIXES:
            raise BadInput.single("--screen", path, f"must end in {', '.join(SUFFIXES)}")
        if not self._path.parent.is_dir():
            raise BadInput.single("--screen", path, f"no folder {self._path.parent}")
        self._video: cv2.VideoWriter | None = None
        self._last: Canvas | None = None
        if suffix != ".png":
            code = cv2.VideoWriter.fourcc(*_CODES[suffix])
            self._video = cv2.VideoWriter(path, code, rate_hz, (WIDTH, HEIGHT))
            if not self._video.isOpened():
                raise BadInput.single("--screen", path, "cannot be written")

    def write(self, canvas: Canvas) -> None:
        """Keep ``canvas`` as it is now."""
        if self._video is None:
            self._last = canvas
        else:
            self._video.write(canvas)

    def close(self) -> None:
        """Finish the file. Idempotent."""
        if self._video is not None:
            self._video.release()
        elif self._last is not None:
            written, code = cv2.imencode(".png", self._last)
            if written:
                self._path.write_bytes(code.tobytes())
        self._video, self._last = None, None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
