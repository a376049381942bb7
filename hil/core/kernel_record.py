"""Records that are passed to kernels in each cycle without the cost of their description.

A kernel takes the memory of a record from its attribute ``data``. For a plain record numpy describes all of its fields
on the way, each time: 0.1 ms for the parameters of the GNC.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, cast

import numpy as np

_data_of: Callable[[np.void], memoryview] = np.void.data.__get__


class KernelRecord(np.record):  # type: ignore[misc]  # numpy's stubs declare void as final
    """A record with its memory at hand; fields as in ``np.record``. Made by ``kernel_record``."""

    __slots__ = ("_bytes",)
    _bytes: memoryview

    @property
    def data(self) -> memoryview:
        """Memory of the record."""
        try:
            return _bytes_of(self)
        except AttributeError:  # a field or a copy of another one
            return _data_of(self)


_slot: Any = KernelRecord.__dict__["_bytes"]
_bytes_of: Callable[[np.void], memoryview] = _slot.__get__


def kernel_record(record: np.record) -> np.record:
    """Return ``record`` for kernels that are called often, in the same memory."""
    array = np.asarray(record)
    viewed: Any = array.view(_dtype_of(array.dtype))[()]
    _slot.__set__(viewed, array.reshape(1).view(np.uint8).data)
    return cast(np.record, viewed)


@cache
def _dtype_of(dtype: np.dtype) -> np.dtype:
    """Return ``dtype`` with records of this class, the same object each time: numba keeps types by object."""
    return np.dtype((KernelRecord, dtype))
