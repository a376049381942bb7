"""Rows of faults, as kernels read them: when a fault acts, its size, and random numbers that need no stream.

A table of faults is a record FAULTS: its first ``n`` rows. A fault acts in [at, until) of the run's time.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_FAULTS
from hil.maths import elementary
from hil.models.camera_timing import TIME_SLACK_S

KIND, NUMBER, AT, UNTIL, VALUE, SIZE, OPTION = 0, 1, 2, 3, 4, 7, 8
"""Columns of a row. NUMBER: of thruster or axis. VALUE: the first of three, SI. SIZE: of an outlier, m, or the least
light of visible LEDs, 1/m^2. OPTION: sensor, or stamp."""
COLUMNS = 9
SEED_BITS = 0x7FFF_FFFF_FFFF_FFFF
"""Of a seed: those that a signed number holds."""
AT_ARRIVAL = 1.0
"""Option of a latency: what comes late is stamped with its arrival."""

FAULTS = np.dtype([("n", "i8"), ("seed", "i8"), ("row", "f8", (MAX_FAULTS, COLUMNS))], align=True)

_GOLDEN, _MIX_1, _MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


@kernel
def is_active(row, t_s):
    """Return whether the fault of ``row`` (COLUMNS,) acts at ``t_s`` of the run."""
    return row[AT] <= t_s + TIME_SLACK_S and t_s + TIME_SLACK_S < row[UNTIL]


@kernel
def _mixed(x):
    """Return ``x``, uint64, through the finaliser of SplitMix64 (Steele, Lea, Flood 2014)."""
    x = (x ^ (x >> _30)) * _MIX_1
    x = (x ^ (x >> _27)) * _MIX_2
    return x ^ (x >> _31)


@kernel
def uniform(seed, number, lane):
    """Return a number in (0, 1) that depends on the three integers alone, which are not negative."""
    state = _mixed(np.uint64(seed) + _GOLDEN)
    state = _mixed(state ^ (np.uint64(number) + _GOLDEN))
    state = _mixed(state ^ (np.uint64(lane) + _GOLDEN))
    return (float(state >> _11) + 0.5) / 9007199254740992.0


@kernel
def normal(seed, number, lane):
    """Return a standard normal number that depends on the three integers alone (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * elementary.log(uniform(seed, number, 2 * lane)))
    return radius * elementary.cos(2.0 * math.pi * uniform(seed, number, 2 * lane + 1))


@kernel
def displace_at_random(probability, size, seed, number, lane, position):
    """Displace ``position`` (3,), m, by ``size`` in a random direction, with ``probability``."""
    if uniform(seed, number, lane) >= probability:
        return
    height = 2.0 * uniform(seed, number, lane + 1) - 1.0
    angle = 2.0 * math.pi * uniform(seed, number, lane + 2)
    level = math.sqrt(1.0 - height * height)
    position[0] += size * level * elementary.cos(angle)
    position[1] += size * level * elementary.sin(angle)
    position[2] += size * height
