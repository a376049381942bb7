"""Elementary functions in a fixed order of IEEE 754 operations: the same bits on every computer.

The C library's functions differ in their last bits by its version and by the processor. These are sums, products,
quotients and square roots alone, without fused operations, so that code in C or lanes of several cases can repeat
them; each branch may also be a selection. Errors are below 2 ulp unless stated. Arguments are finite numbers: a nan
gives nan.

Python calls them as they are, kernels their compiled form (``hil.core.formulas``).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, TypeVar

import numpy as np

from hil.core.formulas import formula

TWO_PI: Final = 2.0 * math.pi
_LARGEST: Final = float(2**28)  # products of its quarter turns with the first three parts of pi / 2 are exact
_TWO_OVER_PI: Final = 0.6366197723675814
# pi / 2 = the sum of these; the first three have 25 bits each
_PART_1: Final = 1.5707963109016418
_PART_2: Final = 1.5893254712295857e-08
_PART_3: Final = 6.123233932053594e-17
_PART_4: Final = 6.36831716351095e-25
_QUARTER: Final = 0.25 * math.pi

_Number = TypeVar("_Number")

_LN_2_HIGH: Final = 0.6931471803691238  # 32 bits: its product with an exponent is exact
_LN_2_LOW: Final = 1.9082149292705877e-10
_LOG2_E: Final = 1.4426950408889634
_ROOT_HALF: Final = 0.7071067811865476
_EXP_MAX: Final = 709.782712893384
_EXP_MIN: Final = -745.1332191019412
_EXP_NORMAL: Final = 690.0  # neither 2^k nor the result is subnormal

# arc tangents of k / 8, and what their rounding has cut off
_ATAN: Final = (
    0.0, 0.12435499454676144, 0.24497866312686414, 0.35877067027057225, 0.4636476090008061,
    0.5585993153435624, 0.6435011087932844, 0.7188299996216245, 0.7853981633974483,
)  # fmt: skip
_ATAN_LOW: Final = (
    0.0, -3.1253241424539383e-18, 1.0698755618734451e-17, -2.4623815582638635e-17, 2.2698777452961687e-17,
    -5.4556305485916264e-18, 1.5834785051444286e-17, -2.1478388444456983e-17, 3.061616997868383e-17,
)  # fmt: skip
_HALF_PI_LOW: Final = 6.123233995736766e-17  # pi / 2 less its rounded value


@formula
def _sine(r: float, low: float) -> float:
    """Return sin(r + low) for ``r`` within +-pi / 4 and a ``low`` below its last bit, by the series to r^17."""
    z = r * r
    w = z * z
    even = -1.0 / 6.0 + w * (-1.0 / 5040.0 + w * (-1.0 / 39916800.0 + w * (-1.0 / 1307674368000.0)))
    odd = 1.0 / 120.0 + w * (1.0 / 362880.0 + w * (1.0 / 6227020800.0 + w * (1.0 / 355687428096000.0)))
    p = even + z * odd
    return r + (r * z * p + low * (1.0 - 0.5 * z))


@formula
def _cosine(r: float, low: float) -> float:
    """Return cos(r + low) for ``r`` within +-pi / 4 and a ``low`` below its last bit, by the series to r^18."""
    z = r * r
    w = z * z
    even = 1.0 / 24.0 + w * (1.0 / 40320.0 + w * (1.0 / 479001600.0 + w * (1.0 / 20922789888000.0)))
    odd = -1.0 / 720.0 + w * (-1.0 / 3628800.0 + w * (-1.0 / 87178291200.0 + w * (-1.0 / 6402373705728000.0)))
    p = even + z * odd
    half = 0.5 * z
    head = 1.0 - half
    return head + (((1.0 - head) - half) + (z * z * p - r * low))


@formula
def _reduce(x: float) -> tuple[int, float, float]:
    """Return the quadrant 0..3 and r, low within +-pi / 4 with x = quadrant pi / 2 + r + low, less whole turns.

    Beyond 2^28 rad x is first reduced by the rounded value of 2 pi, as its own last bit is 1e-8 rad there.
    """
    if not abs(x) < _LARGEST:
        if not abs(x) < math.inf:
            return 0, math.nan, math.nan
        x = math.copysign(abs(x) % TWO_PI, x)
    quarters = math.floor(x * _TWO_OVER_PI + 0.5)
    n = float(quarters)
    # sums of two numbers with their rounding error (Knuth 1969)
    first, b = x - n * _PART_1, n * _PART_2
    second = first - b
    back = second - first
    error = (first - (second - back)) - (b + back)
    b = n * _PART_3
    third = second - b
    back = third - second
    error += (second - (third - back)) - (b + back) - n * _PART_4
    r = third + error
    return quarters & 3, r, (third - r) + error


@formula
def sin(x: float) -> float:
    """Return the sine of ``x``, rad."""
    if abs(x) <= _QUARTER:
        return _sine(x, 0.0)
    quadrant, r, low = _reduce(x)
    value = _cosine(r, low) if quadrant & 1 else _sine(r, low)
    return -value if quadrant & 2 else value


@formula
def cos(x: float) -> float:
    """Return the cosine of ``x``, rad."""
    if abs(x) <= _QUARTER:
        return _cosine(x, 0.0)
    quadrant, r, low = _reduce(x)
    value = _sine(r, low) if quadrant & 1 else _cosine(r, low)
    return -value if (quadrant + 1) & 2 else value


@formula
def tan(x: float) -> float:
    """Return the tangent of ``x``, rad; within 3 ulp."""
    return sin(x) / cos(x)


@formula
def atan2(y: float, x: float) -> float:
    """Return the angle of the vector (``x``, ``y``), -pi..pi rad.

    The arc tangent of the nearest k / 8 is added to that of the difference, the series of which ends with d^15.
    """
    across, along = abs(y), abs(x)
    small, large = min(across, along), max(across, along)
    if large == 0.0:
        angle, low = 0.0, 0.0
    else:
        ratio = small / large
        if not ratio <= 1.0:
            return math.nan
        k = math.floor(8.0 * ratio + 0.5)
        step = 0.125 * k
        d = (small - step * large) / (large + step * small)
        z = d * d
        w = z * z
        even = 1.0 / 3.0 + w * (1.0 / 7.0 + w * (1.0 / 11.0 + w * (1.0 / 15.0)))
        odd = 1.0 / 5.0 + w * (1.0 / 9.0 + w * (1.0 / 13.0))
        p = even - z * odd
        low = _ATAN_LOW[k] - d * z * p
        angle = _ATAN[k] + (d + low)
        low = (_ATAN[k] - angle) + (d + low)
    if across > along:
        angle, low = 0.5 * math.pi - angle, _HALF_PI_LOW - low
    if math.copysign(1.0, x) < 0.0:
        angle, low = math.pi - angle, 2.0 * _HALF_PI_LOW - low
    return math.copysign(angle + low, y)


@formula
def atan(x: float) -> float:
    """Return the arc tangent of ``x``, rad."""
    return atan2(x, 1.0)


@formula
def asin(x: float) -> float:
    """Return the arc sine of ``x``, rad; nan beyond +-1; within 3 ulp."""
    square = (1.0 - x) * (1.0 + x)
    return atan2(x, math.sqrt(square)) if square >= 0.0 else math.nan


@formula
def acos(x: float) -> float:
    """Return the arc cosine of ``x``, rad; nan beyond +-1; within 3 ulp."""
    square = (1.0 - x) * (1.0 + x)
    return atan2(math.sqrt(square), x) if square >= 0.0 else math.nan


@formula
def square(x: _Number) -> _Number:
    """Return ``x`` times ``x``, a number or an array; Python leaves powers to the C library."""
    return x * x  # type: ignore[operator,no-any-return]


@formula
def hypot(x: float, y: float) -> float:
    """Return the length of the vector (``x``, ``y``), whose square is neither too large nor too small for a float."""
    return math.sqrt(x * x + y * y)


@formula
def _expm1_small(r: float) -> float:
    """Return exp(r) - 1 for ``r`` within half of ln 2, by the series to r^14."""
    z = r * r
    even = 1.0 / 120.0 + z * (1.0 / 5040.0 + z * (1.0 / 362880.0 + z * (1.0 / 39916800.0 + z * (1.0 / 6227020800.0))))
    odd = 1.0 / 720.0 + z * (
        1.0 / 40320.0 + z * (1.0 / 3628800.0 + z * (1.0 / 479001600.0 + z * (1.0 / 87178291200.0)))
    )
    p = 1.0 / 6.0 + r * (1.0 / 24.0 + (r * even + z * odd))
    return r + z * (0.5 + r * p)


@formula
def exp(x: float) -> float:
    """Return the exponential of ``x``; inf above 709.78, 0 below -745.13."""
    if x != x:
        return math.nan
    if x > _EXP_MAX:
        return math.inf
    if x < _EXP_MIN:
        return 0.0
    k = math.floor(x * _LOG2_E + 0.5)
    high, low = x - k * _LN_2_HIGH, k * _LN_2_LOW
    r = high - low
    low = (high - r) - low
    mantissa = 1.0 + (_expm1_small(r) + low * (1.0 + r))
    if abs(x) < _EXP_NORMAL:
        return mantissa * float(np.int64((k + 1023) << 52).view(np.float64))  # 2^k by its bits
    return math.ldexp(mantissa, k)


@formula
def expm1(x: float) -> float:
    """Return exp(``x``) - 1; within 4 ulp."""
    return _expm1_small(x) if abs(x) < 0.34 else exp(x) - 1.0


@formula
def log(x: float) -> float:
    """Return the natural logarithm of ``x``; -inf of 0, nan of less.

    By the series of the inverse hyperbolic tangent of f / (2 + f), 1 + f being the mantissa within sqrt(2) of 1.
    """
    if not x > 0.0:
        return -math.inf if x == 0.0 else math.nan
    if x == math.inf:
        return math.inf
    mantissa, k = math.frexp(x)
    if mantissa < _ROOT_HALF:
        mantissa, k = 2.0 * mantissa, k - 1
    f = mantissa - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    even = 2.0 / 3.0 + w * (2.0 / 7.0 + w * (2.0 / 11.0 + w * (2.0 / 15.0 + w * (2.0 / 19.0 + w * (2.0 / 23.0)))))
    odd = 2.0 / 5.0 + w * (2.0 / 9.0 + w * (2.0 / 13.0 + w * (2.0 / 17.0 + w * (2.0 / 21.0))))
    p = even + z * odd
    half = 0.5 * f * f
    # log(1 + f) = f - half + s (half + z p)
    return k * _LN_2_HIGH - ((half - (s * (half + z * p) + k * _LN_2_LOW)) - f)


@formula
def log1p(x: float) -> float:
    """Return the natural logarithm of 1 + ``x``; the rounding of the sum cancels (Kahan); within 3 ulp."""
    u = 1.0 + x
    if u == 1.0:
        return x
    return log(u) * (x / (u - 1.0)) if u < math.inf else log(u)


@formula
def power(x: float, y: float) -> float:
    """Return ``x``^``y`` of a positive ``x``, with a relative error of about |y log x| 1e-16; 0 if ``x`` is 0."""
    return exp(y * log(x)) if x > 0.0 else 0.0


def each(function: Callable[[float], float], values: Any) -> np.ndarray:
    """Return ``function`` of each number of ``values``, in their shape."""
    numbers = np.asarray(values, dtype=float)
    return np.array([function(x) for x in numbers.ravel().tolist()]).reshape(numbers.shape)
