"""NEES of a run at each pose, with the bounds within which a consistent filter has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.errors import BadInput
from hil.gnc.estimation.plane import filter_states
from hil.maths.chi_square import band_of_mean

NO_NEES: Final = "no pose, or a navigation of one's own, whose covariance the bench does not have"


@dataclass(frozen=True)
class Nees:
    """Normalised error squared of both filters at each cycle with a pose.

    t_s: (n,), s. position, attitude: (n,), nan without an IMU. states: of each filter, the expected means.
    position_bounds, attitude_bounds: two-sided bounds of the chi-square distribution, within which a single value of a
    consistent filter is with ``probability``. Values of successive poses are correlated: their mean has wider bounds
    than that of independent ones.
    """

    t_s: Array
    position: Array
    attitude: Array
    probability: float
    states: tuple[int, int]
    position_bounds: tuple[float, float]
    attitude_bounds: tuple[float, float]

    def inside(self, name: str) -> float:
        """Return the fraction of the values of a filter, ``position`` or ``attitude``, in its bounds; nan without."""
        if name not in ("position", "attitude"):
            raise BadInput.single("inside", "", f"{name!r}: must be position or attitude")
        values, (low, high) = getattr(self, name), getattr(self, f"{name}_bounds")
        known = values[np.isfinite(values)]
        return float(((low <= known) & (known <= high)).mean()) if len(known) else np.nan

    def __repr__(self) -> str:
        parts = (f"{name} {100.0 * self.inside(name):.1f} %" for name in ("position", "attitude"))
        return f"<Nees of {len(self.t_s)} poses, within the {100.0 * self.probability:g} % bounds: {', '.join(parts)}>"


def nees_of(history: np.ndarray, planar: bool, probability: float = 0.95) -> Nees:
    """Return the NEES in the rows of ``history`` (n,) of CYCLE that have one. planar: of a planar chaser."""
    rows = history[np.isfinite(history["nees_position"]) | np.isfinite(history["nees_attitude"])]
    states = filter_states(planar)
    position, attitude = (band_of_mean(1, n, 0.5 * (1.0 - probability)) for n in states)
    t_s, of_position, of_attitude = (rows[name].copy() for name in ("t_s", "nees_position", "nees_attitude"))
    return Nees(t_s, of_position, of_attitude, probability, states, position, attitude)
