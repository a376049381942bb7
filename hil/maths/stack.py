"""Small arrays on the stack of a kernel, valid until it returns.

``np.empty(3)`` in a kernel allocates on the heap each time, which costs more than the arithmetic on three numbers.
An array of ``vector`` or ``matrix`` is valid until the kernel that created it returns: it may be passed to other
kernels, never returned. Sizes are literal numbers; the contents are undefined, as those of ``np.empty``.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array


def _on_the_stack(shape: tuple[int, ...]) -> tuple[types.Array, Any]:
    array_type = types.Array(types.float64, len(shape), "C")
    size = 1
    for extent in shape:
        size *= extent

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        room = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), size))
        if size >= 8:
            room.align = 32  # as vector registers are: the loop is 4 % faster
        array = make_array(array_type)(context, builder)
        strides = [8 * (shape[1] if len(shape) == 2 and axis == 0 else 1) for axis in range(len(shape))]
        populate_array(
            array,
            data=builder.bitcast(room, ir.DoubleType().as_pointer()),
            shape=[context.get_constant(types.intp, extent) for extent in shape],
            strides=[context.get_constant(types.intp, stride) for stride in strides],
            itemsize=context.get_constant(types.intp, 8),
            meminfo=None,
        )
        return array._getvalue()

    return array_type, generate


@intrinsic
def vector(_typing, n):
    """Return an array of floats of shape (n,)."""
    if not isinstance(n, types.IntegerLiteral):
        return None
    array_type, generate = _on_the_stack((n.literal_value,))
    return array_type(n), generate


@intrinsic
def matrix(_typing, m, n):
    """Return an array of floats of shape (m, n)."""
    if not (isinstance(m, types.IntegerLiteral) and isinstance(n, types.IntegerLiteral)):
        return None
    array_type, generate = _on_the_stack((m.literal_value, n.literal_value))
    return array_type(m, n), generate
