"""Operator's screen (monitor paper, Fig. 7): the image with the detected features, values, growing plots.

``Screen`` draws on a canvas from messages only; ``ScreenFile`` saves the canvases as a video, or the last one as
an image.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.config.scene import SceneCamera
from hil.errors import BadInput
from hil.parts.monitor.results import FrameDetection, Portion
from hil.parts.monitor.screen import drawing, plots
from hil.parts.monitor.screen.drawing import Canvas
from hil.parts.monitor.screen.overlay import CIRCLE, CROSS, NUMBERS, REGION, caption, is_bad, shapes
from hil.parts.monitor.sources import WHOLE, VideoFrame

WIDTH: Final = 1600
HEIGHT: Final = 900
_IMAGE: Final = (800, 600)  # area of the image, px
_CODES: Final = {".mp4": "mp4v", ".mkv": "mp4v", ".avi": "MJPG"}
SUFFIXES: Final = (*_CODES, ".png")

_COLOURS: Final = {REGION: drawing.YELLOW, CIRCLE: drawing.SKY, CROSS: drawing.PINK}


class Screen:
    """Draws one canvas (HEIGHT, WIDTH, 3), blue green red; each message changes its own part."""

    def __init__(self, camera: SceneCamera, title: str) -> None:
        self.canvas: Canvas = np.full((HEIGHT, WIDTH, 3), drawing.PAPER, np.uint8)
        self._title = title
        self._scale = min(_IMAGE[0] / camera.width, _IMAGE[1] / camera.height)
        self._size = (round(camera.width * self._scale), round(camera.height * self._scale))
        self._history = plots.History()
        self._draw_numbers(None)
        self._draw_plots()

    def show_frame(self, frame: VideoFrame, seen: FrameDetection) -> None:
        """Show a frame and the features detected in it."""
        image = frame.image
        if frame.field != WHOLE:
            image = np.repeat(image, 2, axis=0)  # the lines of the other field have another exposure time
        width, height = self._size
        grey = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
        left = (_IMAGE[0] - width) // 2
        view = self.canvas[:height, left : left + width]
        cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR, dst=view)
        self._draw_seen(view, seen)

    def show_portion(self, portion: Portion) -> None:
        """Show the motion after a portion."""
        self._history.add(portion)
        self._draw_numbers(portion)
        self._draw_plots()

    def _place(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the positions of points (n, 2) of the image on the screen, px; pixel centres at integers."""
        scaled: NDArray[np.float64] = (points + 0.5) * self._scale - 0.5
        return scaled

    def _draw_seen(self, canvas: Canvas, seen: FrameDetection) -> None:
        for shape in shapes(seen):
            colour = _COLOURS[shape["part"]]
            if shape["kind"] == "circle":
                u, v = self._place(np.array([shape["at"]]))[0]
                drawing.circle(canvas, u, v, shape["radius"] * self._scale, colour)
            else:
                drawing.line(canvas, self._place(np.array([shape["from"], shape["to"]])), colour)
        drawing.dots(canvas, self._place(np.asarray(seen.edges, float).reshape(-1, 2)), drawing.ORANGE)
        canvas[:24] = canvas[:24] // 3
        drawing.text(canvas, caption(seen), 8, 17, drawing.VERMILION if is_bad(seen.status) else drawing.WHITE, 0.5)

    def _draw_numbers(self, portion: Portion | None) -> None:
        panel = self.canvas[_IMAGE[1] :, : _IMAGE[0]]
        panel[:] = drawing.PAPER
        drawing.text(panel, self._title, 16, 24, drawing.GREY, 0.45)
        status = "waiting" if portion is None else portion.status
        line = status if portion is None else f"{status}   t = {portion.t_s:.2f} s   {portion.frames} frames"
        drawing.text(panel, line, 16, 54, drawing.VERMILION if is_bad(status) else drawing.WHITE, 0.65)
        legend = "orange: edges   blue: circles   pink: cross   yellow: region   band: 2 sigma"
        drawing.text(panel, legend, 16, 290, drawing.GREY, 0.4)
        for number, (quantity, name, unit, factor, decimals) in enumerate(NUMBERS):
            left, v = 16 + 396 * (number % 2), 92 + 32 * (number // 2)
            drawing.text(panel, name, left, v, drawing.GREY, 0.5)
            value = "-"
            if portion is not None and portion.observes(quantity):
                value = f"{portion.value(quantity) * factor:.{decimals}f}"
                spread = f"+- {portion.sigma(quantity) * factor:.{decimals}f} {unit}"
                drawing.text(panel, spread, left + 242, v, drawing.GREY, 0.45)
            drawing.text_right(panel, value, left + 232, v, drawing.WHITE, 0.55)

    def _draw_plots(self) -> None:
        width, height = (WIDTH - _IMAGE[0]) // 2, HEIGHT // (len(plots.PLOTS) // 2)
        for number, plot in enumerate(plots.PLOTS):
            top, left = height * (number // 2), _IMAGE[0] + width * (number % 2)
            plots.draw(self.canvas[top : top + height, left : left + width], plot, self._history)


class ScreenFile:
    """Saves canvases: .mp4, .mkv, .avi all of them, .png the last."""

    def __init__(self, path: str, rate_hz: float) -> None:
        """Raise BadInput if ``path`` cannot be written."""
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
        """Save ``canvas`` in its present state."""
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
