"""The digest of a kernel: it changes with all that its machine code depends on, and with nothing else."""

from __future__ import annotations

import sys

import pytest

from hil.core.jit import kernel
from hil.core.kernel_digest import NotDigestible, digest_of
from hil.loop.compiled import run_stats
from hil.loop.compiled.run_cycles import run_cycles

SOURCE = """
import numpy as np
from hil.core.jit import entry, kernel
from hil.maths import quat, stack

FACTOR = 2.0
ROW = np.dtype([("x", "f8"), ("n", "i4")], align=True)

@kernel
def inner(x):
    return x + 1.0

@entry
def called(x):
    return x + 1.0

@kernel
def outer(row):
    \'\'\'Documentation.\'\'\'
    return FACTOR * inner(row.x) + called(row.x) + ROW.itemsize
"""


def digest(old: str = "", new: str = "") -> str:
    """Return the digest of ``outer`` in SOURCE with ``old`` replaced."""
    assert old in SOURCE
    names: dict[str, object] = {"__name__": "somewhere"}
    exec(compile(SOURCE.replace(old, new) if old else SOURCE, "somewhere.py", "exec"), names)
    return digest_of(names["outer"])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("FACTOR = 2.0", "FACTOR = 2.5"),
        ("FACTOR = 2.0", "FACTOR = 2"),
        ('("n", "i4")', '("n", "i8")'),
        ("def inner(x):\n    return x + 1.0", "def inner(x):\n    return x + 2.0"),
        ("FACTOR * inner", "FACTOR / inner"),
    ],
)
def test_constant_layout_and_formula_are_in_the_digest(old: str, new: str) -> None:
    assert digest(old, new) != digest()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Documentation.", "Other words."),
        ("FACTOR = 2.0", "\n# a comment\nFACTOR = 2.0"),
        ("def called(x):\n    return x + 1.0", "def called(x):\n    return x + 2.0"),
        ("FACTOR = 2.0", "FACTOR = 2.0\nx = object()"),  # x is a field of the row here
    ],
)
def test_words_fields_and_the_inside_of_an_entry_are_not_in_the_digest_of_its_caller(old: str, new: str) -> None:
    assert digest(old, new) == digest()


def test_value_that_a_closure_holds_is_in_the_digest() -> None:
    def power(n: int) -> object:
        @kernel
        def raised(x: float) -> float:
            return x**n

        return raised

    assert digest_of(power(2)) != digest_of(power(3))
    assert digest_of(power(2)) == digest_of(power(2))


def test_kernel_with_a_global_that_has_no_digest_is_compiled_and_not_cached() -> None:
    strange = object()

    def never(x: float) -> float:
        return x if x > 0.0 else strange  # type: ignore[return-value]

    with pytest.raises(NotDigestible, match="object"):
        digest_of(never)


def test_every_kernel_of_the_loop_has_a_digest() -> None:
    assert len(digest_of(run_cycles)) == 16
    modules = [module for name, module in sys.modules.items() if name.startswith("hil.")]
    kernels = {each for module in modules for each in vars(module).values() if hasattr(each, "py_func")}
    assert run_stats.count_cycle in kernels
    for each in kernels:  # one without a digest would be compiled at each start
        digest_of(each)
