"""Doubt about a pose whose LEDs may be mirrored by a plate behind them, or partly hidden."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.vmu.kernels.records import RingScene, View
from hil.vmu.kernels.reflections import mirrored, odd_light

REFLECTION: Final = "reflection"
DOUBLED: Final = "doubled_lights"
PARTLY_HIDDEN: Final = "partly_hidden"

_RATIO: Final = 1.5  # of variances with 15 or more degrees of freedom: lenses with coma, halo, tails stay below 1.4
_ODD: Final = 6.0  # sigmas of an LED's elongation
_ALLOWED: Final = 0.5  # sigma of a component of the pose, by which the lights may displace it


@dataclass(frozen=True, slots=True)
class Doubt:
    """What makes a pose ``suspect``. amount: how much of it, in ``unit``; NaN if it is not known."""

    what: str
    amount: float = math.nan
    unit: str = ""

    def __str__(self) -> str:
        return self.what if math.isnan(self.amount) else f"{self.what} {self.amount:.3g} {self.unit}"


def doubt_of_lights(scene: RingScene, view: View, fit: np.void) -> Doubt | None:
    """Return the doubt if the LEDs of the pose ``fit`` are mirrored behind themselves, or an edge cuts one of them.

    The spot of an LED behind an edge is displaced alike in both images: no residual needs to show it.
    """
    shows, depth, ratio, moved = mirrored(scene, view, fit)
    if shows:
        return Doubt(REFLECTION)
    if ratio > _RATIO and moved > _ALLOWED:
        return Doubt(DOUBLED, 1e3 * depth, "mm")
    led, sigmas = odd_light(scene, view, fit)
    return Doubt(PARTLY_HIDDEN, led, "(LED)") if sigmas > _ODD else None
