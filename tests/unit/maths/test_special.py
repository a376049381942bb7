"""Error function, normal distribution and gamma function against scipy, and a known generator of normals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import special as scipy_special

from hil.maths import special
from hil.maths.normals import Generator


def test_complement_of_the_error_function(rng: np.random.Generator) -> None:
    x = rng.uniform(-6.0, 5.0, 3000)
    own = np.array([special.erfc(float(v)) for v in x])
    np.testing.assert_allclose(own, scipy_special.erfc(x), rtol=5e-14)
    assert (special.erfc(math.inf), special.erfc(-math.inf)) == (0.0, 2.0)
    assert math.isnan(special.erfc(math.nan))


def test_normal_distribution(rng: np.random.Generator) -> None:
    z = rng.uniform(-9.0, 9.0, 3000)
    np.testing.assert_allclose(special.normal_probabilities(z), scipy_special.ndtr(z), rtol=5e-14)
    p = np.concatenate([rng.random(3000), 10.0 ** rng.uniform(-300.0, -1.0, 1000)])
    own = np.array([special.normal_quantile(float(v)) for v in p])
    np.testing.assert_allclose(own, scipy_special.ndtri(p), rtol=2e-15, atol=2e-16)


@pytest.mark.parametrize(("p", "z"), [(0.0, -math.inf), (1.0, math.inf), (0.5, 0.0)])
def test_ends_of_the_normal_distribution(p: float, z: float) -> None:
    assert special.normal_quantile(p) == z


def test_logarithm_of_the_gamma_function(rng: np.random.Generator) -> None:
    x = np.concatenate([rng.uniform(0.05, 40.0, 2000), 10.0 ** rng.uniform(1.0, 8.0, 1000)])
    own = np.array([special.log_gamma(float(v)) for v in x])
    np.testing.assert_allclose(own, scipy_special.gammaln(x), rtol=1e-14, atol=2e-14)


def test_logarithm_of_a_sum_of_exponentials(rng: np.random.Generator) -> None:
    x = rng.uniform(-900.0, 900.0, 500)
    assert special.log_sum_exp(x) == pytest.approx(float(scipy_special.logsumexp(x)), rel=1e-14)


def test_normals_are_numpys_to_rounding_and_take_the_same_words() -> None:
    own, numpys = (kind(np.random.PCG64(11)) for kind in (Generator, np.random.Generator))
    for shape in ((1_000_000,), (3, 5), (1,)):  # some in the tail beyond 3.65
        np.testing.assert_allclose(own.standard_normal(shape), numpys.standard_normal(shape), rtol=2e-13, atol=1e-15)
    assert own.standard_normal() == pytest.approx(numpys.standard_normal(), rel=2e-13)
    assert own.random() == numpys.random()


def test_normals_do_not_depend_on_how_many_are_drawn_at_once() -> None:
    whole, parts = Generator(np.random.PCG64(3)), Generator(np.random.PCG64(3))
    drawn = np.concatenate([parts.standard_normal(n) for n in (1, 2, 4093, 5904)])
    assert whole.standard_normal(10_000).tobytes() == drawn.tobytes()


def test_normals_fill_an_array_that_is_given() -> None:
    out = np.empty((4, 3))
    assert Generator(np.random.PCG64(3)).standard_normal(out=out) is out
    assert out.tobytes() == Generator(np.random.PCG64(3)).standard_normal((4, 3)).tobytes()
