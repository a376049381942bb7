"""Code of others in kernels: C functions by their address, and kernels of a user's own.

Of these the indices are checked, and an exception in one ends the run instead of being ignored.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from hil.core.jit import KernelCache, kernel


@intrinsic
def call_address(_typing, address, first, second, third):
    """Return ``int address(void *first, void *second, void *third)``; arguments: records, or addresses as int64."""
    signature = types.int32(types.int64, first, second, third)

    def generate(_context, builder, signature, arguments):
        pointer = ir.IntType(8).as_pointer()
        function = ir.FunctionType(ir.IntType(32), [pointer, pointer, pointer])
        callee = builder.inttoptr(arguments[0], function.as_pointer())
        pointers = [
            builder.inttoptr(value, pointer) if isinstance(kind, types.Integer) else builder.bitcast(value, pointer)
            for kind, value in zip(signature.args[1:], arguments[1:], strict=True)
        ]
        return builder.call(callee, pointers)

    return signature, generate


@kernel
def same_bytes(a, b):
    """Return whether ``a`` and ``b`` (n,) are equal."""
    differences = 0
    for i in range(a.shape[0]):
        differences += 1 if a[i] != b[i] else 0
    return differences == 0


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
