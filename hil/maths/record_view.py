"""Record in an array of floats, without a copy: for arrays whose length is known only when the settings are."""

from __future__ import annotations

from typing import Any

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
