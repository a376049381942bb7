"""One call of the kernels of a sensor module, as the loop calls them, and the rehearsal of each module before a run."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np

from hil.core.messages import Array, new
from hil.core.own_kernel import raised_by
from hil.core.plug_ins import kernel_errors, raised_text
from hil.core.sensor_records import SENSOR_ESTIMATE, SENSOR_INNOVATION, SENSOR_OUTPUT, SENSOR_TRUTH
from hil.errors import BadInput
from hil.sensors.compiled import DONE, Addresses, addresses
from hil.sensors.module import SensorKind

_RANGE_M = 5.0
_OUTPUT = ("value", "h", "noise")
"""Fields of an innovation with one row per component."""


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
        if code != DONE:
            raise self._refusal(name, first, second)

    def _refusal(self, name: str, first: np.record, second: np.record) -> BadInput:
        """Return the error of a kernel that has raised."""
        module, settings = self._sensor.module, self._sensor.settings
        layout = np.dtype([(setting.name, "f8") for setting in settings] or [("none", "f8")], align=True)
        error = raised_by(getattr(module, name), self._values.view(layout)[0], first, second)
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
