"""Patterns in a circle: the cross on the disc, the boxes on the ship, scored by correlation with the grey values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.config.scene import Target
from hil.core.jit import kernel

Floats = NDArray[np.float64]

LARGEST_ROLL: Final = math.radians(40.0)  # the cross is symmetric under 90 deg


@dataclass(frozen=True)
class Pattern:
    """Points (n, 2), m, relative to the pattern's middle, with class +1 or -1 (n,)."""

    points_m: Floats
    classes: Floats


def cross_pattern(target: Target) -> Pattern:
    """Return points on the cross (+1) and next to its bars (-1)."""
    assert target.cross is not None
    arm, half = target.cross.arm_length_m, 0.5 * target.cross.arm_width_m
    along = np.linspace(0.15, 0.92, 9) * arm
    rows, classes = [], []
    for e in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
        n = (-e[1], e[0])
        for t in along:
            for side, kind in ((0.0, 1.0), (-0.45 * half, 1.0), (0.45 * half, 1.0)):
                rows.append((t * e[0] + side * n[0], t * e[1] + side * n[1]))
                classes.append(kind)
            gap = max(2.4 * half, 0.0)
            if t > gap + half:
                for side in (-gap, gap):
                    rows.append((t * e[0] + side * n[0], t * e[1] + side * n[1]))
                    classes.append(-1.0)
        rows.append((1.0 * e[0] * (arm + 1.4 * half), e[1] * (arm + 1.4 * half)))
        classes.append(-1.0)
    return Pattern(np.array(rows), np.array(classes))


def boxes_pattern(target: Target) -> Pattern:
    """Return points on the boxes (+1) and around them (-1), relative to the outline's middle."""
    assert target.outline is not None
    c1, c2 = target.outline.middle_m
    rows, classes = [], []
    for box in target.boxes:
        grid = np.linspace(-0.42, 0.42, 5)
        for a in grid:
            for b in grid:
                rows.append((box.x_m + a * box.width_m - c1, box.y_m + b * box.height_m - c2))
                classes.append(1.0)
            for side in (-0.62, 0.62):
                rows.append((box.x_m + side * box.width_m - c1, box.y_m + a * box.height_m - c2))
                rows.append((box.x_m + a * box.width_m - c1, box.y_m + side * box.height_m - c2))
                classes += [-1.0, -1.0]
    return Pattern(np.array(rows).reshape(-1, 2), np.array(classes))


@kernel
def pattern_score(image, left, top, line_step, points, classes, u, v, scale, roll):
    """Return the correlation of the grey values at the pattern's points with their classes, -1..1.

    image: (h, w), uint8, its first pixel at (left, top). scale: px/m. roll: rad, of the pattern in the image.
    """
    c, s = math.cos(roll) * scale, math.sin(roll) * scale
    n, plus = 0, 0
    total, square, high = 0.0, 0.0, 0.0
    for i in range(points.shape[0]):
        column = math.floor(u + c * points[i, 0] - s * points[i, 1] - left + 0.5)
        row = math.floor((v + s * points[i, 0] + c * points[i, 1] - top) / line_step + 0.5)
        if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
            value = float(image[row, column])
            n += 1
            total += value
            square += value * value
            if classes[i] > 0.0:
                plus += 1
                high += value
    minus = n - plus
    if plus < 6 or minus < 6 or n < 0.35 * points.shape[0]:
        return 0.0
    variance = square / n - (total / n) ** 2
    if variance < 4.0:
        return 0.0
    gap = high / plus - (total - high) / minus
    return gap * math.sqrt(plus * minus) / n / math.sqrt(variance)


@kernel
def best_pattern(image, left, top, line_step, points, classes, centre, scale, reach, steps, rolls, largest_roll, out):
    """Search the pattern around ``centre`` (2,), px, and refine; write (u, v, roll) to ``out``; return the correlation.

    reach: px in each direction, in ``steps`` steps; rolls: number of steps in each direction up to largest_roll.
    """
    best = 0.0
    for i in range(-steps, steps + 1):
        for j in range(-steps, steps + 1):
            if i * i + j * j > steps * steps + 1:
                continue
            u, v = centre[0] + reach * i / max(steps, 1), centre[1] + reach * j / max(steps, 1)
            for k in range(-rolls, rolls + 1):
                roll = largest_roll * k / max(rolls, 1)
                score = pattern_score(image, left, top, line_step, points, classes, u, v, scale, roll)
                if abs(score) > abs(best):
                    best = score
                    out[0], out[1], out[2] = u, v, roll
    if best == 0.0:
        return 0.0
    step, turn = reach / max(steps, 1), largest_roll / max(rolls, 1)
    for _ in range(4):
        step *= 0.5
        turn *= 0.5
        u0, v0, roll0 = out[0], out[1], out[2]
        for i in range(-1, 2):
            for j in range(-1, 2):
                for k in range(-1, 2):
                    u, v, roll = u0 + step * i, v0 + step * j, roll0 + turn * k
                    score = pattern_score(image, left, top, line_step, points, classes, u, v, scale, roll)
                    if abs(score) > abs(best):
                        best = score
                        out[0], out[1], out[2] = u, v, roll
    return best
