"""Machines that are built wrong, and the observations of their poses."""

from __future__ import annotations

import numpy as np

from hil.config.rig import Rig
from hil.config.tables.machine import NAMES, PARAMETERS
from hil.core.messages import Array
from hil.parts.geometry.model import MachineModel, with_noise
from hil.parts.geometry.observations import PoseObservations

_M, _DEG = 1e-3, float(np.radians(0.05))
TRACKER_SIGMA = np.array([1e-4] * 3 + [float(np.radians(0.01))] * 3)
TWELVE = (
    ("x_straightness_m[0]", _M), ("y_straightness_m[2]", _M), ("z_straightness_m[0]", _M),
    ("x_rotation_deg[0]", _DEG), ("y_rotation_deg[3]", _DEG), ("z_rotation_deg[6]", _DEG),
    ("squareness_deg[0]", _DEG), ("squareness_deg[1]", _DEG), ("squareness_deg[2]", _DEG),
    ("middle_m", _M), ("middle_deg[0]", _DEG), ("camera_m[1]", _M),
)  # fmt: skip
"""Straightness and roll of each rail, squareness, gimbals that do not meet and are not orthogonal, hand-eye."""


def twelve_errors(seed: int) -> Array:
    """Return the parameters (PARAMETERS,) of a machine with twelve errors of 1 mm or 0.05 deg, of random signs."""
    rng, vector = np.random.default_rng(seed), np.zeros(PARAMETERS)
    for name, size in TWELVE:
        vector[NAMES.index(name)] = size * rng.choice([-1.0, 1.0])
    return vector


def observed(model: MachineModel, vector: Array, axes: Array, sigma: Array, source: str, seed: int) -> PoseObservations:
    """Return observations at ``axes`` (n, 6) with white noise ``sigma``, (6,) or (n, 6)."""
    n = len(axes)
    sigmas = np.broadcast_to(sigma, (n, 6)).copy()
    value = with_noise(model.observed(vector, axes, source), sigmas, np.random.default_rng(seed))
    return PoseObservations(np.arange(n), axes, value, sigmas, np.full(n, source))


def axes_within(rig: Rig, n: int, seed: int) -> Array:
    """Return axes (n, 6), m and rad, within the travel of ``rig``, many of them at its ends."""
    low, high = np.array([axis.limits[:2] for axis in (*rig.rails.axes, *rig.turntable.axes)]).T
    rng = np.random.default_rng(seed)
    axes = rng.uniform(low, high, (n, 6))
    ends: Array = np.where(rng.uniform(size=(n, 6)) < 0.35, np.where(rng.uniform(size=(n, 6)) < 0.5, low, high), axes)
    return ends
