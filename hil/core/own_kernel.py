"""Kernels of a user's own: their indices are checked, and an exception in one ends the run instead of being ignored."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from hil.core.jit import KernelCache, kernel

RAISED: Final = 1
"""What the C function of a kernel returns if the kernel has raised."""
_KIND: Final = "inline, indices checked"


def own_kernel(function: Callable[..., Any]) -> Any:
    """Return ``function`` compiled as a kernel that raises IndexError for an index outside an array."""
    compiled: Any = kernel(function)
    compiled.inside().targetoptions["boundscheck"] = True
    compiled.inside()._cache = KernelCache(function, _KIND)
    return compiled


def raised_by(function: Callable[..., Any], *records: np.void | np.ndarray) -> BaseException:
    """Return what a kernel has raised, by a call of the plain function with copies of its ``records``.

    A compiled exception has neither line nor values.
    """
    copies = [np.array([record]).view(np.recarray)[0] for record in records]
    try:
        function(*copies)
    except Exception as error:
        return error
    lines, first = inspect.getsourcelines(function)
    return RuntimeError(f"an exception in lines {first} to {first + len(lines) - 1}, compiled; none in plain Python")
