"""The vision unit's columns in the rows of a run (CYCLE)."""

from __future__ import annotations

import numpy as np


def has_pose(rows: np.ndarray) -> np.ndarray:
    """Return in which of ``rows`` (n,) a pose arrived, (n,)."""
    fresh: np.ndarray = rows["pose"]["fresh"] > 0
    return fresh


def poses(rows: np.ndarray) -> np.ndarray:
    """Return the newest pose (POSE) of each of ``rows`` in which any arrived; ``fresh``: how many."""
    used: np.ndarray = rows["pose"][has_pose(rows)]
    return used


def travel_s(rows: np.ndarray) -> np.ndarray:
    """Return the time from the exposure of each of ``poses`` to the last byte of its frame, s."""
    used = rows[has_pose(rows)]
    delays: np.ndarray = used["received_s"] - used["pose"]["t_s"]
    return delays
