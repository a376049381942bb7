"""Formulas: functions of numbers that Python calls as they are, and kernels in their compiled form, with the same bits.

The preparation of a run computes once by the formula of the loop; commands that only read files do not load numba.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])
_pending: Final[list[Callable[..., Any]]] = []
_compilers: Final[list[Callable[[Callable[..., Any]], None]]] = []


def formula(function: _Function) -> _Function:
    """Let kernels call ``function``, which is kept as it is."""
    if _compilers:
        _compilers[0](function)
    else:
        _pending.append(function)
    return function


def compile_formulas_by(compiler: Callable[[Callable[..., Any]], None]) -> None:
    """Give all formulas, and those that are still to be defined, to ``compiler``."""
    _compilers.append(compiler)
    for function in _pending:
        compiler(function)
    _pending.clear()
