"""Call of a C function by its address from a kernel."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from hil.core.jit import kernel


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
