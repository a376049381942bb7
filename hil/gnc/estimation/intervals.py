"""Mean interval between accepted measurements, in which a gap does not count."""

from __future__ import annotations

from hil.core.jit import kernel

_WEIGHT = 0.1  # weight of an interval in the mean


@kernel
def mean_interval(mean_s, interval_s):
    """Return the mean after ``interval_s``; 0 before the first one.

    A gap is no interval: what counts is how soon measurements follow each other.
    """
    mean = min(interval_s, 1.0) if mean_s == 0.0 else mean_s
    return mean + _WEIGHT * (min(interval_s, 2.0 * mean) - mean)
