"""Overlay of a stereo pair: spots, LED numbers, reprojected LEDs, pose and sigma, as shapes in pixels and drawn."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from hil.core.camera_images import Shape
from hil.vmu.kernels.lens import project
from hil.vmu.kernels.records import RingScene
from hil.vmu.kernels.refine import place_when_seen
from hil.vmu.pose import matrix_of
from hil.vmu.unit import PREDICTED, SUSPECT, Solution

SPOT, IDENTITY, LED, STATUS, VALUE, NOTE = "spot", "identity", "led", "status", "value", "note"
"""Parts: a spot, the number of its LED, an LED projected with the pose, lines of text."""

LINE_PX: Final = 20
_LEFT_PX: Final = 12
_FARTHEST_PX: Final = 1e5
_WHITE, _GREY, _GREEN, _AMBER, _RED, _BLUE = (
    (255, 255, 255), (150, 150, 150), (90, 220, 90), (60, 180, 255), (80, 80, 255), (255, 170, 80),
)  # fmt: skip
_COLOURS: Final = {"ok": _GREEN} | dict.fromkeys(
    ("predicted", "suspect", "ok_position", "ok_sight", "ambiguous"), _AMBER
)
_CAPTION_COLOURS: Final = {VALUE: _WHITE, NOTE: _GREY}
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_ARM_PX: Final = 5
_SHIFT: Final = 4  # drawing in 1/16 px
_GAMMA: Final = 0.5  # makes faint spots visible


def shapes(scene: RingScene, solution: Solution, camera: int, title: str = "") -> list[Shape]:
    """Return the overlay of the image of ``camera``, 0 left, 1 right, the most important shapes first.

    scene: of the unit's solver. A spot is good if assigned to an LED, a pose if measured.
    """
    return [*_caption(solution, title), *_leds(scene, solution, camera), *_spots(solution, camera)]


def lines(solution: Solution, title: str = "") -> list[tuple[str, str]]:
    """Return lines of text about the pose, each with its part: STATUS, VALUE or NOTE."""
    texts = [(f"{title}  {solution.status}  {solution.n_leds} LEDs".strip(), STATUS)]
    if solution.pose is not None:
        t, rotation = solution.pose.t_v, np.degrees(solution.pose.rotation_vector)
        sigma = np.sqrt(np.diag(solution.pose.covariance))
        texts.append((f"t  {t[0]:+.4f} {t[1]:+.4f} {t[2]:+.4f} m", VALUE))
        texts.append((f"sigma {1e3 * sigma[0]:.3f} {1e3 * sigma[1]:.3f} {1e3 * sigma[2]:.3f} mm", NOTE))
        texts.append((f"r  {rotation[0]:+.3f} {rotation[1]:+.3f} {rotation[2]:+.3f} deg", VALUE))
        s = np.degrees(sigma[3:])
        texts.append((f"sigma {s[0]:.4f} {s[1]:.4f} {s[2]:.4f} deg", NOTE))
    elif solution.partial is not None:
        t, sigma = solution.t, np.sqrt(np.diag(solution.covariance))
        texts.append((f"t  {t[0]:+.4f} {t[1]:+.4f} {t[2]:+.4f} m, no attitude", VALUE))
        texts.append((f"sigma {1e3 * sigma[0]:.3f} {1e3 * sigma[1]:.3f} {1e3 * sigma[2]:.3f} mm", NOTE))
    if solution.doubt is not None:
        texts.append((str(solution.doubt), NOTE))
    if solution.degrees:
        texts.append((f"chi-square {solution.chi2:.1f} at {solution.degrees} degrees of freedom", NOTE))
    elif solution.candidates > 1:
        texts.append((f"{solution.candidates} poses fit the spots", NOTE))
    return texts


def _caption(solution: Solution, title: str) -> list[Shape]:
    good = solution.pose is not None and solution.status not in (PREDICTED, SUSPECT)
    return [
        {"kind": "text", "at": [_LEFT_PX, LINE_PX * (row + 1) + 4], "text": text, "good": good, "part": part}
        for row, (text, part) in enumerate(lines(solution, title))
    ]


def _leds(scene: RingScene, solution: Solution, camera: int) -> list[Shape]:
    if solution.pose is None:
        return []
    r, arm, point = matrix_of(solution.pose.q_vt), np.empty(3), np.empty(3)
    crosses: list[Shape] = []
    for led in scene.leds:
        place_when_seen(scene, camera, led, r, solution.pose.t_v, arm, point)
        u, v = project(scene.lens[camera], point[0], point[1], point[2])
        if math.isfinite(u + v) and max(abs(u), abs(v)) < _FARTHEST_PX:
            crosses.append({"kind": "cross", "at": _at(u, v), "good": True, "part": LED})
    return crosses


def _spots(solution: Solution, camera: int) -> list[Shape]:
    """Return numbered circles around the spots, LEDs first."""
    names = {k: n for n, k in enumerate(solution.leds[camera]) if k >= 0}
    identified: list[Shape] = []
    others: list[Shape] = []
    for k, spot in enumerate(solution.spots[camera]):
        u, v, radius = float(spot["u"]), float(spot["v"]), 3.0 * float(spot["size"]) + 4.0
        circle = {"kind": "circle", "at": _at(u, v), "radius": round(radius, 2), "good": k in names, "part": SPOT}
        if k not in names:
            others.append(circle)
            continue
        corner = [round(u + radius + 2), round(v - radius - 2)]
        number = {"kind": "text", "at": corner, "text": str(names[k]), "good": True, "part": IDENTITY}
        identified += [circle, number]
    return [*identified, *others]


def _at(u: float, v: float) -> list[float]:
    return [round(float(u), 2), round(float(v), 2)]


def draw(
    scene: RingScene, left: np.ndarray | None, right: np.ndarray | None, solution: Solution, title: str
) -> np.ndarray:
    """Return both images (h, w), uint8, side by side with the overlay: (h, w, 3), uint8, BGR."""
    panels: list[np.ndarray] = [_panel(scene, image, solution, c) for c, image in enumerate((left, right))]
    height = max(panel.shape[0] for panel in panels)
    padded = [cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, 0, cv2.BORDER_CONSTANT) for p in panels]
    image = np.hstack(padded)
    for row, (text, part) in enumerate(lines(solution, title)):
        place_at = (12, LINE_PX * (row + 1) + 4)
        colour = _COLOURS.get(solution.status, _RED) if part == STATUS else _CAPTION_COLOURS[part]
        cv2.putText(image, text, place_at, _FONT, 0.5, colour, 1, cv2.LINE_AA)
    return image


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
    """Draw a shape in one image; the text about the pose is drawn over both images and skipped here."""
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
