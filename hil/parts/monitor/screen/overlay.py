"""Overlay of a docking monitor frame: region, circles, cross, edges and text, as shapes in pixels.

The monitor's screen draws them; the console's page and recordings use them as they are.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.camera_images import Shape
from hil.parts.monitor.results import FrameDetection, Portion

REGION, CIRCLE, CROSS, EDGE, STATUS, NUMBER = "region", "circle", "cross", "edge", "status", "number"
SEARCH: Final = "search"
"""Parts: region of interest, outline and disc, bars of the cross, measured points, lines of text; region of search."""

_DEG: Final = 180.0 / math.pi
NUMBERS: Final = (  # quantity, label, unit, display units per SI unit, decimals
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
_OVERLAID: Final = ("range_m", "range_rate_mps", "pitch_passive_rad", "yaw_passive_rad", "phi3_rad")
_MOST_EDGES: Final = 120
_LEFT_PX: Final = 8
_LINE_PX: Final = 17


def shapes(seen: FrameDetection) -> list[Shape]:
    """Return the shapes of the features detected in a frame, without its edges, in px of the full image."""
    drawn: list[Shape] = []
    good = not is_bad(seen.status)
    if seen.region is not None:
        drawn += _frame(seen.region, good, REGION)
    corners = [(float(u), float(v)) for u, v in seen.corners]
    drawn += _closed(corners, good, CIRCLE)
    for circle in (seen.outline, seen.disc):
        if circle is not None:
            drawn.append(
                {"kind": "circle", "at": _at(*circle[:2]), "radius": round(circle[2], 2), "good": good, "part": CIRCLE}
            )
    if seen.cross is not None:
        reach = max(0.8 * seen.disc[2], 12.0) if seen.disc is not None else 24.0
        across = np.array([math.cos(seen.cross[2]), -math.sin(seen.cross[2])])
        centre = np.array(seen.cross[:2])
        for arm in (across, np.array([-across[1], across[0]])):
            one, other = centre - reach * arm, centre + reach * arm
            drawn.append(_line((one[0], one[1]), (other[0], other[1]), good, CROSS))
    return drawn


def caption(seen: FrameDetection) -> str:
    """Return the caption of a frame, one line."""
    return f"{seen.status}   t = {seen.t_s:.2f} s   frame {seen.number}"


def annotated_shapes(
    seen: FrameDetection,
    portion: Portion | None,
    search: tuple[float, float, float, float] | None = None,
    warning: str = "",
) -> list[Shape]:
    """Return all shapes of a stand-alone image, the most important first.

    portion: the latest one, whose values are listed below the status. search: the operator's region of search, u, v,
    width, height, px. warning: text below the status. Of many edges only every n-th is shown.
    """
    lines = [(caption(seen), not is_bad(seen.status), STATUS), *_numbers(portion)]
    if warning:
        lines.insert(1, (warning, False, STATUS))
    texts: list[Shape] = [
        {"kind": "text", "at": [_LEFT_PX, _LINE_PX * (row + 1)], "text": text, "good": good, "part": part}
        for row, (text, good, part) in enumerate(lines)
    ]
    edges = np.asarray(seen.edges, float).reshape(-1, 2)
    edges = edges[np.isfinite(edges).all(axis=1)]
    step = max(1, -(-len(edges) // _MOST_EDGES))
    points: list[Shape] = [
        {"kind": "circle", "at": [round(float(u), 1), round(float(v), 1)], "radius": 1.0, "good": True, "part": EDGE}
        for u, v in edges[::step]
    ]
    frame = [] if search is None else _frame(search, True, SEARCH)
    return [*texts, *frame, *shapes(seen), *points]


def _numbers(portion: Portion | None) -> list[tuple[str, bool, str]]:
    if portion is None:
        return []
    rows = []
    for quantity, name, unit, factor, decimals in NUMBERS:
        if quantity in _OVERLAID and portion.observes(quantity):
            value, sigma = portion.value(quantity) * factor, portion.sigma(quantity) * factor
            rows.append((f"{name} {value:.{decimals}f} +- {sigma:.{decimals + 1}f} {unit}", True, NUMBER))
    return rows


def is_bad(status: str) -> bool:
    """Return whether a frame or portion of ``status`` has no values."""
    return status == "no_target" or status.startswith("rejected")


def _frame(box: tuple[float, float, float, float], good: bool, part: str) -> list[Shape]:
    """Return the sides of the rectangle u, v, width, height, px."""
    u, v, width, height = box
    return _closed([(u, v), (u + width, v), (u + width, v + height), (u, v + height)], good, part)


def _closed(corners: list[tuple[float, float]], good: bool, part: str) -> list[Shape]:
    """Return the sides of the polygon with these corners, px."""
    return [_line(one, other, good, part) for one, other in zip(corners, corners[1:] + corners[:1], strict=True)]


def _line(one: tuple[float, float], other: tuple[float, float], good: bool, part: str) -> Shape:
    return {"kind": "line", "from": _at(*one), "to": _at(*other), "good": good, "part": part}


def _at(u: float, v: float) -> list[float]:
    return [round(float(u), 2), round(float(v), 2)]
