"""Error, gamma, and elliptic functions and the normal distribution, of elementary functions: the same bits everywhere.

scipy.special has them too, but its functions call the C library, and its import takes longer than a run; tests
compare them.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.core.formulas import formula
from hil.core.jit import kernel
from hil.maths import elementary

_SERIES_MAX: Final = 1.5  # above it a continued fraction converges
_TERMS: Final = 90  # of either, at that argument
_SPLIT: Final = 134217729.0  # 2^27 + 1 (Dekker 1971)
_ROOT_PI: Final = 1.772453850905516
_ROOT_HALF: Final = 0.7071067811865476
_LARGEST: Final = 27.3  # the complement beyond it is no float
_HALF_LOG_TWO_PI: Final = 0.9189385332046727
_STIRLING_MIN: Final = 12.0  # its series to x^-13 ends below 1e-17 of the result


@formula
def _normal_density(x: float) -> float:
    """Return exp(-``x``^2); the square's rounding error would grow with it, so its parts are multiplied."""
    scaled = _SPLIT * x
    high = scaled - (scaled - x)
    return elementary.exp(-high * high) * elementary.exp((high - x) * (high + x))


@formula
def erfc(x: float) -> float:
    """Return 1 - erf(``x``); relative error below 3e-14 (DLMF 7.6.2, 7.9.3)."""
    size = abs(x)
    if size < _SERIES_MAX:
        term = total = x
        n = 1.0
        while abs(term) > 1e-17 * abs(total):
            term *= 2.0 * x * x / (2.0 * n + 1.0)
            total += term
            n += 1.0
        return 1.0 - 2.0 / _ROOT_PI * _normal_density(x) * total
    if size != size:
        return math.nan
    if size > _LARGEST:
        tail = 0.0
    else:
        fraction = size
        for k in range(_TERMS, 0, -1):
            fraction = size + 0.5 * k / fraction
        tail = _normal_density(size) / (_ROOT_PI * fraction)
    return tail if x > 0.0 else 2.0 - tail


@formula
def normal_probability(z: float) -> float:
    """Return the probability that a standard normal variable is below ``z``."""
    return 0.5 * erfc(-_ROOT_HALF * z)


@kernel
def log_sum_exp(x: np.ndarray) -> float:
    """Return the logarithm of the sum of the exponentials of ``x`` (n,)."""
    largest = x[0]
    for i in range(x.shape[0]):
        largest = max(largest, x[i])
    total = 0.0
    for i in range(x.shape[0]):
        total += elementary.exp(x[i] - largest)
    value: float = largest + elementary.log(total)
    return value


@kernel
def _normal_probabilities(z, out):
    """Write ``normal_probability`` of ``z`` (n,) into ``out`` (n,), which may be ``z``."""
    for i in range(z.shape[0]):
        out[i] = normal_probability(z[i])


def normal_probabilities(z: Any, out: Any = None) -> Any:
    """Return ``normal_probability`` of each of the array ``z``, in ``out`` if it is given."""
    values = np.empty_like(z) if out is None else out
    _normal_probabilities(np.ravel(z), values.reshape(-1))
    return values


@formula
def normal_quantile(p: float) -> float:
    """Return what a standard normal variable is below with probability ``p``, 0..1 (Wichura 1988, AS 241, PPND16)."""
    q = p - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        above = 2509.0809287301226727 * r + 33430.575583588128105
        above = ((above * r + 67265.770927008700853) * r + 45921.953931549871457) * r + 13731.693765509461125
        above = ((above * r + 1971.5909503065514427) * r + 133.14166789178437745) * r + 3.387132872796366608
        below = 5226.495278852854561 * r + 28729.085735721942674
        below = ((below * r + 39307.89580009271061) * r + 21213.794301586595867) * r + 5394.1960214247511077
        below = ((below * r + 687.1870074920579083) * r + 42.313330701600911252) * r + 1.0
        return q * above / below
    tail = p if q < 0.0 else 1.0 - p
    if not tail > 0.0:
        return math.nan if tail != 0.0 else math.copysign(math.inf, q)
    r = math.sqrt(-elementary.log(tail))
    if r <= 5.0:
        r -= 1.6
        above = 7.7454501427834140764e-4 * r + 0.0227238449892691845833
        above = ((above * r + 0.24178072517745061177) * r + 1.27045825245236838258) * r + 3.64784832476320460504
        above = ((above * r + 5.7694972214606914055) * r + 4.6303378461565452959) * r + 1.42343711074968357734
        below = 1.05075007164441684324e-9 * r + 5.475938084995344946e-4
        below = ((below * r + 0.0151986665636164571966) * r + 0.14810397642748007459) * r + 0.68976733498510000455
        below = ((below * r + 1.6763848301838038494) * r + 2.05319162663775882187) * r + 1.0
    else:
        r -= 5.0
        above = 2.01033439929228813265e-7 * r + 2.71155556874348757815e-5
        above = ((above * r + 0.0012426609473880784386) * r + 0.026532189526576123093) * r + 0.29656057182850489123
        above = ((above * r + 1.7848265399172913358) * r + 5.4637849111641143699) * r + 6.6579046435011037772
        below = 2.04426310338993978564e-15 * r + 1.4215117583164458887e-7
        below = ((below * r + 1.8463183175100546818e-5) * r + 7.868691311456132591e-4) * r + 0.0148753612908506148525
        below = ((below * r + 0.13692988092273580531) * r + 0.59983220655588793769) * r + 1.0
    return math.copysign(above / below, q)


@formula
def log_gamma(x: float) -> float:
    """Return the logarithm of the gamma function of a positive ``x``, by Stirling's series (DLMF 5.11.1)."""
    product = 1.0
    while x < _STIRLING_MIN:
        product *= x
        x += 1.0
    z = 1.0 / (x * x)
    series = 1.0 / 1188.0 - z * (691.0 / 360360.0 - z * (1.0 / 156.0))
    series = 1.0 / 12.0 - z * (1.0 / 360.0 - z * (1.0 / 1260.0 - z * (1.0 / 1680.0 - z * series)))
    return ((x - 0.5) * elementary.log(x) - x) + (_HALF_LOG_TWO_PI + series / x) - elementary.log(product)


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
