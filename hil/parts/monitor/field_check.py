"""Whether frames that the scene declares whole hold two fields, exposed half a period apart.

The even and the odd lines of a frame, measured alone, then give poses that differ by half a period of the motion. That
is compared with no difference, which whole frames have, by the likelihood of all frames so far. While the target hardly
moves there is nothing to see, and nothing that it would disturb.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from hil.config.scene import Scene
from hil.parts.monitor.motion import Motion

Floats = NDArray[np.float64]

_DECIDED: Final = 24.0  # twice the logarithm of the ratio of the likelihoods
_FEWEST: Final = 4  # frames
_FREEDOM: Final = 6.0


@dataclass(frozen=True)
class FieldDifference:
    """Pose by the odd lines of a frame minus that by the even ones, (6,), m and rad, and its information (6, 6)."""

    apart: Floats
    information: Floats


class FieldCheck:
    """Decides between whole frames and fields of either order. order: as in a scene file, "" until it is found.

    decided: no more differences are needed.
    """

    def __init__(self, scene: Scene) -> None:
        self._half_s = 0.5 / scene.fps
        self._squares = np.zeros(3)  # of whole frames, upper field first, lower field first
        self._count = 0
        self._waiting: list[FieldDifference] = []
        self.order: Literal["", "upper_first", "lower_first"] = ""
        self.decided = scene.fields != "whole"

    @property
    def warning(self) -> str:
        """What to change in the scene, "" if nothing."""
        return f'frames hold two fields: set fields = "{self.order}" in the scene' if self.order else ""

    def add(self, difference: FieldDifference | None) -> None:
        """Keep a frame's difference until its motion is known; None if a field could not be measured."""
        if difference is not None:
            self._waiting.append(difference)

    def drop(self) -> None:
        """Forget the frames whose motion is not known."""
        self._waiting.clear()

    def update(self, motion: Motion) -> None:
        """Judge the frames that were kept, which moved as ``motion``."""
        shift = self._half_s * motion.w[1::2]
        for one in self._waiting:
            for k, expected in enumerate((0.0 * shift, shift, -shift)):
                residual = one.apart - expected
                self._squares[k] += residual @ one.information @ residual
        self._count += len(self._waiting)
        self._waiting.clear()
        if self._count < _FEWEST:
            return
        # differences that no hypothesis explains, as of edges along the lines of an image, are the same in all frames
        # while the target moves slowly: they do not average out
        freedom = _FREEDOM * self._count
        excess = float(self._squares.min()) / freedom - 1.0 - 2.0 * math.sqrt(2.0 / freedom)
        whole, *others = self._squares / (1.0 + max(excess, 0.0) * self._count)
        best = min(others)
        if whole - best > _DECIDED:
            self.order = "upper_first" if best == others[0] else "lower_first"
        self.decided = abs(whole - best) > _DECIDED
