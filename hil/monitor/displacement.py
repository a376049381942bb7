"""Displaced images: frames of a portion whose target is elsewhere, as after a loss of the vertical sync.

Within a portion the target's image moves uniformly, but for vibration. Frames off the line on which most of them are do
not show its motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.models import docking_view
from hil.monitor.results import FrameResult

DISPLACED: Final = "image displaced"
_REACH_PX: Final = 8.0  # four sigma of the largest vibration
_FEWEST: Final = 4


def displaced(frames: Sequence[FrameResult], focal_px: float) -> NDArray[np.bool_]:
    """Return which of the used ``frames`` are displaced (n,): all if no more than half of them agree."""
    n = len(frames)
    if n < _FEWEST:
        return np.zeros(n, bool)
    t = np.array([frame.detection.t_s for frame in frames])
    origin = np.zeros(3)
    seen = [docking_view.to_camera(docking_view.attitude(f.pose[3:6]), f.pose[:3], origin) for f in frames]
    place = focal_px * np.array([x[:2] / x[2] for x in seen])
    one, two = np.triu_indices(n, 1)
    rates = (place[two] - place[one]) / (t[two] - t[one])[:, None]
    expected = place[one, None] + rates[:, None] * (t[None, :] - t[one, None])[..., None]
    agreeing = np.abs(place[None] - expected).max(axis=2) < _REACH_PX
    best = agreeing[np.argmax(agreeing.sum(axis=1))]
    return np.asarray(~best if 2 * best.sum() > n else np.ones(n, bool))
