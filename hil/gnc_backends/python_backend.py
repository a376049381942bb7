"""Backends as Python classes: their ``step`` is called through a C function, also from compiled loops.

The compiled loop releases the interpreter's lock; the C function takes it for each call.
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from hil.core.backend_records import OBJECTS, OUTPUT_FIELDS, OUTPUTS, TEXT_BYTES
from hil.core.fields import described
from hil.core.settings import Setting, checked_settings
from hil.errors import BadInput, DeviceError
from hil.gnc_backends.backend import BackendInstance
from hil.gnc_backends.external import raised_text

_STEP: Final = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
_RAISED: Final = 1
_LARGE: Final = 1000  # of demands, states and health
_ESTIMATE: Final = ("r_CT_H", "v_CT_H", "q_CH", "w_CH_C")
_SETUP: Final = OBJECTS["control"]["setup"]


class PythonBackend:
    """A Python class, of which each instance is a new object, or an object, which is reset for each run.

    part: navigation or control. The object has ``step(inp)``, which returns None or a mapping with fields of the
    output; in navigation an estimate is valid if it has ``r_CT_H``, ``v_CT_H``, ``q_CH`` and ``w_CH_C``; in control a
    sequence, one number per thruster, opens thrusters as well. It may have ``settings``, a sequence of hil.Setting,
    ``reset()``, and ``start(setup, settings)``, which are called before the first cycle. copies: each instance is a
    copy of the object.
    """

    def __init__(self, given: Any, part: str, refuse: Callable[[str], BadInput], copies: bool = False) -> None:
        self._given, self._part, self._copies = given, part, copies
        self._is_class = isinstance(given, type)
        self.name = given.__name__ if self._is_class else type(given).__name__
        if not callable(getattr(given, "step", None)):
            raise refuse(f"{self.name}: must be a class or an object with a method step(inp)")
        try:
            self.settings: tuple[Setting, ...] = checked_settings(getattr(given, "settings", ()))
        except ValueError as error:
            raise refuse(f"{self.name}: {error}") from error

    def check(self, setup: np.record) -> None:
        """Accept any setup: no object is made before a run."""

    def open(self, setup: np.record, values: np.ndarray) -> PythonInstance:
        """Return an instance. Raises DeviceError for what the object raises."""
        name = f"{self._part} {self.name}"
        if self._is_class:
            made = _called(name, "__init__", self._given)
        else:
            made = copy.deepcopy(self._given) if self._copies else self._given
        return PythonInstance(made, self._part, name, self.settings, setup, values)


def _called(name: str, method: str, function: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except Exception as error:
        raise DeviceError(name, raised_text(method, error)) from error


class PythonInstance(BackendInstance):
    """An object in flight. ``error``: what its step has raised."""

    def __init__(
        self, made: Any, part: str, name: str, settings: tuple[Setting, ...], setup: np.record, values: np.ndarray
    ) -> None:
        self._made, self._part = made, part
        self._fields = {field.name: field for field in OUTPUT_FIELDS[part]}
        self._input, self._output = OBJECTS[part], OUTPUTS[part]
        self._views: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
        self._names = [setting.name for setting in settings]
        self._settings = SimpleNamespace()
        self.set_settings(values)
        known = np.frombuffer(np.asarray(setup).tobytes(), _SETUP)[0]
        for method, arguments in (("reset", ()), ("start", (known, self._settings))):
            if (function := getattr(made, method, None)) is not None:
                _called(name, method, function, *arguments)
        self._callback = _STEP(self._step)
        super().__init__(ctypes.cast(self._callback, ctypes.c_void_p).value or 0, 0)

    def set_settings(self, values: np.ndarray) -> None:
        """Write the settings as attributes of the object that ``start`` was given."""
        for name, value in zip(self._names, values, strict=True):
            setattr(self._settings, name, float(value))

    def _step(self, given: int, output: int, _instance: int) -> int:
        try:
            inputs, outputs = self._views.get((given, output)) or self._view(given, output)
            self._read(self._made.step(inputs.copy()[0]), outputs[0])
        except BaseException as error:
            self.error = error
            return _RAISED
        return 0

    def _view(self, given: int, output: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the records at two addresses, which stay the same during a block of cycles."""
        inputs, outputs = _at(given, self._input), _at(output, self._output)
        self._views = {(given, output): (inputs, outputs)}
        return inputs, outputs

    def _read(self, found: Any, out: np.void) -> None:
        """Write what the step has returned to the output. Raises TypeError or ValueError."""
        out["text"] = 0
        if found is None:
            return
        if not isinstance(found, Mapping):
            if self._part == "navigation":
                raise TypeError(f"step returned {found!r:.60}, allowed None or a mapping with fields of the output")
            found = {"on": found}
        fields = self._fields
        for name, value in found.items():
            if name not in fields:
                raise ValueError(f"step returned the field {name!r}, allowed {', '.join(fields)}")
            if name == "text":
                text = str(value).encode()[:TEXT_BYTES]
                out["text"][: len(text)] = np.frombuffer(text, np.uint8)
                continue
            numbers = np.asarray(value)
            target = out[name]
            if name == "on":
                out["direct"] = 1
                n = numbers.shape[0] if numbers.ndim == 1 else 0
                if not 0 < n <= len(target) or not ((numbers == 0) | (numbers == 1)).all():
                    raise ValueError(f"on = {value!r:.60}, allowed one 0 or 1 per thruster")
                target[:n] = numbers
            elif numbers.shape != np.shape(target):
                shape = np.shape(target)
                raise ValueError(f"{name} has shape {numbers.shape}, allowed {shape}: {described(fields[name])}")
            else:
                if target.dtype.kind in "iu" and not ((numbers == np.rint(numbers)) & (abs(numbers) < _LARGE)).all():
                    raise ValueError(f"{name} = {value!r:.60}, allowed integers")
                out[name] = numbers
        if self._part == "navigation" and "valid" not in found:
            missing = [name for name in _ESTIMATE if name not in found]
            if len(missing) not in (0, len(_ESTIMATE)):
                raise ValueError(f"step returned an estimate without {', '.join(missing)}")
            out["valid"] = 0 if missing else 1


def _at(address: int, dtype: np.dtype) -> np.ndarray:
    """Return the record at ``address``, (1,)."""
    memory: Any = (ctypes.c_char * dtype.itemsize).from_address(address)
    return np.frombuffer(memory, dtype)
