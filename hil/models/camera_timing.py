"""Timing of a free-running camera in simulated time: exposures, latency, loss and duplication of its poses."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths.limits import to_integer

TIME_SLACK_S = 1e-9  # sums of cycle times are off by a few 1e-16 of themselves
TRAVEL_DRAWS = 4  # uniform numbers in [0, 1) per frame: loss, duplication, first delay, second delay

TRAVEL = np.dtype(
    [
        ("latency_s", "f8"),  # constant part
        ("jitter_s", "f8"),  # largest random part, uniform
        ("duplicate_probability", "f8"),  # 0..1, of a duplicate frame
        ("loss_probability", "f8"),  # 0..1, of a lost frame
    ],
    align=True,
)


@kernel
def first_exposure(now_s, rate_hz):
    """Return the number k of the first exposure, at ``k / rate_hz``, at or after ``now_s``."""
    return to_integer(math.ceil((now_s - TIME_SLACK_S) * rate_hz))


@kernel
def exposure_time(number, rate_hz):
    """Return the time of exposure ``number``, s."""
    return number / rate_hz


@kernel
def delays(travel, draws, out):
    """Write the delays between exposure and arrival, s, to ``out`` (2,); return the number of arrivals, 0, 1 or 2.

    travel: TRAVEL. draws: (TRAVEL_DRAWS,), uniform in [0, 1).
    """
    for i in range(2):
        out[i] = travel.latency_s + draws[2 + i] * travel.jitter_s
    if draws[0] < travel.loss_probability:
        return 0
    return 2 if draws[1] < travel.duplicate_probability else 1
