"""The two kernels of a sensor module as C functions, which the loop calls by their addresses, and their rehearsal.

The machine code is kept in the cache of the bench's kernels, as that of a backend.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numba import types
from numba.core.errors import NumbaError
from numba.np.numpy_support import carray

from hil.core.foreign_call import own_kernel, raised_by
from hil.core.jit import c_function
from hil.core.messages import Array, new
from hil.core.own_code import compile_error
from hil.core.plug_ins import kernel_errors, raised_text
from hil.core.sensor_records import SENSOR_ESTIMATE, SENSOR_INNOVATION, SENSOR_OUTPUT, SENSOR_SAMPLE, SENSOR_TRUTH
from hil.errors import BadInput
from hil.sensors.module import SensorKind, SensorModule

_DONE: Final = 1  # returned by the C function of a kernel, unless the kernel has raised
_ARGUMENTS: Final = {"measure": (SENSOR_TRUTH, SENSOR_OUTPUT), "innovate": (SENSOR_ESTIMATE, SENSOR_INNOVATION)}
_RANGE_M = 5.0
_OUTPUT = ("value", "h", "noise")
"""Fields of an innovation with one row per component."""


class Addresses(NamedTuple):
    """Addresses of ``int f(first record, second record, settings)``."""

    measure: int
    innovate: int


@cache
def addresses(sensor: SensorKind) -> Addresses:
    """Return the addresses of the compiled kernels of a module. Raises BadInput if one does not compile."""
    return Addresses(*(_compiled(sensor.module, name, _layout(sensor)) for name in _ARGUMENTS))


def _layout(sensor: SensorKind) -> np.dtype:
    return np.dtype([(setting.name, "f8") for setting in sensor.settings] or [("none", "f8")], align=True)


def _compiled(module: type[SensorModule], name: str, settings: np.dtype) -> int:
    function: Callable[..., Any] = own_kernel(getattr(module, name))
    first_layout, second_layout = _ARGUMENTS[name]

    def call(first, second, values):  # type: ignore[no-untyped-def]
        function(  # what it raises goes to sys.unraisablehook, and the result is 0
            carray(values, (1,), settings)[0], carray(first, (1,), first_layout)[0],
            carray(second, (1,), second_layout)[0],
        )  # fmt: skip
        return _DONE

    try:
        return c_function(call, types.int32(types.voidptr, types.voidptr, types.voidptr))
    except (NumbaError, KeyError) as error:
        reason = compile_error(error, getattr(module, name), settings, first_layout, second_layout, SENSOR_SAMPLE)
        text = f"{module.__name__}.{name} does not compile: {reason}"
        raise BadInput.single("hil sensors", module.kind, text) from error


class Trial:
    """A module called from Python, as the loop calls it. values: of the settings, in the order of their declaration."""

    def __init__(self, sensor: SensorKind, values: Array) -> None:
        self._sensor = sensor
        self._values = np.ascontiguousarray(values if len(values) else np.zeros(1), float)
        kind = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_void_p] * 3)
        self._functions = {name: kind(address) for name, address in addresses(sensor)._asdict().items()}
        self.truth, self.output = new(SENSOR_TRUTH), new(SENSOR_OUTPUT)
        self.estimate, self.innovation = new(SENSOR_ESTIMATE), new(SENSOR_INNOVATION)

    def measure(self) -> bool:
        """Measure ``truth`` into ``output``; return whether there is a measurement."""
        self.output.valid = 1
        self.output.sample.value, self.output.sample.covariance = 0.0, 0.0
        self._call("measure", self.truth, self.output)
        return bool(self.output.valid)

    def innovate(self) -> Array:
        """Compare ``output`` with ``estimate``; return the innovation (n,), with the others in ``innovation``."""
        innovation, n = self.innovation, len(self._sensor.components)
        innovation.sample = self.output.sample
        for name in ("value", "h", "h_errors"):
            innovation[name][...] = 0.0
        for k, error in enumerate(self._sensor.module.errors):
            innovation["h_errors"][error.component, k] = 1.0
        innovation.noise = self.output.sample.covariance
        self._call("innovate", self.estimate, innovation)
        value: Array = innovation["value"][:n].copy()
        return value

    def _call(self, name: str, first: np.record, second: np.record) -> None:
        with kernel_errors():
            code = self._functions[name](_address(first), _address(second), self._values.ctypes.data)
        if code != _DONE:
            raise self._refusal(name, first, second)

    def _refusal(self, name: str, first: np.record, second: np.record) -> BadInput:
        """Return the error of a kernel that has raised."""
        module, values = self._sensor.module, self._values.view(_layout(self._sensor))
        error = raised_by(getattr(module, name), values[0], first, second)
        return BadInput.single("hil sensors", module.kind, f"{module.__name__}.{raised_text(name, error)}")


def _address(record: np.record) -> int:
    return int(np.asarray(record).__array_interface__["data"][0])


@cache
def rehearsed(sensor: SensorKind) -> Addresses:
    """Return the addresses of the kernels of a module, after one call of each in front of the target.

    Raises BadInput if one does not compile, raises, or writes components that the module does not declare.
    """
    trial = Trial(sensor, np.array([setting.default for setting in sensor.settings]))
    for record in (trial.truth, trial.estimate):
        record.r_CT_H, record.q_CH, record.q_HI = (_RANGE_M, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)
        record.sun_I = (1.0, 0.0, 0.0)
    trial.truth.dt_s, trial.truth.sunlight = 0.1, 1.0
    trial.truth.r_T_I, trial.truth.v_T_I = (1.9e6, 0.0, 0.0), (0.0, 1.6e3, 0.0)
    trial.measure()
    trial.innovate()
    n = len(sensor.components)
    written = {"measure: out.sample.value": trial.output.sample.value}
    written |= {f"innovate: out.{name}": trial.innovation[name] for name in _OUTPUT}
    for name, values in written.items():
        if np.any(values[n:] != 0.0):
            text = f"{name} has more components than the module declares, {n}"
            raise BadInput.single("hil sensors", sensor.kind, text)
    return addresses(sensor)
