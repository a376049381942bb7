"""A GNC in a shared library, called from compiled code: the loop and a campaign make the very same call."""

from __future__ import annotations

from llvmlite import ir
from numba import typeof, types
from numba.extending import intrinsic

from hil.core.jit import kernel
from hil.gnc_backends import external_records


@intrinsic
def _call(_typing, address, instance, told, answer):
    """Call ``int address(void *instance, const void *told, void *answer)``; told, answer: records."""
    signature = types.int32(types.int64, types.int64, told, answer)

    def generate(_context, builder, _signature, arguments):
        pointer = ir.IntType(8).as_pointer()
        function = ir.FunctionType(ir.IntType(32), [pointer, pointer, pointer])
        callee = builder.inttoptr(arguments[0], function.as_pointer())
        return builder.call(
            callee,
            [
                builder.inttoptr(arguments[1], pointer),
                builder.bitcast(arguments[2], pointer),
                builder.bitcast(arguments[3], pointer),
            ],
        )

    return signature, generate


@kernel
def step(address, instance, told, answer):
    """Call the library's step; return what it returns.

    address: of ``hil_gnc_step``. instance: what ``hil_gnc_open`` gave. told: GNC_INPUT. answer: GNC_OUTPUT, zeroed
    but for the fields that a library may leave as they are: its cycle and its state, WORKING.
    """
    external_records.clear_output(answer, told.cycle)
    return _call(address, instance, told, answer)


def compile_step(told, answer):
    """Compile ``step`` for these records without calling anything."""
    step.compile((types.int64, types.int64, typeof(told), typeof(answer)))
