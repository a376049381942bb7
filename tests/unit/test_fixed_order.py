"""What determines a run computes in a fixed order."""

from __future__ import annotations

import ast

import pytest

from tests.support.fixed_order import EXEMPT, ROOT, faults_of, places


def test_no_last_bit_of_a_run_depends_on_the_computer() -> None:
    assert list(places()) == []


@pytest.mark.parametrize("name", EXEMPT)
def test_exempt_places_exist(name: str) -> None:
    assert (ROOT / name).exists()


@pytest.mark.parametrize(
    "text",
    [
        "math.sin(x)", "np.exp(x)", "np.linalg.norm(v)", "a @ b", "x ** 2", "x ** 0.5", "2.0 ** -53", "np.dot(a, b)",
        "from scipy.special import ndtr", "generator.normal(0.0, 1.0)", "f = math.atan2",
    ],
)  # fmt: skip
def test_arithmetic_that_depends_on_the_computer_is_seen(text: str) -> None:
    assert list(faults_of(ast.parse(text)))


@pytest.mark.parametrize("text", ["math.sqrt(x)", "2**53", "np.square(x)", "math.floor(x)", "generator.random()"])
def test_exact_arithmetic_is_allowed(text: str) -> None:
    assert not list(faults_of(ast.parse(text)))


def test_small_powers_in_a_kernel_are_products() -> None:
    assert not list(faults_of(ast.parse("@kernel\ndef f(x):\n    return x**2")))
    assert list(faults_of(ast.parse("@kernel\ndef f(x):\n    return x**y")))
