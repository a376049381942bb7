"""Target detection in a region (the paper's third task): circles that may be the disc or the ship, and a first pose.

It does not rely on grey values: a hypothesis is a circle of the right size with the right pattern in it, dark on
bright or bright on dark, and is confirmed only by the measurement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.parts.monitor.features import TargetFeatures
from hil.parts.monitor.kernels.circle_detection import CircleCandidate, find_circles
from hil.parts.monitor.kernels.patterns import LARGEST_ROLL, Pattern, best_pattern, boxes_pattern, cross_pattern
from hil.parts.monitor.kernels.pose import UNKNOWNS
from hil.parts.monitor.polygon_detection import PolygonCandidate, find_polygons
from hil.parts.monitor.preprocess import Prepared
from hil.parts.monitor.settings import Region

Floats = NDArray[np.float64]

_LEAST_SCORE: Final = 0.55
_CIRCLES: Final = 16
_GOOD: Final = 0.8
_ENOUGH: Final = 3  # good hypotheses after which the search ends
_LARGEST_TURN: Final = math.radians(4.0)  # of the boxes relative to an outline with corners
_LARGEST_PASSIVE: Final = 0.2  # rad: largest parallax of the cross relative to the disc's centre


@dataclass(frozen=True)
class Hypothesis:
    """A first pose (15,) of a camera without errors; whether it is based on the cross on the disc; score, 0..1."""

    pose: Floats
    near: bool
    score: float


class TargetDetector:
    """Determines first poses of one target in front of one camera."""

    def __init__(self, features: TargetFeatures) -> None:
        self._features = features
        target = features.target
        self._cross: Pattern | None = cross_pattern(target) if target.cross is not None else None
        self._boxes: Pattern | None = None
        if target.outline is not None and target.boxes:
            self._boxes = boxes_pattern(target)
        self._corners: Floats | None = None
        if target.outline is not None and target.outline.corners_m:
            relative = np.array(target.outline.corners_m) - np.array(target.outline.middle_m)
            self._corners = relative / target.outline.mean_radius_m

    def hypotheses(self, prepared: Prepared, region: Region, first_line: float, line_step: float) -> list[Hypothesis]:
        """Return first poses, the best first.

        ``prepared``: the region of an image whose row r is line ``first_line + line_step r`` of the full image.
        """
        left, top = float(region.left), first_line + line_step * region.top
        guesses: list[Hypothesis] = []
        if self._corners is not None:
            for shape in find_polygons(prepared, left, top, line_step, self._corners):
                guess = self._as_polygon(shape, prepared, left, top, line_step)
                if guess is not None:
                    guesses.append(guess)
        for circle in find_circles(prepared, left, top, line_step)[:_CIRCLES]:
            for one in (self._as_disc, self._as_ship):
                guess = one(circle, prepared, left, top, line_step)
                if guess is not None:
                    guesses.append(guess)
            if sum(one.score > _GOOD for one in guesses) >= _ENOUGH:
                break
        return sorted(guesses, key=lambda one: one.score, reverse=True)

    def _as_disc(
        self, circle: CircleCandidate, prepared: Prepared, left: float, top: float, line_step: float
    ) -> Hypothesis | None:
        """Return the pose by the monitor paper 3.1 if the circle contains a cross."""
        target = self._features.target
        if target.disc is None or target.cross is None or self._cross is None or circle.coverage < 0.25:
            return None
        f = self._features.lens[0]
        r, b = target.disc.radius_m, target.cross.offset_m
        d3 = f * r / circle.radius
        if d3 < 1.2 * b:
            return None
        scale = f / (d3 - b)
        if scale * target.cross.arm_width_m < 1.2:
            return None
        reach = _LARGEST_PASSIVE * f * b / (d3 - b)
        half_width = max(0.5 * scale * target.cross.arm_width_m, 1.0)
        steps = int(min(np.ceil(reach / half_width), 8))
        out = np.zeros(3)
        centre = np.array([circle.u, circle.v])
        score = best_pattern(
            prepared.image, left, top, line_step, self._cross.points_m, self._cross.classes, centre, scale, reach,
            steps, 12, LARGEST_ROLL, out,
        )  # fmt: skip
        if abs(score) < _LEAST_SCORE:
            return None
        gain = d3 * (d3 - b) / (f * b)
        # the paper's relations, in the image axes rotated back by the roll
        c, s = np.cos(out[2]), np.sin(out[2])
        du, dv = out[0] - circle.u, out[1] - circle.v
        d1, d2 = -gain * (c * du + s * dv), -gain * (c * dv - s * du)
        return Hypothesis(self._pose(circle, d1, d2, d3, 0.0, float(out[2])), True, abs(score) * circle.coverage**0.25)

    def _as_ship(
        self, circle: CircleCandidate, prepared: Prepared, left: float, top: float, line_step: float
    ) -> Hypothesis | None:
        """Return the pose along the target's axis if the circle may be the ship's outline with its boxes."""
        target = self._features.target
        if target.outline is None or target.outline.radius_m is None:
            return None
        f = float(self._features.lens[0])
        depth = f * target.outline.radius_m / circle.radius
        roll, score = 0.0, 0.6
        if self._boxes is not None:
            nearer = depth + target.outline.offset_m - target.boxes[0].offset_m
            if nearer < 0.1 * depth:
                return None
            out = np.zeros(3)
            best_score = best_pattern(
                prepared.image, left, top, line_step, self._boxes.points_m, self._boxes.classes,
                np.array([circle.u, circle.v]), f / nearer, 0.06 * circle.radius, 2, 16, LARGEST_ROLL, out,
            )  # fmt: skip
            if abs(best_score) < _LEAST_SCORE:
                return None
            roll, score = float(out[2]), abs(best_score)
        d3 = depth + target.outline.offset_m
        if d3 < 0.2:
            return None
        pose = self._pose(circle, 0.0, 0.0, d3, target.outline.offset_m, roll, target.outline.center_m)
        return Hypothesis(pose, False, score * circle.coverage**0.25)

    def _as_polygon(
        self, shape: PolygonCandidate, prepared: Prepared, left: float, top: float, line_step: float
    ) -> Hypothesis | None:
        """Return the pose along the target's axis if the shape may be the ship's outline with its boxes."""
        outline, boxes = self._features.target.outline, self._features.target.boxes
        assert outline is not None
        f = float(self._features.lens[0])
        depth = f * outline.mean_radius_m / shape.radius
        roll, score = shape.roll, 1.0 - 4.0 * shape.misfit
        if self._boxes is not None:
            nearer = depth + outline.offset_m - boxes[0].offset_m
            if nearer < 0.1 * depth:
                return None
            c, s, out = math.cos(roll), math.sin(roll), np.zeros(3)
            points = self._boxes.points_m @ np.array([[c, s], [-s, c]])
            best_score = best_pattern(
                prepared.image, left, top, line_step, points, self._boxes.classes, np.array([shape.u, shape.v]),
                f / nearer, 0.06 * shape.radius, 2, 1, _LARGEST_TURN, out,
            )  # fmt: skip
            if abs(best_score) < _LEAST_SCORE:
                return None
            roll, score = roll + float(out[2]), score * abs(best_score)
        d3 = depth + outline.offset_m
        if d3 < 0.2:
            return None
        pose = self._pose(shape, 0.0, 0.0, d3, outline.offset_m, roll, outline.middle_m)
        return Hypothesis(pose, False, score)

    def _pose(
        self, circle: CircleCandidate | PolygonCandidate, d1: float, d2: float, d3: float, offset: float, roll: float,
        centre: tuple[float, float] = (0.0, 0.0),
    ) -> Floats:  # fmt: skip
        """Return the pose at d with that roll that projects point ``centre`` at ``offset`` to the circle's centre."""
        f, cx, cy = self._features.lens[:3]
        # A.T = exp(-[phi]x) diag(1, -1, -1): a roll of the image by +roll (u towards v) is phi3 = roll
        x3 = d3 - offset
        c, s = np.cos(roll), np.sin(roll)
        y1, y2 = centre[0] - d1, centre[1] - d2
        u, v = cx + f * (c * y1 - s * y2) / x3, cy + f * (s * y1 + c * y2) / x3
        # the rest is the pointing: phi2 moves the image along u, phi1 along v
        phi2 = -(circle.u - u) / f
        phi1 = -(circle.v - v) / f
        return np.array([d1, d2, d3, phi1, phi2, roll, *np.zeros(UNKNOWNS - 6)])
