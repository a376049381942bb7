"""Doubt about a pose whose LEDs may be mirrored by a plate behind them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.vmu.kernels.records import RingScene, View
from hil.vmu.kernels.reflections import mirrored

REFLECTION: Final = "reflection"
DOUBLED: Final = "doubled_lights"

_RATIO: Final = 1.5  # of variances with 15 or more degrees of freedom: lenses with coma, halo, tails stay below 1.4
_ALLOWED: Final = 0.5  # sigma of a component of the pose, by which the lights may displace it


@dataclass(frozen=True, slots=True)
class Doubt:
    """What makes a pose ``suspect``. amount: how much of it, in ``unit``; NaN if it is not known."""

    what: str
    amount: float = math.nan
    unit: str = ""

    def __str__(self) -> str:
        return self.what if math.isnan(self.amount) else f"{self.what} {self.amount:.3g} {self.unit}"


def reflection(scene: RingScene, view: View, fit: np.void) -> Doubt | None:
    """Return the doubt if something shows that the LEDs of the pose ``fit`` are mirrored behind themselves."""
    shows, depth, ratio, moved = mirrored(scene, view, fit)
    if shows:
        return Doubt(REFLECTION)
    return Doubt(DOUBLED, 1e3 * depth, "mm") if ratio > _RATIO and moved > _ALLOWED else None
