"""Jacobi's elliptic functions, and the integral that they invert."""

from __future__ import annotations

import math
from typing import Final

from hil.core.formulas import formula
from hil.core.jit import kernel
from hil.maths import elementary

STEPS: Final = 8  # of Landen, each of which squares the modulus
_CIRCULAR: Final = 1e-16  # a modulus for which the functions are those of a circle
_DUPLICATED: Final = 2e-3  # the series is truncated at its sixth power


@kernel
def landen_moduli(m, moduli):
    """Write the descending moduli for the parameter ``m``, 0 to below 1, into ``moduli`` (STEPS,); return their number.

    Descending Landen transformation (DLMF 22.7.2 to 22.7.4).
    """
    n, complement = 0, math.sqrt(1.0 - m)
    modulus = math.sqrt(m)
    while modulus > _CIRCULAR and n < STEPS:
        larger = 1.0 + complement
        modulus = modulus * modulus / (larger * larger)  # (1 - k') / (1 + k'), without its cancellation
        moduli[n] = modulus
        complement = 2.0 * math.sqrt(complement) / larger
        n += 1
    return n


@kernel
def jacobi_into(u, moduli, n, out):
    """Write sn, cn and dn of ``u`` into ``out`` (3,), from the first ``n`` of ``landen_moduli``."""
    for k in range(n):
        u /= 1.0 + moduli[k]
    sn, cn, dn = elementary.sin(u), elementary.cos(u), 1.0
    while n > 0:
        n -= 1
        part = moduli[n] * sn * sn
        scale = 1.0 / (1.0 + part)
        sn, cn, dn = (1.0 + moduli[n]) * sn * scale, cn * dn * scale, (1.0 - part) * scale
    out[0], out[1], out[2] = sn, cn, dn


@formula
def _symmetric(x: float, y: float, z: float) -> float:
    """Return Carlson's R_F of ``x``, ``y``, ``z``, at most one of them zero, by duplication (DLMF 19.36.1)."""
    while True:
        mean = (x + y + z) / 3.0
        dx, dy, dz = 1.0 - x / mean, 1.0 - y / mean, 1.0 - z / mean
        if max(abs(dx), abs(dy), abs(dz)) < _DUPLICATED:
            break
        root = math.sqrt(x) * math.sqrt(y) + math.sqrt(y) * math.sqrt(z) + math.sqrt(z) * math.sqrt(x)
        x, y, z = 0.25 * (x + root), 0.25 * (y + root), 0.25 * (z + root)
    second, third = dx * dy - dz * dz, dx * dy * dz
    series = 1.0 - second / 10.0 + third / 14.0 + second * second / 24.0 - 3.0 * second * third / 44.0
    return series / math.sqrt(mean)


@formula
def first_kind(phi: float, m: float) -> float:
    """Return the incomplete elliptic integral of the first kind of ``phi``, rad, for the parameter ``m`` below 1."""
    half_turns = math.floor(phi / math.pi + 0.5)
    s, c = elementary.sin(phi), elementary.cos(phi)
    s = -s if half_turns % 2 else s
    whole = 2.0 * half_turns * _symmetric(0.0, 1.0 - m, 1.0) if half_turns else 0.0
    return whole + s * _symmetric(c * c, 1.0 - m * s * s, 1.0)
