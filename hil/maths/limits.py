"""Cutting numbers to what is allowed."""

from __future__ import annotations

import math

from hil.maths.jit import kernel


@kernel
def cut_to_range(values, low, high, out):
    """Write ``values`` (n,) cut to [low, high] into ``out``; return the first index that is not finite, or -1."""
    bad = -1
    for i in range(values.shape[0]):
        if not math.isfinite(values[i]) and bad < 0:
            bad = i
        out[i] = min(high[i], max(low[i], values[i]))
    return bad
