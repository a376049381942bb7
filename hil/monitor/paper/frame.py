"""The paper's measurements of a frame: cross centre by two orthogonal lines, circle by Gauss-Newton (section 3).

Image axes as in 3.1: X = u - cx to the right, Y = cy - v up. In them the bar across has the slope a = -phi3; the
second residual is ``U + a V - c2`` and the centre ``((a c1 + c2), (a c2 - c1)) / (1 + a^2)``
(docs/explanation/papers.md).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.monitor.features import ACROSS, DISC, UPRIGHT
from hil.monitor.kernels.edge_samples import BAR
from hil.monitor.results import PaperFrame

Floats = NDArray[np.float64]

_TURNS: Final = 8
_FEWEST: Final = 2


def cross_centre(across: Floats, upright: Floats) -> tuple[Floats, Floats]:
    """Return (X_C, Y_C, a) and their covariance (3, 3) by linear least squares on two orthogonal lines.

    across, upright: (n, 4): X, Y, px, the variance across the bar, px^2, and the side of the bar (-1, 1; 0 for points
    of its centre line). The half widths of the bars are unknowns too, so that pairs of points contribute their middle.
    """
    wide = bool(np.any(across[:, 3] != 0.0)), bool(np.any(upright[:, 3] != 0.0))
    rows = np.zeros((len(across) + len(upright), 5))
    first, second = rows[: len(across)], rows[len(across) :]
    # a X - c1 = Y and a Y' - c2 = -X', the unknowns (a, c1, c2, half width across, half width upright)
    first[:, 0], first[:, 1], first[:, 3] = across[:, 0], -1.0, across[:, 3]
    second[:, 0], second[:, 2], second[:, 4] = upright[:, 1], -1.0, upright[:, 3]
    right = np.concatenate((across[:, 1], -upright[:, 0]))
    keep = [True, True, True, *wide]
    weights = 1.0 / np.concatenate((across[:, 2], upright[:, 2]))
    used = rows[:, keep]
    normal = used.T @ (weights[:, None] * used)
    covariance = np.linalg.inv(normal)[:3, :3]
    a, c1, c2 = np.linalg.solve(normal, used.T @ (weights * right))[:3]
    scale = 1.0 + a * a
    x, y = (a * c1 + c2) / scale, (a * c2 - c1) / scale
    slopes = np.array([
        [(c1 - 2.0 * a * x) / scale, a / scale, 1.0 / scale],
        [(c2 - 2.0 * a * y) / scale, -1.0 / scale, a / scale],
        [1.0, 0.0, 0.0],
    ])  # fmt: skip
    return np.array([x, y, a]), slopes @ covariance @ slopes.T


def first_circle(points: Floats) -> Floats:
    """Return (X, Y, R) of a circle by linear least squares on its equation; points (n, 2)."""
    middle = points.mean(axis=0)
    local = points - middle
    rows = np.column_stack((2.0 * local, np.ones(len(points))))
    x, y, c = np.linalg.lstsq(rows, np.sum(local**2, axis=1), rcond=None)[0]
    return np.array([x + middle[0], y + middle[1], np.sqrt(c + x * x + y * y)])


def circle(points: Floats, variances: Floats) -> tuple[Floats, Floats]:
    """Return (X_O, Y_O, R) and their covariance (3, 3), px, by Gauss-Newton on Phi_2; points (n, 2), variances (n,)."""
    found = first_circle(points)
    weights = 1.0 / variances
    normal = np.eye(3)
    for _ in range(_TURNS):
        from_centre = points - found[:2]
        distance = np.hypot(from_centre[:, 0], from_centre[:, 1])
        rows = np.column_stack((from_centre / distance[:, None], np.ones(len(points))))
        normal = rows.T @ (weights[:, None] * rows)
        step = np.linalg.solve(normal, rows.T @ (weights * (distance - found[2])))
        found = found + step
        if np.max(np.abs(step)) < 1e-9:
            break
    return found, np.asarray(np.linalg.inv(normal))


def paper_frame(lens: Floats, samples: Any) -> PaperFrame | None:
    """Return X_C, Y_C, a, X_O, Y_O, R of the measured samples, or None if there are too few."""
    used = samples["good"] == 1
    x = samples["u"] + samples["shift"] * samples["nu"] - lens[1]
    y = lens[2] - samples["v"] - samples["shift"] * samples["nv"]
    bars = []
    for bar in (ACROSS, UPRIGHT):
        chosen = used & (samples["feature"] == bar)
        if chosen.sum() < _FEWEST:
            return None
        # outwards is up (right) on one side of a bar and down (left) on the other
        outwards = -samples["nv"][chosen] if bar == ACROSS else -samples["nu"][chosen]
        side = np.where(samples["kind"][chosen] == BAR, 0.0, np.sign(outwards))
        bars.append(np.column_stack((x[chosen], y[chosen], samples["variance"][chosen], side)))
    disc = used & (samples["feature"] == DISC)
    if disc.sum() < 2 * _FEWEST + 2:
        return None
    try:
        cross, cross_covariance = cross_centre(*bars)
        round_, round_covariance = circle(np.column_stack((x[disc], y[disc])), samples["variance"][disc])
    except np.linalg.LinAlgError:
        return None
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = cross_covariance, round_covariance
    values = np.concatenate((cross, round_))
    return PaperFrame(values, covariance) if np.all(np.isfinite(values)) else None
