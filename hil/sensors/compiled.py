"""The two kernels of a sensor module as C functions, which the loop calls by their addresses.

The machine code is kept in the cache of the bench's kernels, as that of a backend.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numba import types
from numba.core.errors import NumbaError
from numba.np.numpy_support import carray

from hil.core.jit import c_function
from hil.core.own_code import compile_error
from hil.core.own_kernel import own_kernel
from hil.core.sensor_records import SENSOR_ESTIMATE, SENSOR_INNOVATION, SENSOR_OUTPUT, SENSOR_SAMPLE, SENSOR_TRUTH
from hil.errors import BadInput
from hil.sensors.module import SensorKind, SensorModule

DONE: Final = 1
"""What the C function of a kernel returns, unless the kernel has raised."""
_ARGUMENTS: Final = {"measure": (SENSOR_TRUTH, SENSOR_OUTPUT), "innovate": (SENSOR_ESTIMATE, SENSOR_INNOVATION)}


class Addresses(NamedTuple):
    """Addresses of ``int f(first record, second record, settings)``."""

    measure: int
    innovate: int


@cache
def addresses(sensor: SensorKind) -> Addresses:
    """Return the addresses of the compiled kernels of a module. Raises BadInput if one does not compile."""
    module, settings = sensor.module, sensor.settings
    layout = np.dtype([(setting.name, "f8") for setting in settings] or [("none", "f8")], align=True)
    return Addresses(*(_address(module, name, layout) for name in _ARGUMENTS))


def _address(module: type[SensorModule], name: str, settings: np.dtype) -> int:
    function: Callable[..., Any] = own_kernel(getattr(module, name))
    first_layout, second_layout = _ARGUMENTS[name]

    def call(first, second, values):  # type: ignore[no-untyped-def]
        function(  # what it raises goes to sys.unraisablehook, and the result is 0
            carray(values, (1,), settings)[0], carray(first, (1,), first_layout)[0],
            carray(second, (1,), second_layout)[0],
        )  # fmt: skip
        return DONE

    try:
        return c_function(call, types.int32(types.voidptr, types.voidptr, types.voidptr))
    except (NumbaError, KeyError) as error:
        reason = compile_error(error, getattr(module, name), settings, first_layout, second_layout, SENSOR_SAMPLE)
        text = f"{module.__name__}.{name} does not compile: {reason}"
        raise BadInput.single("hil sensors", module.kind, text) from error
