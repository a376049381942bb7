"""Backends as Python classes: their ``step`` is called through a C function, also from compiled loops.

The compiled loop releases the interpreter's lock; the C function takes it for each call.
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from hil.core.fields import described, offset_of
from hil.core.gnc_records import INPUTS, OBJECTS, OUTPUT_FIELDS, OUTPUTS, TEXT_BYTES, GncMode
from hil.core.plug_ins import begin_of, raised_text
from hil.core.settings import Setting, checked_settings
from hil.errors import BadInput, PlugInError, ProtocolError
from hil.gnc_backends.backend import C_STEP, NO_SETTINGS, WHOLE, BackendInstance, address_of

_RAISED: Final = 1
_LARGE: Final = 1000  # bound of demands, states and health
_ESTIMATE: Final = {
    "navigation": frozenset({"r_CT_H", "v_CT_H", "q_CH", "w_CH_C"}),
    WHOLE: frozenset({"r_CT_H_m", "v_CT_H_mps", "q_CH", "w_CH_C_radps"}),
}
_VALID: Final = {"navigation": "valid", WHOLE: "estimate"}
_BY_BENCH: Final = {WHOLE: ("cycle", "direct", "estimate")}
"""Fields of the output that are not the object's."""
_SETUP: Final = OBJECTS["control"]["setup"]
_MODE: Final = offset_of(INPUTS[WHOLE], "mode")


@runtime_checkable
class PythonGnc(Protocol):
    """GNC as an object. It may also have ``reset()`` and ``start(setup)``, which are called when a session begins.

    setup: record with the fields of ``hil_gnc_setup`` in ``hil_gnc.h``: nominal vehicle, thrusters and plan.
    """

    def step(self, gnc_input: Any, /) -> Any:
        """Return the thrusters of this cycle.

        gnc_input: record with the fields of ``hil_gnc_input`` in ``hil_gnc.h`` as attributes, SI; of ``poses`` the
        first ``n_poses`` came since the last cycle, and ``measured`` has all samples of the IMU, positions without
        attitude and measurements of further sensors. It may be kept. The result is None to coast, or a sequence with
        one number per thruster, 1 open and 0 closed, or a mapping with fields of ``hil_gnc_output``: ``on``; or
        ``force`` and ``torque``, (3,) each of -1, 0, 1, which the bench allocates; the four fields of an estimate
        (``r_CT_H_m``, ``v_CT_H_mps``, ``q_CH``, ``w_CH_C_radps``) and, with it, ``protection_level_m``,
        ``protection_level_rad`` and ``health``; ``state``; ``text``, a message for the operator.
        """


class PythonBackend:
    """A Python class, of which each instance is a new object, or an object, which is reset for each run.

    part: navigation, control or gnc. The object has ``step(inp)``, which returns None or a mapping with fields of the
    output; in navigation an estimate is valid if it has ``r_CT_H``, ``v_CT_H``, ``q_CH`` and ``w_CH_C``; in control a
    sequence, one number per thruster, opens thrusters as well. It may have ``settings``, a sequence of hil.Setting,
    ``reset()``, and ``start(setup, settings)``, which are called before the first cycle. A whole GNC (PythonGnc) has no
    settings. copies: each instance is a copy of the object.
    """

    receives_measurements = True

    def __init__(self, given: Any, part: str, refuse: Callable[[str], BadInput], copies: bool = False) -> None:
        self._given, self._part, self._copies = given, part, copies
        self._is_class = isinstance(given, type)
        self.name = class_name(given)
        if not callable(getattr(given, "step", None)):
            raise refuse(f"{self.name}: must be a class or an object with a method step(inp)")
        try:
            declared = () if part == WHOLE else getattr(given, "settings", ())
            self.settings: tuple[Setting, ...] = checked_settings(declared)
        except ValueError as error:
            raise refuse(f"{self.name}: {error}") from error

    def check(self, setup: np.record) -> None:
        """Accept any setup: no object is made before a run."""

    def open(self, setup: np.record, values: np.ndarray = NO_SETTINGS) -> PythonInstance:
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
    except (Exception, SystemExit) as error:
        raise PlugInError(name, raised_text(method, error)) from error


class PythonInstance(BackendInstance):
    """An object in flight. ``error``: what its step has raised."""

    def __init__(
        self, made: Any, part: str, name: str, settings: tuple[Setting, ...], setup: np.record, values: np.ndarray
    ) -> None:
        self._made, self._part, self._name = made, part, name
        by_bench = _BY_BENCH.get(part, ())
        self._fields = {field.name: field for field in OUTPUT_FIELDS[part] if field.name not in by_bench}
        self._input, self._output = OBJECTS[part], OUTPUTS[part]
        self._thrusters = int(setup.n_thrusters)
        self._views: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
        self._names = [setting.name for setting in settings]
        self._settings = SimpleNamespace()
        self.set_settings(values)
        record = np.frombuffer(np.asarray(setup).tobytes(), _SETUP)[0]
        start = (record,) if part == WHOLE else (record, self._settings)
        for method, arguments in (("reset", ()), ("start", start)):
            if (function := getattr(made, method, None)) is not None:
                _called(name, method, function, *arguments)
        self._callback = C_STEP(self._step_of_whole if part == WHOLE else self._step)
        super().__init__(address_of(self._callback), 0)

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

    def _step_of_whole(self, _instance: int | None, given: int, output: int) -> int:
        mode = ctypes.c_int32.from_address(given + _MODE).value
        return self._step(given, output, 0) if mode == GncMode.RUNNING else 0

    def _view(self, given: int, output: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the records at two addresses, which stay the same during a block of cycles."""
        inputs, outputs = _at(given, self._input), _at(output, self._output)
        self._views = {(given, output): (inputs, outputs)}
        return inputs, outputs

    def _read(self, returned: Any, out: np.void) -> None:
        """Write what the step has returned to the output. Raises ProtocolError."""
        out["text"] = 0
        if returned is None:
            return
        if not isinstance(returned, Mapping):
            if "on" not in self._fields:
                raise self._error(f"step returned {returned!r:.60}, allowed None or a mapping with output fields")
            returned = {"on": returned}
        for name, value in returned.items():
            if name not in self._fields:
                raise self._error(f"step returned the field {name!r}, allowed {', '.join(self._fields)}")
            if name == "text":
                text = str(value).encode()[:TEXT_BYTES]
                out["text"][: len(text)] = np.frombuffer(text, np.uint8)
            elif name == "on":
                out["on"][: self._thrusters], out["direct"] = self._thrusters_of(value), 1
            else:
                is_whole = out[name].dtype.kind in "iu"
                out[name] = self._numbers(name, value, np.shape(out[name]), is_whole, described(self._fields[name]))
        fields, valid = _ESTIMATE.get(self._part, frozenset()), _VALID.get(self._part, "")
        if fields and valid not in returned:
            missing = fields - set(returned)
            if missing and missing != fields:
                raise self._error(f"step returned an estimate without {', '.join(sorted(missing))}")
            out[valid] = 0 if missing else 1

    def _thrusters_of(self, value: Any) -> np.ndarray:
        on = self._numbers("thrusters", value, (self._thrusters,))
        if bad := [i for i, each in enumerate(on) if each not in (0.0, 1.0)]:
            raise self._error(f"thruster {bad[0] + 1} is {on[bad[0]]:g}, allowed 0, 1")
        return on

    def _numbers(
        self, name: str, value: Any, shape: tuple[int, ...], whole: bool = False, meaning: str = ""
    ) -> np.ndarray:
        """Return ``value`` as an array of ``shape``. Raises ProtocolError for anything else."""
        allowed = _shown(shape) + (f": {meaning}" if meaning else "")
        try:
            numbers = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise self._error(f"{name}: {value!r:.60}, allowed {allowed}") from None
        if numbers.shape != shape:
            raise self._error(f"{name}: {_shown(numbers.shape)}, allowed {allowed}")
        if whole and not ((numbers == np.rint(numbers)) & (abs(numbers) < _LARGE)).all():
            raise self._error(f"{name}: {numbers.tolist()}, allowed integers")
        return numbers

    def _error(self, text: str) -> ProtocolError:
        return ProtocolError(self._name, f"{text}{begin_of(self._made.step)}")


def _shown(shape: tuple[int, ...]) -> str:
    return f"{' x '.join(map(str, shape))} numbers" if shape else "one number"


def class_name(gnc: object) -> str:
    """Return the name of an object's class, as it appears in events, errors and the report."""
    return gnc.__name__ if isinstance(gnc, type) else type(gnc).__name__


def _at(address: int, dtype: np.dtype) -> np.ndarray:
    """Return the record at ``address``, (1,)."""
    memory: Any = (ctypes.c_char * dtype.itemsize).from_address(address)
    return np.frombuffer(memory, dtype)
