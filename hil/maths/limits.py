"""Limits of numbers, whole numbers, and dwell times of conditions."""

from __future__ import annotations

import math

from hil.core.jit import kernel


@kernel
def cut_to_range(values, low, high, out):
    """Write ``values`` (n,) limited to [low, high] into ``out``; return the first index that is not finite, or -1."""
    bad = -1
    for i in range(values.shape[0]):
        if not math.isfinite(values[i]) and bad < 0:
            bad = i
        out[i] = min(high[i], max(low[i], values[i]))
    return bad


@kernel
def to_integer(value):
    """Return ``value``, a whole number, as an integer."""
    return int(value)


@kernel
def has_held(since_s, now_s, dwell_s):
    """Return whether a condition that is true since ``since_s`` (nan: false) has held for ``dwell_s`` at ``now_s``."""
    return now_s - since_s >= dwell_s - 1e-9


def finite_or_none(value: float) -> float | None:
    """Return ``value``; None for a non-finite number, which JSON does not support."""
    return float(value) if math.isfinite(value) else None
