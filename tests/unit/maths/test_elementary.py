"""Elementary functions against the C library in long double, and their compiled form against Python's."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.core.jit import kernel
from hil.maths import elementary

N = 4000
CASES: dict[str, tuple[float, float, float]] = {
    "sin": (-30.0, 30.0, 1.0),
    "cos": (-30.0, 30.0, 1.0),
    "tan": (-30.0, 30.0, 3.0),
    "atan": (-9.0, 9.0, 2.0),
    "asin": (-1.0, 1.0, 3.0),
    "acos": (-1.0, 1.0, 3.0),
    "exp": (-700.0, 700.0, 1.5),
    "expm1": (-3.0, 3.0, 4.0),
    "log": (1e-9, 1e9, 1.0),
    "log1p": (-0.99, 9.0, 3.0),
}
"""Range of the arguments, and largest error in units of the last place."""
NAMES = {"atan": "arctan", "asin": "arcsin", "acos": "arccos"}


def _arguments(rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    even = rng.uniform(low, high, N)
    return np.concatenate([even, np.clip(10.0 ** rng.uniform(-12.0, 0.0, N), low, high)])


@pytest.mark.parametrize("name", CASES)
def test_error_is_of_the_order_of_the_last_place(rng: np.random.Generator, name: str) -> None:
    low, high, ulps = CASES[name]
    x = _arguments(rng, low, high)
    exact = getattr(np, NAMES.get(name, name))(x.astype(np.longdouble))
    own = np.array([getattr(elementary, name)(float(v)) for v in x])
    assert np.max(np.abs(own - exact) / np.spacing(np.abs(exact.astype(float)))) < ulps


def test_angle_of_a_vector_is_right_in_all_directions_and_sizes(rng: np.random.Generator) -> None:
    y, x = (rng.choice([-1.0, 1.0], N) * 10.0 ** rng.uniform(-9.0, 9.0, N) for _ in range(2))
    exact = np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble))
    own = np.array([elementary.atan2(*pair) for pair in zip(y.tolist(), x.tolist(), strict=True)])
    assert np.max(np.abs(own - exact) / np.spacing(np.abs(exact.astype(float)))) < 2.0


@pytest.mark.parametrize("y", [0.0, -0.0, 1.0, -1.0])
@pytest.mark.parametrize("x", [0.0, -0.0, 1.0, -1.0])
def test_angle_on_the_axes_has_the_signs_of_ieee_754(x: float, y: float) -> None:
    assert elementary.atan2(y, x).hex() == math.atan2(y, x).hex()


def test_large_angles_keep_their_last_place() -> None:
    near = [float(n) * 0.5 * math.pi for n in (1, 3, 10**3, 10**6 + 1, 2**27)]
    for x in [*near, 1e5, 1e8, -2.6e8]:
        assert abs(elementary.sin(x) - math.sin(x)) <= math.ulp(math.sin(x))
        assert abs(elementary.cos(x) - math.cos(x)) <= math.ulp(math.cos(x))


def test_angles_without_an_own_last_place_stay_within_one() -> None:
    for x in (1e12, 1e300, -1e17):
        assert elementary.sin(x) ** 2 + elementary.cos(x) ** 2 == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("function", "x", "value"),
    [
        (elementary.exp, 710.0, math.inf),
        (elementary.exp, -746.0, 0.0),
        (elementary.exp, -740.0, math.exp(-740.0)),
        (elementary.log, 0.0, -math.inf),
        (elementary.log, 5e-324, math.log(5e-324)),
        (elementary.log, math.inf, math.inf),
        (elementary.log1p, -1.0, -math.inf),
        (elementary.expm1, -800.0, -1.0),
        (elementary.asin, 1.0, 0.5 * math.pi),
        (elementary.acos, -1.0, math.pi),
    ],
)
def test_ends_of_the_ranges(function: Callable[[float], float], x: float, value: float) -> None:
    assert function(x) == value


@pytest.mark.parametrize("name", [*CASES, "square"])
def test_not_a_number_stays_one(name: str) -> None:
    assert math.isnan(getattr(elementary, name)(math.nan))


@pytest.mark.parametrize(("name", "x"), [("log", -1.0), ("asin", 1.1), ("acos", -1.1), ("sin", math.inf)])
def test_arguments_outside_give_not_a_number(name: str, x: float) -> None:
    assert math.isnan(getattr(elementary, name)(x))


@pytest.mark.parametrize(("x", "y"), [(0.3, 2.5), (0.99, 40.0), (7.0, -1.5)])
def test_power_is_that_of_the_c_library(x: float, y: float) -> None:
    assert elementary.power(x, y) == pytest.approx(x**y, rel=1e-14)
    assert elementary.power(0.0, y) == 0.0


def test_array_is_evaluated_in_its_shape() -> None:
    x = np.array([[0.0, 1.0], [2.0, 3.0]])
    assert np.array_equal(elementary.each(elementary.exp, x), [[elementary.exp(v) for v in row] for row in x.tolist()])


@kernel
def _all(x, out):
    for i in range(x.shape[0]):
        out[i, 0], out[i, 1], out[i, 2] = elementary.sin(x[i]), elementary.cos(x[i]), elementary.atan2(x[i], 0.7)
        out[i, 3], out[i, 4] = elementary.exp(x[i]), elementary.log(abs(x[i]))
        out[i, 5], out[i, 6] = elementary.log1p(abs(x[i])), elementary.expm1(x[i])


def test_kernels_and_python_give_the_same_bits(rng: np.random.Generator) -> None:
    x = np.concatenate([rng.uniform(-2.0, 2.0, 1000), rng.uniform(-500.0, 500.0, 1000), rng.uniform(-1e8, 1e8, 200)])
    compiled, python = np.empty((len(x), 7)), np.empty((len(x), 7))
    _all(x, compiled)
    _all.py_func(x.astype(object), python)  # numbers of Python
    assert compiled.tobytes() == python.tobytes()
