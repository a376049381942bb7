"""A picture of what the unit made of one stereo pair: spots, identities, reprojected LEDs, pose and sigma."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from hil.core.camera_images import Shape
from hil.vmu.kernels.records import RingScene
from hil.vmu.shapes import IDENTITY, LED, LINE_PX, NOTE, STATUS, VALUE, lines, shapes
from hil.vmu.unit import Solution

_WHITE, _GREY, _GREEN, _AMBER, _RED, _BLUE = (
    (255, 255, 255), (150, 150, 150), (90, 220, 90), (60, 180, 255), (80, 80, 255), (255, 170, 80),
)  # fmt: skip
_COLOURS: Final = {"ok": _GREEN, "predicted": _AMBER, "ambiguous": _AMBER}
_WORDS: Final = {VALUE: _WHITE, NOTE: _GREY}
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_ARM_PX: Final = 5
_SHIFT: Final = 4  # drawing in sixteenths of a pixel
_GAMMA: Final = 0.5  # faint spots are to be seen


def draw(
    scene: RingScene, left: np.ndarray | None, right: np.ndarray | None, solution: Solution, title: str
) -> np.ndarray:
    """Return both images (h, w), uint8, side by side with the solution drawn over them: (h, w, 3), uint8, BGR."""
    panels: list[np.ndarray] = [_panel(scene, image, solution, c) for c, image in enumerate((left, right))]
    height = max(panel.shape[0] for panel in panels)
    padded = [cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, 0, cv2.BORDER_CONSTANT) for p in panels]
    picture = np.hstack(padded)
    for row, (text, part) in enumerate(lines(solution, title)):
        place_at = (12, LINE_PX * (row + 1) + 4)
        colour = _COLOURS.get(solution.status, _RED) if part == STATUS else _WORDS[part]
        cv2.putText(picture, text, place_at, _FONT, 0.5, colour, 1, cv2.LINE_AA)
    return picture


def _panel(scene: RingScene, image: np.ndarray | None, solution: Solution, camera: int) -> np.ndarray:
    lens = scene.lens[camera]
    shape = (int(lens["height"]), int(lens["width"]))
    if image is None or image.shape != shape:
        panel: np.ndarray = np.zeros((*shape, 3), np.uint8)
        text = "no image" if image is None else f"{image.shape[1]} x {image.shape[0]}: not the geometry's size"
        cv2.putText(panel, text, (shape[1] // 3, shape[0] // 2), _FONT, 0.7, _GREY, 1, cv2.LINE_AA)
    else:
        table = (255.0 * (np.arange(256) / 255.0) ** _GAMMA).astype(np.uint8)
        panel = np.asarray(cv2.cvtColor(cv2.LUT(image, table), cv2.COLOR_GRAY2BGR))
    for each in shapes(scene, solution, camera):
        _draw(panel, each)
    cv2.line(panel, (shape[1] - 1, 0), (shape[1] - 1, shape[0]), _GREY, 1)
    return panel


def _draw(panel: np.ndarray, shape: Shape) -> None:
    """Draw a shape of the picture; the words about the pose stand over both pictures and are not drawn here."""
    if shape["part"] == LED:
        x, y = _fine(*shape["at"])
        arm = _ARM_PX * 2**_SHIFT
        cv2.line(panel, (x - arm, y), (x + arm, y), _BLUE, 1, cv2.LINE_AA, _SHIFT)
        cv2.line(panel, (x, y - arm), (x, y + arm), _BLUE, 1, cv2.LINE_AA, _SHIFT)
    elif shape["kind"] == "circle":
        colour = _GREEN if shape["good"] else _RED
        cv2.circle(panel, _fine(*shape["at"]), round(shape["radius"] * 2**_SHIFT), colour, 1, cv2.LINE_AA, _SHIFT)
    elif shape["part"] == IDENTITY:
        cv2.putText(panel, shape["text"], tuple(shape["at"]), _FONT, 0.5, _GREEN, 1, cv2.LINE_AA)


def _fine(u: float, v: float) -> tuple[int, int]:
    return round(float(u) * 2**_SHIFT), round(float(v) * 2**_SHIFT)
