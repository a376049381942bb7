"""Validation of a measured target: support by enough of each feature's edges, uniform polarity, labels, scatter.

A frame that fails gives no values. Grey values are not used, only the polarity of edges and the noise.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.config.scene import CameraTolerances
from hil.parts.monitor.features import ACROSS, BOX, DISC, LABEL, OUTLINE, PLATE, UPRIGHT, TargetFeatures
from hil.parts.monitor.kernels.edge_samples import ARCS, SIDES
from hil.parts.monitor.kernels.pose import ASPECT, DISTORTION, FOCAL, GROWTH, POINT_U, TONE

Floats = NDArray[np.float64]

_SUPPORT: Final = 0.5  # fraction of a feature's samples that must agree with the pose
_ONE_SENSE: Final = 0.9  # fraction of a feature's samples of equal polarity
_LARGEST_SCATTER_PX: Final = 0.35
_LARGEST_ANGLE: Final = 0.7  # rad
_LARGEST_PASSIVE: Final = 0.4
_FARTHEST_M: Final = 500.0
_LARGEST_GROWTH_PX: Final = 0.5
_CAMERA_SIGMAS: Final = 5.0
_UNKNOWNS: Final = (  # of the camera: first and number of them, tolerance, unit and scale
    (TONE, 3, "tone_px", "px", 1.0),
    (FOCAL, 1, "focal_fraction", "%", 100.0),
    (ASPECT, 1, "aspect_fraction", "%", 100.0),
    (POINT_U, 2, "principal_point_px", "px", 1.0),
    (DISTORTION, 1, "distortion_px", "px", 1.0),
)
_LEAST_STEP: Final = 4.0  # height of a step in noise sigmas
_TURNED_PX: Final = 5.0  # displacement of an edge by a turn of the ship that shows
_FEWEST_TURNED: Final = 8  # samples of such edges
_VISIBLE: Final = 6  # samples of a part that has to be found


class Validation:
    """Statistics of one measured frame, per feature."""

    def __init__(self, features: TargetFeatures, samples: NDArray[np.void], residuals: Floats, noise: float) -> None:
        n = features.feature_count
        feature = samples["feature"]
        used = samples["good"] == 1
        self.samples, self.used, self._residuals = samples, used, residuals
        self.placed = np.bincount(feature, minlength=n)
        self.good = np.bincount(feature[used], minlength=n)
        step = samples["high"] - samples["low"]
        sense = np.sign(step)
        total = np.bincount(feature[used], weights=sense[used], minlength=n)
        height = np.bincount(feature[used], weights=np.abs(step[used]), minlength=n)
        with np.errstate(invalid="ignore", divide="ignore"):
            same = 0.5 * (1.0 + np.abs(total) / self.good)
            high = height / self.good
            share = self.good / self.placed
        for bar in (ACROSS, UPRIGHT):
            share[bar] = self._of_better_border(features, bar, float(share[bar]))
        self.supported = (share >= _SUPPORT) & (same >= _ONE_SENSE) & (high >= _LEAST_STEP * noise)
        self.visible = self.placed > 0

    def _of_better_border(self, features: TargetFeatures, bar: int, share: float) -> float:
        """Return the fraction of agreeing samples of the border that has more of them: a shadow may hide the other."""
        chosen = self.samples["feature"] == bar
        side = (self.samples["cluster"] - ARCS * len(features.circles)) % SIDES
        placed = np.bincount(side[chosen], minlength=SIDES)
        good = np.bincount(side[chosen & self.used], minlength=SIDES)
        enough = placed > 0.5 * placed.max(initial=0)
        return max(share, float((good[enough] / placed[enough]).max())) if enough.any() else share

    def scatter_px(self) -> float:
        """Return the RMS of the used points' residuals, px, in excess of their own noise."""
        samples, used = self.samples, self.used
        square = np.mean(self._residuals[used] ** 2) - np.mean(samples["variance"][used])
        return float(np.sqrt(max(square, 0.0)))


def excluded_turns(
    features: TargetFeatures, verdict: Validation, labels: Floats, noise: float, metres_per_px: float
) -> NDArray[np.bool_]:
    """Return whether the ship is not rolled by 90, 180 and 270 deg more (3,), where its cross would look the same.

    A roll is excluded by edges, or by a label, that would be elsewhere. labels: contrasts, grey values, nan
    for other circles.
    """
    n = len(features.circles)
    cluster = verdict.samples["cluster"]
    edge = np.where(cluster < ARCS * n, cluster // ARCS, n + (cluster - ARCS * n) // SIDES)
    confirmed = verdict.supported[verdict.samples["feature"]]
    shown = np.zeros(features.partner_m.shape[1], bool)
    shown[:n] = np.abs(np.nan_to_num(labels)) > _LEAST_STEP * noise
    out = np.zeros(3, bool)
    for k, apart in enumerate(features.partner_m > _TURNED_PX * metres_per_px):
        here = apart[edge] & confirmed
        good = np.count_nonzero(here & verdict.used)
        out[k] = (good >= _FEWEST_TURNED and good >= _SUPPORT * np.count_nonzero(here)) or bool((apart & shown).any())
    return out


def is_implausible(x: Floats) -> bool:
    """Return whether the pose (15,) is outside the range of an approach."""
    return (
        not np.all(np.isfinite(x))
        or not 0.05 < x[2] < _FARTHEST_M
        or bool(np.any(np.abs(x[3:6]) > _LARGEST_ANGLE))
        or max(abs(x[0]), abs(x[1])) > _LARGEST_PASSIVE * x[2]
    )


def camera_contradiction(x: Floats, tolerances: CameraTolerances) -> str:
    """Return what the pose (15,) finds of the camera beyond its tolerances, and what to do; "" if it fits."""
    if abs(x[GROWTH]) > _LARGEST_GROWTH_PX:
        return f"edges grow by {x[GROWTH]:+.1f} px, allowed {_LARGEST_GROWTH_PX:g}: focus, or overexposed"
    worst, text = 1.0, ""
    for first, count, key, unit, scale in _UNKNOWNS:
        sigma = getattr(tolerances, key)
        value = x[np.arange(first, first + count)][np.argmax(np.abs(x[first : first + count]))]
        if sigma > 0.0 and (ratio := abs(value) / (_CAMERA_SIGMAS * sigma)) > worst:
            worst, allowed = ratio, _CAMERA_SIGMAS * sigma
            name = key.rpartition("_")[0].replace("_", " ")
            text = f"{name} {scale * value:+.2g} {unit}, allowed {scale * allowed:.2g}: state {key}, or calibrate"
    return text


def near_rejection(features: TargetFeatures, verdict: Validation, labels: Floats, noise: float) -> str:
    """Return why the near features do not confirm the target, "" if they do. labels: contrasts, grey values."""
    supported, placed, good = verdict.supported, verdict.placed, verdict.good
    for bar in (ACROSS, UPRIGHT):
        if not supported[bar] or good[bar] < 2:
            return "cross"
    if placed[DISC] >= 6 and not supported[DISC]:
        return "disc"
    if verdict.scatter_px() > _LARGEST_SCATTER_PX:
        return "scatter"
    if np.sum(placed[BOX:]) >= _VISIBLE and not np.any(supported[BOX:]):
        return "boxes"
    shown = labels[np.isfinite(labels)]
    confirmed = False
    if len(shown) >= 2:
        strong = np.abs(shown) > 2.0 * noise
        agreeing = max(int(np.sum(strong & (shown > 0.0))), int(np.sum(strong & (shown < 0.0))))
        if agreeing < max(2, (len(shown) + 1) // 2):
            return "labels"
        confirmed = True
    if supported[PLATE] and good[PLATE] >= 6:
        confirmed = True
    if supported[OUTLINE] or supported[LABEL] or bool(np.any(supported[BOX:])):
        confirmed = True
    return "" if confirmed else "unconfirmed"


def far_rejection(features: TargetFeatures, verdict: Validation) -> str:
    """Return why outline and boxes do not confirm the target, "" if they do."""
    supported, placed = verdict.supported, verdict.placed
    boxes = supported[BOX:]
    if features.target.outline is not None:
        if placed[OUTLINE] < 6 or not supported[OUTLINE]:
            return "outline"
    elif not supported[DISC]:
        return "disc"
    if verdict.scatter_px() > _LARGEST_SCATTER_PX:
        return "scatter"
    others = int(np.sum(boxes)) + int(supported[PLATE]) + (int(supported[DISC]) if features.target.outline else 0)
    if features.target.boxes and np.any(verdict.visible[BOX:]) and not np.any(boxes):
        return "boxes"
    return "" if others >= 1 else "unconfirmed"
