"""Scene of a run for a 3-D view in Foxglove: target, corridor and ready point in H, the chaser in its own frame.

Target and chaser are drawn schematically: a plate each, the chaser's as wide as its thrusters are apart.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from hil.core.files import parse_json
from hil.recording.foxglove import schema_of, time_of

_LINE_LIST: Final = 2  # of foxglove.LinePrimitive: each two points a line
_PLATE_M: Final = 0.1
_TARGET_M: Final = 0.6
_SIDES: Final = 24
_BLUE, _ORANGE, _GREY, _GREEN = (
    dict(zip("rgba", colour, strict=True))
    for colour in ((0.34, 0.71, 0.91, 0.6), (0.90, 0.62, 0.0, 0.9), (0.6, 0.6, 0.6, 0.8), (0.0, 0.62, 0.45, 0.6))
)
_ORIGIN: Final = np.zeros(3)


def scene_of(files: Mapping[str, str], time_ns: int) -> dict[str, Any] | None:
    """Return the scene of the recording with the attachments ``files``, name -> text; None if these lack it."""
    try:
        scenario = parse_json(files["scenario.json"])
        guidance, corridor = scenario["gnc"]["guidance"], scenario["gnc"]["corridor"]
        thrusters = scenario["chaser"]["thrusters"]
        axis = np.array(corridor["axis"], float)
        reach_m = float(np.linalg.norm(scenario["initial"]["position_m"]))
        cone = _cone(axis, reach_m, math.tan(math.radians(corridor["half_angle_deg"])), corridor["minimum_radius_m"])
        positions, directions = np.array(thrusters["position_m"], float), np.array(thrusters["direction"], float)
        extent = np.maximum(np.ptp(positions, axis=0), _PLATE_M)
        size, centre = np.array([_PLATE_M, extent[1], extent[2]]), positions.mean(axis=0)
        ready = np.array(guidance["ready_point_m"], float)
    except (ValueError, LookupError, TypeError):
        return None
    when = time_of(time_ns)
    target = _cube(-0.5 * _PLATE_M * axis, np.array([_PLATE_M, _TARGET_M, _TARGET_M]), axis, _ORANGE)
    arrows = [_arrow(p, d) for p, d in zip(positions, directions, strict=True)]
    return {
        "deletions": [],
        "entities": [
            _entity("target", "H", when, cubes=[target]),
            _entity("ready point", "H", when, spheres=[_solid(ready, np.full(3, 0.05), _identity(), _GREEN)]),
            _entity("corridor", "H", when, lines=[_lines(cone)]),
            _entity("chaser", "chaser", when, cubes=[_solid(centre, size, _identity(), _BLUE)], arrows=arrows),
        ],
    }


def _entity(name: str, frame: str, when: dict[str, int], **primitives: list[dict[str, Any]]) -> dict[str, Any]:
    empty: dict[str, Any] = {"metadata": [], "arrows": [], "cubes": [], "spheres": [], "lines": []}
    head = {"timestamp": when, "frame_id": frame, "id": name, "lifetime": time_of(0), "frame_locked": True}
    return head | empty | primitives


def _cone(axis: np.ndarray, length_m: float, slope: float, least_m: float) -> list[np.ndarray]:
    """Return pairs of points, each a line of the corridor's surface: rings and generators."""
    across = _across(axis)
    phase = np.linspace(0.0, 2.0 * math.pi, _SIDES, endpoint=False)
    circle = np.cos(phase)[:, None] * across[0] + np.sin(phase)[:, None] * across[1]
    ranges = sorted({0.0, min(least_m / slope, length_m), 0.5 * length_m, length_m})
    rings = [x * axis + max(least_m, slope * x) * circle for x in ranges]
    points: list[np.ndarray] = []
    for ring in rings:
        for i in range(_SIDES):
            points += [ring[i], ring[(i + 1) % _SIDES]]
    for before, after in itertools.pairwise(rings):
        for i in range(0, _SIDES, 3):
            points += [before[i], after[i]]
    return points


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors that are normal to ``axis`` and to each other."""
    other = np.eye(3)[int(np.abs(axis).argmin())]
    first = np.cross(axis, other)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _lines(points: list[np.ndarray]) -> dict[str, Any]:
    return {
        "type": _LINE_LIST,
        "pose": _pose(_ORIGIN, _identity()),
        "thickness": 1.0,
        "scale_invariant": True,
        "points": [_point(point) for point in points],
        "color": _GREY,
        "colors": [],
        "indices": [],
    }


def _cube(centre: np.ndarray, size: np.ndarray, axis: np.ndarray, colour: dict[str, float]) -> dict[str, Any]:
    """Return a plate of which x, its thickness, points along ``axis``."""
    return _solid(centre, size, _rotation_of_x(axis), colour)


def _solid(centre: np.ndarray, size: np.ndarray, q: list[float], colour: dict[str, float]) -> dict[str, Any]:
    return {"pose": _pose(centre, q), "size": _point(size), "color": colour}


def _arrow(position: np.ndarray, direction: np.ndarray) -> dict[str, Any]:
    """Return the arrow of a thruster's force on the vehicle."""
    return {
        "pose": _pose(position, _rotation_of_x(direction)),
        "shaft_length": 0.15,
        "shaft_diameter": 0.02,
        "head_length": 0.06,
        "head_diameter": 0.05,
        "color": _GREY,
    }


def _rotation_of_x(direction: np.ndarray) -> list[float]:
    """Return the rotation (x, y, z, w) that takes the x axis to the unit vector ``direction``."""
    if direction[0] < -1.0 + 1e-9:
        return [0.0, 0.0, 1.0, 0.0]
    q = np.array([0.0, -direction[2], direction[1], 1.0 + direction[0]])
    rotation: list[float] = (q / np.linalg.norm(q)).tolist()
    return rotation


def _identity() -> list[float]:
    return [0.0, 0.0, 0.0, 1.0]


def _pose(position: np.ndarray, q: list[float]) -> dict[str, Any]:
    return {"position": _point(position), "orientation": dict(zip("xyzw", q, strict=True))}


def _point(point: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", map(float, point), strict=True))


def _example() -> dict[str, Any]:
    """Return a scene with one item in each of its lists."""
    solid, line, when = _solid(_ORIGIN, _ORIGIN, _identity(), _GREY), _lines([_ORIGIN]), time_of(0)
    line |= {"colors": [_GREY], "indices": [0]}
    arrow = _arrow(_ORIGIN, np.array([1.0, 0.0, 0.0]))
    entity = _entity("", "", when, arrows=[arrow], cubes=[solid], spheres=[solid], lines=[line])
    entity["metadata"] = [{"key": "", "value": ""}]
    return {"deletions": [{"timestamp": when, "type": 0, "id": ""}], "entities": [entity]}


SCENE_SCHEMA: Final = schema_of("foxglove.SceneUpdate", _example())
