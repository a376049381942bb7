"""Frames of a portion that do not show its motion: displaced, as after a loss of the vertical sync, or repeated.

Within a portion the target moves uniformly, but for vibration. Frames off the line on which most of them are do not
show its motion, nor do those that stand still while the others move.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.models import docking_view
from hil.parts.monitor.results import FrameResult

_Chosen = NDArray[np.bool_]

DISPLACED: Final = "image displaced"
_REACH_PX: Final = 8.0  # four sigma of the largest vibration
_FEWEST: Final = 4
_APART: Final = 60.0  # chi-square of six components, from which on two poses differ
_ALIKE: Final = 25.0  # and up to which they do not


def displaced(frames: Sequence[FrameResult], focal_px: float) -> _Chosen:
    """Return which of the used ``frames`` are displaced (n,): all if no more than half of them agree."""
    n = len(frames)
    if n < _FEWEST:
        return np.zeros(n, bool)
    t = np.array([frame.detection.t_s for frame in frames])
    origin = np.zeros(3)
    seen = [docking_view.to_camera(docking_view.attitude(f.pose[3:6]), f.pose[:3], origin) for f in frames]
    pixels = focal_px * np.array([x[:2] / x[2] for x in seen])
    one, two = np.triu_indices(n, 1)
    rates = (pixels[two] - pixels[one]) / (t[two] - t[one])[:, None]
    expected = pixels[one, None] + rates[:, None] * (t[None, :] - t[one, None])[..., None]
    agreeing = np.abs(pixels[None] - expected).max(axis=2) < _REACH_PX
    best = agreeing[np.argmax(agreeing.sum(axis=1))]
    return np.asarray(~best if 2 * best.sum() > n else np.ones(n, bool))


def off_the_line(t: NDArray[np.float64], poses: NDArray[np.float64], information: NDArray[np.float64]) -> _Chosen:
    """Return which poses (n, 6) at the times ``t`` (n,) are not on the line of most of them (n,); none without one.

    information: (n, 6, 6), of each pose.
    """
    one, two = np.triu_indices(len(t), 1)
    share = (t - t[one, None]) / (t[two] - t[one])[:, None]
    gaps = poses - (poses[one, None] + share[..., None] * (poses[two] - poses[one])[:, None])
    squares = np.einsum("pki,kij,pkj->pk", gaps, information, gaps) / (1.0 + share**2 + (1.0 - share) ** 2)
    squares[np.arange(len(one)), one] = squares[np.arange(len(one)), two] = 0.0
    agreeing = squares < _APART
    best = int(np.argmax(agreeing.sum(axis=1) - np.where(agreeing, squares, _APART).sum(axis=1) / (len(t) * _APART)))
    return np.asarray(~agreeing[best] & (2 * agreeing[best].sum() > len(t)))


def repeated(poses: NDArray[np.float64], information: NDArray[np.float64]) -> _Chosen:
    """Return which poses (n, 6) are those before them, within their noise (n,), as in a video that stands still."""
    gaps = np.diff(poses, axis=0)
    both = np.linalg.inv(np.linalg.inv(information[1:]) + np.linalg.inv(information[:-1]))
    return np.append(False, np.einsum("ki,kij,kj->k", gaps, both, gaps) < _ALIKE)
