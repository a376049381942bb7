"""What is drawn over a stereo pair: spots, identities, reprojected LEDs, pose and sigma, as shapes in pixels.

``hil.vmu.overlay`` paints them, the console's page and recordings take them as they are.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.camera_images import Shape
from hil.vmu.kernels.lens import project
from hil.vmu.kernels.records import RingScene
from hil.vmu.kernels.refine import place
from hil.vmu.pose import matrix_of
from hil.vmu.unit import PREDICTED, Solution

SPOT, IDENTITY, LED, STATUS, VALUE, NOTE = "spot", "identity", "led", "status", "value", "note"
"""Parts: a spot of light, the number of its LED, where an LED should be by the pose, lines of words."""

LINE_PX: Final = 20
_LEFT_PX: Final = 12
_FARTHEST_PX: Final = 1e5


def shapes(scene: RingScene, solution: Solution, camera: int, title: str = "") -> list[Shape]:
    """Return what is drawn over the picture of ``camera``, 0 left, 1 right; what matters most comes first.

    scene: of the unit's solver. A spot is good where it was taken for an LED, a pose where it was measured.
    """
    return [*_words(solution, title), *_leds(scene, solution, camera), *_spots(solution, camera)]


def lines(solution: Solution, title: str = "") -> list[tuple[str, str]]:
    """Return lines of words about the pose, each with its part: STATUS, VALUE or NOTE."""
    found = [(f"{title}  {solution.status}  {solution.n_leds} LEDs".strip(), STATUS)]
    if solution.pose is not None:
        t, turn = solution.pose.t_v, np.degrees(solution.pose.rotation_vector)
        sigma = np.sqrt(np.diag(solution.pose.covariance))
        found.append((f"t  {t[0]:+.4f} {t[1]:+.4f} {t[2]:+.4f} m", VALUE))
        found.append((f"sigma {1e3 * sigma[0]:.3f} {1e3 * sigma[1]:.3f} {1e3 * sigma[2]:.3f} mm", NOTE))
        found.append((f"r  {turn[0]:+.3f} {turn[1]:+.3f} {turn[2]:+.3f} deg", VALUE))
        s = np.degrees(sigma[3:])
        found.append((f"sigma {s[0]:.4f} {s[1]:.4f} {s[2]:.4f} deg", NOTE))
    if solution.degrees:
        found.append((f"chi-square {solution.chi2:.1f} at {solution.degrees} degrees of freedom", NOTE))
    elif solution.candidates > 1:
        found.append((f"{solution.candidates} poses fit the spots", NOTE))
    return found


def _words(solution: Solution, title: str) -> list[Shape]:
    good = solution.pose is not None and solution.status != PREDICTED
    return [
        {"kind": "text", "at": [_LEFT_PX, LINE_PX * (row + 1) + 4], "text": text, "good": good, "part": part}
        for row, (text, part) in enumerate(lines(solution, title))
    ]


def _leds(scene: RingScene, solution: Solution, camera: int) -> list[Shape]:
    if solution.pose is None:
        return []
    r, arm, point = matrix_of(solution.pose.q_vt), np.empty(3), np.empty(3)
    found: list[Shape] = []
    for led in scene.leds:
        place(scene.rotation[camera], scene.translation[camera], r, solution.pose.t_v, led, arm, point)
        u, v = project(scene.lens[camera], point[0], point[1], point[2])
        if math.isfinite(u + v) and max(abs(u), abs(v)) < _FARTHEST_PX:
            found.append({"kind": "cross", "at": _at(u, v), "good": True, "part": LED})
    return found


def _spots(solution: Solution, camera: int) -> list[Shape]:
    """Return circles about the spots, those that are LEDs first, with their numbers."""
    names = {k: n for n, k in enumerate(solution.leds[camera]) if k >= 0}
    known: list[Shape] = []
    others: list[Shape] = []
    for k, spot in enumerate(solution.spots[camera]):
        u, v, radius = float(spot["u"]), float(spot["v"]), 3.0 * float(spot["size"]) + 4.0
        circle = {"kind": "circle", "at": _at(u, v), "radius": round(radius, 2), "good": k in names, "part": SPOT}
        if k not in names:
            others.append(circle)
            continue
        corner = [round(u + radius + 2), round(v - radius - 2)]
        number = {"kind": "text", "at": corner, "text": str(names[k]), "good": True, "part": IDENTITY}
        known += [circle, number]
    return [*known, *others]


def _at(u: float, v: float) -> list[float]:
    return [round(float(u), 2), round(float(v), 2)]
