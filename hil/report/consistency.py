"""NEES of a run at each pose, with the bounds within which a consistent filter has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths.chi_square import band_of_mean

STATES: Final = {"position": 9, "attitude": 6}
"""Filter -> number of its states: the mean of its NEES if it is consistent."""


@dataclass(frozen=True)
class Nees:
    """Normalised error squared of both filters at each cycle with a pose.

    t_s: (n,), s. position: (n,), of 9 states; attitude: (n,), of 6 states, nan without an IMU. position_bounds,
    attitude_bounds: two-sided bounds of the chi-square distribution, within which a single value of a consistent filter
    is with ``probability``. Values of successive poses are correlated: their mean has wider bounds than that of
    independent ones.
    """

    t_s: Array
    position: Array
    attitude: Array
    probability: float
    position_bounds: tuple[float, float]
    attitude_bounds: tuple[float, float]

    def inside(self, name: str) -> float:
        """Return the fraction of the values of a filter, ``position`` or ``attitude``, in its bounds; nan without."""
        if name not in STATES:
            raise BadInput.single("nees", "", f"{name!r}: must be {' or '.join(STATES)}")
        values, (low, high) = getattr(self, name), getattr(self, f"{name}_bounds")
        known = values[np.isfinite(values)]
        return float(((low <= known) & (known <= high)).mean()) if len(known) else np.nan

    def __repr__(self) -> str:
        parts = (f"{name} {100.0 * self.inside(name):.1f} %" for name in ("position", "attitude"))
        return f"<Nees of {len(self.t_s)} poses, within the {100.0 * self.probability:g} % bounds: {', '.join(parts)}>"


def nees_of(history: np.ndarray, probability: float = 0.95) -> Nees:
    """Return the NEES in the rows of ``history`` (n,) of CYCLE that have one."""
    rows = history[np.isfinite(history["nees_position"]) | np.isfinite(history["nees_attitude"])]
    position, attitude = (band_of_mean(1, states, 0.5 * (1.0 - probability)) for states in STATES.values())
    t_s, of_position, of_attitude = (rows[name].copy() for name in ("t_s", "nees_position", "nees_attitude"))
    return Nees(t_s, of_position, of_attitude, probability, position, attitude)
