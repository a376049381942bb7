"""A picture of what the unit made of one stereo pair: spots, identities, reprojected LEDs, pose and sigma."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from hil.vmu.kernels.lens import project
from hil.vmu.kernels.records import Scene
from hil.vmu.kernels.refine import place
from hil.vmu.pose import matrix_of
from hil.vmu.unit import Solution

_WHITE, _GREY, _GREEN, _AMBER, _RED, _BLUE = (
    (255, 255, 255), (150, 150, 150), (90, 220, 90), (60, 180, 255), (80, 80, 255), (255, 170, 80),
)  # fmt: skip
_COLOURS: Final = {"ok": _GREEN, "predicted": _AMBER, "ambiguous": _AMBER}
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_LINE_PX: Final = 20
_SHIFT: Final = 4  # drawing in sixteenths of a pixel
_GAMMA: Final = 0.5  # faint spots are to be seen


def draw(scene: Scene, left: np.ndarray | None, right: np.ndarray | None, solution: Solution, title: str) -> np.ndarray:
    """Return both images (h, w), uint8, side by side with the solution drawn over them: (h, w, 3), uint8, BGR."""
    panels: list[np.ndarray] = [_panel(scene, image, solution, c) for c, image in enumerate((left, right))]
    height = max(panel.shape[0] for panel in panels)
    padded = [cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, 0, cv2.BORDER_CONSTANT) for p in panels]
    picture = np.hstack(padded)
    for row, (text, colour) in enumerate(_lines(solution, title)):
        place_at = (12, _LINE_PX * (row + 1) + 4)
        cv2.putText(picture, text, place_at, _FONT, 0.5, colour, 1, cv2.LINE_AA)
    return picture


def _panel(scene: Scene, image: np.ndarray | None, solution: Solution, camera: int) -> np.ndarray:
    lens = scene.lens[camera]
    shape = (int(lens["height"]), int(lens["width"]))
    if image is None or image.shape != shape:
        panel: np.ndarray = np.zeros((*shape, 3), np.uint8)
        text = "no image" if image is None else f"{image.shape[1]} x {image.shape[0]}: not the geometry's size"
        cv2.putText(panel, text, (shape[1] // 3, shape[0] // 2), _FONT, 0.7, _GREY, 1, cv2.LINE_AA)
    else:
        table = (255.0 * (np.arange(256) / 255.0) ** _GAMMA).astype(np.uint8)
        panel = np.asarray(cv2.cvtColor(cv2.LUT(image, table), cv2.COLOR_GRAY2BGR))
    _draw_spots(panel, solution, camera)
    _draw_leds(panel, scene, solution, camera)
    cv2.line(panel, (shape[1] - 1, 0), (shape[1] - 1, shape[0]), _GREY, 1)
    return panel


def _draw_spots(panel: np.ndarray, solution: Solution, camera: int) -> None:
    names = {k: n for n, k in enumerate(solution.leds[camera]) if k >= 0}
    for k, spot in enumerate(solution.spots[camera]):
        radius = 3.0 * float(spot["size"]) + 4.0
        colour = _GREEN if k in names else _RED
        cv2.circle(panel, _fine(spot["u"], spot["v"]), round(radius * 2**_SHIFT), colour, 1, cv2.LINE_AA, _SHIFT)
        if k in names:
            corner = (round(spot["u"] + radius + 2), round(spot["v"] - radius - 2))
            cv2.putText(panel, str(names[k]), corner, _FONT, 0.5, _GREEN, 1, cv2.LINE_AA)


def _draw_leds(panel: np.ndarray, scene: Scene, solution: Solution, camera: int) -> None:
    if solution.pose is None:
        return
    r, arm, point = matrix_of(solution.pose.q_vt), np.empty(3), np.empty(3)
    for led in scene.leds:
        place(scene.rotation[camera], scene.translation[camera], r, solution.pose.t_v, led, arm, point)
        u, v = project(scene.lens[camera], point[0], point[1], point[2])
        if math.isfinite(u + v) and max(abs(u), abs(v)) < 1e5:
            x, y = _fine(u, v)
            arm_px = 5 * 2**_SHIFT
            cv2.line(panel, (x - arm_px, y), (x + arm_px, y), _BLUE, 1, cv2.LINE_AA, _SHIFT)
            cv2.line(panel, (x, y - arm_px), (x, y + arm_px), _BLUE, 1, cv2.LINE_AA, _SHIFT)


def _lines(solution: Solution, title: str) -> list[tuple[str, tuple[int, int, int]]]:
    colour = _COLOURS.get(solution.status, _RED)
    lines = [(f"{title}  {solution.status}  {solution.n_leds} LEDs", colour)]
    if solution.pose is not None:
        t, turn = solution.pose.t_v, np.degrees(solution.pose.rotation_vector)
        sigma = np.sqrt(np.diag(solution.pose.covariance))
        lines.append((f"t  {t[0]:+.4f} {t[1]:+.4f} {t[2]:+.4f} m", _WHITE))
        lines.append((f"sigma {1e3 * sigma[0]:.3f} {1e3 * sigma[1]:.3f} {1e3 * sigma[2]:.3f} mm", _GREY))
        lines.append((f"r  {turn[0]:+.3f} {turn[1]:+.3f} {turn[2]:+.3f} deg", _WHITE))
        s = np.degrees(sigma[3:])
        lines.append((f"sigma {s[0]:.4f} {s[1]:.4f} {s[2]:.4f} deg", _GREY))
    if solution.degrees:
        lines.append((f"chi-square {solution.chi2:.1f} at {solution.degrees} degrees of freedom", _GREY))
    elif solution.candidates > 1:
        lines.append((f"{solution.candidates} poses fit the spots", _GREY))
    return lines


def _fine(u: float, v: float) -> tuple[int, int]:
    return round(float(u) * 2**_SHIFT), round(float(v) * 2**_SHIFT)
