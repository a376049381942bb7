"""Records as a whole, and records and blocks in an array of floats whose length is known when the settings are."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array


@intrinsic
def record_at(_typing, array, index, dtype):
    """Return the record of ``dtype`` that begins at ``array[index]``, an array of floats; it changes with the array."""
    if not (isinstance(array, types.Array) and isinstance(dtype, types.DType)):
        return None
    record = dtype.dtype

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.bitcast(cgutils.gep_inbounds(builder, data, arguments[1]), context.get_value_type(record))

    return record(array, types.intp, dtype), generate


@intrinsic
def copy_record(_typing, source, target):
    """Copy the record ``source`` to ``target``, of the same layout; an assignment compiles into a copy byte by byte."""
    if not (isinstance(source, types.Record) and isinstance(target, types.Record) and source.size == target.size):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        cgutils.raw_memcpy(builder, arguments[1], arguments[0], context.get_constant(types.intp, source.size), 1)
        return context.get_dummy_value()

    return types.void(source, target), generate


@intrinsic
def copy_eight(_typing, target, at, source, index):
    """Copy eight floats from ``source`` to ``target``, from these places on of both in the order of memory."""
    if not (isinstance(target, types.Array) and isinstance(source, types.Array)):
        return None
    eight = ir.VectorType(ir.DoubleType(), 8).as_pointer()

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        to, start, of, first = arguments
        address = cgutils.gep_inbounds(builder, make_array(signature.args[0])(context, builder, to).data, start)
        begin = cgutils.gep_inbounds(builder, make_array(signature.args[2])(context, builder, of).data, first)
        value = builder.load(builder.bitcast(begin, eight), align=8)
        builder.store(value, builder.bitcast(address, eight), align=8)
        return context.get_dummy_value()

    return types.void(target, types.intp, source, types.intp), generate
