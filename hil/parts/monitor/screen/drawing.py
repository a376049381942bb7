"""Drawing on the monitor's screen: colours for all types of colour vision, sub-pixel lines and marks, small text."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

Canvas = NDArray[np.uint8]
Colour = tuple[int, int, int]  # blue, green, red

# palette of Okabe and Ito: distinguishable with any colour blindness, on black
ORANGE: Final[Colour] = (0, 159, 230)
SKY: Final[Colour] = (233, 180, 86)

YELLOW: Final[Colour] = (66, 228, 240)
VERMILION: Final[Colour] = (0, 94, 213)
PINK: Final[Colour] = (167, 121, 204)
WHITE: Final[Colour] = (235, 235, 235)
GREY: Final[Colour] = (150, 150, 150)
DIM: Final[Colour] = (62, 62, 62)
PAPER: Final[Colour] = (22, 20, 18)

_SHIFT: Final = 4  # cv2 takes points in sixteenths of a pixel
_FARTHEST: Final = 20_000.0  # px; beyond it cv2's whole numbers overflow


def _sixteenths(value: float) -> int:
    return round(min(max(value, -_FARTHEST), _FARTHEST) * (1 << _SHIFT))


def text(canvas: Canvas, words: str, u: float, v: float, colour: Colour = WHITE, size: float = 0.45) -> None:
    """Write ``words`` with their lower left corner at (u, v), px."""
    cv2.putText(canvas, words, (round(u), round(v)), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def text_right(canvas: Canvas, words: str, u: float, v: float, colour: Colour = WHITE, size: float = 0.45) -> None:
    """Write ``words`` with their lower right corner at (u, v), px."""
    (width, _), _ = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    text(canvas, words, u - width, v, colour, size)


def line(canvas: Canvas, points: NDArray[np.float64], colour: Colour, width: int = 1, closed: bool = False) -> None:
    """Draw a line through ``points`` (n, 2), px."""
    whole = np.rint(np.clip(points, -_FARTHEST, _FARTHEST) * (1 << _SHIFT)).astype(np.int32)
    cv2.polylines(canvas, [whole], closed, colour, width, cv2.LINE_AA, _SHIFT)


def circle(canvas: Canvas, u: float, v: float, radius: float, colour: Colour, width: int = 1) -> None:
    """Draw a circle, px."""
    centre = (_sixteenths(u), _sixteenths(v))
    cv2.circle(canvas, centre, max(_sixteenths(radius), 1), colour, width, cv2.LINE_AA, _SHIFT)


def dots(canvas: Canvas, points: NDArray[np.float64], colour: Colour) -> None:
    """Set a dot of two by two pixels at each of ``points`` (n, 2), px, that is on the canvas."""
    height, width = canvas.shape[:2]
    finite = points[np.isfinite(points).all(axis=1)]
    inside = finite[(finite >= 0.0).all(axis=1) & (finite < (width - 1, height - 1)).all(axis=1)].astype(int)
    for down in (0, 1):
        for right in (0, 1):
            canvas[inside[:, 1] + down, inside[:, 0] + right] = colour


def mark(canvas: Canvas, shape: int, u: float, v: float, colour: Colour) -> None:
    """Draw the mark of series ``shape``: 0 a circle, 1 a square, 2 a triangle."""
    if shape == 0:
        circle(canvas, u, v, 2.5, colour)
        return
    turns = np.arange(4) * np.pi / 2.0 + np.pi / 4.0 if shape == 1 else np.arange(3) * np.pi / 1.5 - np.pi / 2.0
    corners = np.column_stack((u + 3.5 * np.cos(turns), v + 3.5 * np.sin(turns)))
    line(canvas, corners, colour, closed=True)


def band(canvas: Canvas, upper: NDArray[np.float64], lower: NDArray[np.float64], colour: Colour, share: float) -> None:
    """Shade the area between two lines, (n, 2) each, px, with opacity ``share`` of ``colour``."""
    outline = np.vstack((upper, lower[::-1]))
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, canvas.shape[1::-1])
    if (high <= low).any():
        return
    part: Any = canvas[low[1] : high[1], low[0] : high[0]]
    shaded = part.copy()
    whole = np.rint((outline - low) * (1 << _SHIFT)).astype(np.int32)
    cv2.fillPoly(shaded, [whole], colour, cv2.LINE_AA, _SHIFT)
    cv2.addWeighted(shaded, share, part, 1.0 - share, 0.0, part)
