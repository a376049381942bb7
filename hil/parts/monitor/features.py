"""Measurable features of a target: circles and straight edges in the frame C, as arrays for the kernels."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil.config.scene import SceneCamera, Target

Floats = NDArray[np.float64]

DISC, ACROSS, UPRIGHT, PLATE, OUTLINE, LABEL, BOX = range(7)
"""Features; box i has the number BOX + i."""

_EDGE_GROUP = 1000  # beyond the numbers of the features

CIRCLE = np.dtype(
    [("y1", "f8"), ("y2", "f8"), ("y3", "f8"), ("radius", "f8"), ("feature", "i8"), ("group", "i8")], align=True
)
"""A circle parallel to the disc: centre, m, in C; radius, m."""

LINE = np.dtype(
    [
        ("a1", "f8"), ("a2", "f8"), ("b1", "f8"), ("b2", "f8"), ("y3", "f8"),
        ("width", "f8"), ("feature", "i8"), ("group", "i8"),
    ],
    align=True,
)  # fmt: skip
"""A straight edge from a to b, m, in the plane y3; ``width``: 0, or the width of the bar with this centre line, m.

The outside of an edge is to the right of the direction from a to b, as seen from the camera at y3 > 0.
"""


@dataclass(frozen=True)
class TargetFeatures:
    """Features of one target and one camera, for the kernels.

    lens: (5,): f, cx, cy, width, height, px. circles, lines: measured edges. borders: (n,) LINE, all straight
    borders: measurements keep a distance from other borders. feature_count: number of feature numbers. cross: (3,):
    offset, arm length, arm width, m; zeros without a cross. partner_m: (3, circles + lines), distance of each measured
    edge, m, from the nearest equal one of the target rolled by 90, 180 and 270 deg: 0 if that does not show in it.
    """

    lens: Floats
    circles: NDArray[np.void]
    lines: NDArray[np.void]
    borders: NDArray[np.void]
    feature_count: int
    cross: Floats
    target: Target
    partner_m: Floats


def target_features(camera: SceneCamera, target: Target) -> TargetFeatures:
    """Return the measurable features of ``target`` for ``camera``."""
    circles: list[tuple[float, ...]] = []
    lines: list[tuple[float, ...]] = []
    borders: list[tuple[float, ...]] = []
    if target.disc is not None:
        circles.append((0.0, 0.0, 0.0, target.disc.radius_m, DISC, DISC))
    if target.outline is not None and target.outline.radius_m is not None:
        c1, c2 = target.outline.center_m
        circles.append((c1, c2, target.outline.offset_m, target.outline.radius_m, OUTLINE, OUTLINE))
    elif target.outline is not None:
        edges = _polygon(target.outline.ordered_corners_m, target.outline.offset_m)
        lines += edges
        borders += edges
    if target.labels is not None:
        for number, (c1, c2) in enumerate(target.labels.centers_m):
            circles.append((c1, c2, 0.0, target.labels.radius_m, LABEL, -1 - number))
    if target.plate is not None:
        edges = _rectangle(0.0, 0.0, target.plate.width_m, target.plate.height_m, target.plate.offset_m, PLATE)
        lines += edges
        borders += edges
    for number, box in enumerate(target.boxes):
        edges = _rectangle(box.x_m, box.y_m, box.width_m, box.height_m, box.offset_m, BOX + number)
        lines += edges
        borders += edges
    cross = np.zeros(3)
    if target.cross is not None:
        cross[:] = target.cross.offset_m, target.cross.arm_length_m, target.cross.arm_width_m
        half, arm, y3 = 0.5 * cross[2], cross[1], cross[0]
        for feature, (e1, e2) in ((ACROSS, (1.0, 0.0)), (UPRIGHT, (0.0, 1.0))):
            for way in (1.0, -1.0):
                ends = (way * half * e1, way * half * e2, way * arm * e1, way * arm * e2)
                lines.append((*ends, y3, cross[2], feature, ACROSS))
        borders += [
            *_rectangle(0.0, 0.0, 2.0 * arm, cross[2], y3, ACROSS),
            *_rectangle(0.0, 0.0, cross[2], 2.0 * arm, y3, ACROSS),
        ]
    lens = np.array([camera.f, camera.cx, camera.cy, camera.width, camera.height], float)
    features = BOX + len(target.boxes)
    tables = _table(circles, CIRCLE), _table(lines, LINE), _table(borders, LINE)
    return TargetFeatures(lens, *tables, features, cross, target, _partners(*tables[:2]))


def quarter_rolled(target: Target) -> Target:
    """Return ``target`` rolled by 90 deg about y3: the same cross, and its other parts elsewhere."""

    def turned(places: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        return tuple((-y2, y1) for y1, y2 in places)

    parts: dict[str, object] = {}
    if (plate := target.plate) is not None:
        parts["plate"] = plate.model_copy(update={"width_m": plate.height_m, "height_m": plate.width_m})
    if (labels := target.labels) is not None:
        parts["labels"] = labels.model_copy(update={"centers_m": turned(labels.centers_m)})
    if (outline := target.outline) is not None:
        corners = turned(outline.corners_m) if outline.corners_m else outline.corners_m
        parts["outline"] = outline.model_copy(update={"center_m": turned((outline.center_m,))[0], "corners_m": corners})
    parts["boxes"] = tuple(
        box.model_copy(update={"x_m": -box.y_m, "y_m": box.x_m, "width_m": box.height_m, "height_m": box.width_m})
        for box in target.boxes
    )
    return target.model_copy(update=parts)


def _partners(circles: NDArray[np.void], lines: NDArray[np.void]) -> Floats:
    """Return ``partner_m`` of TargetFeatures."""
    ends = np.array([[row["a1"] + 1j * row["a2"], row["b1"] + 1j * row["b2"]] for row in lines]).reshape(-1, 2)
    centres = np.array([[row["y1"] + 1j * row["y2"], row["radius"]] for row in circles], complex).reshape(-1, 2)
    apart = [
        [
            abs(part[:, None, 0] - turn * part[None, :, 0]) + abs(part[:, None, 1] - other * part[None, :, 1])
            for part, other in ((centres, 1.0), (ends, turn))
        ]
        for turn in (1j, -1.0, -1j)
    ]
    return np.array([np.concatenate([each.min(axis=1, initial=np.inf) for each in kinds]) for kinds in apart])


def _rectangle(x: float, y: float, width: float, height: float, y3: float, feature: int) -> list[tuple[float, ...]]:
    """Return the four edges, counter-clockwise as seen by the camera: the outside is to the right."""
    x0, x1, y0, y1 = x - 0.5 * width, x + 0.5 * width, y - 0.5 * height, y + 0.5 * height
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    return [(*a, *b, y3, 0.0, feature, feature) for a, b in pairwise(corners)]


def _polygon(corners: tuple[tuple[float, float], ...], y3: float) -> list[tuple[float, ...]]:
    """Return the edges of the outline, a group each: near a corner the other edge is another border."""
    pairs = pairwise([*corners, corners[0]])
    return [(*a, *b, y3, 0.0, OUTLINE, _EDGE_GROUP + number) for number, (a, b) in enumerate(pairs)]


def _table(rows: list[tuple[float, ...]], kind: np.dtype[np.void]) -> NDArray[np.void]:
    return np.array(rows, dtype=kind)
