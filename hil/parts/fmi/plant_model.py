"""Model of a part of the plant in an FMU: records in, records out, one step after the other, from Python."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.config.tables.fmu_mapping import FmuMapping
from hil.core.fields import Fields, record_dtype
from hil.parts.fmi.archive import FmuError
from hil.parts.fmi.binary import OK, WARNING, Fmu, status_text
from hil.parts.fmi.description import FmiVariable
from hil.parts.fmi.mapping import MappedElement, map_record

_MULTIPLE: Final = 1e-6  # tolerance of the quotient of two steps


@dataclass(frozen=True)
class PlantRecords:
    """Records of a model; all fields are 8-byte floats. required: outputs without which it cannot be used."""

    setup: Fields
    inputs: Fields
    outputs: Fields
    required: tuple[str, ...]


@dataclass(frozen=True)
class ModelSource:
    """Where a model comes from. parameters: values of variables, in the FMU's units."""

    path: Path
    mapping: FmuMapping = field(default_factory=FmuMapping)
    parameters: Mapping[str, bool | int | float | str] = field(default_factory=dict)


class PlantModel:
    """A model of ``records``, instantiated and initialised with ``setup``. Raises FmuError.

    setup: fields of the setup record, SI units; those that the FMU lacks are ignored.
    """

    def __init__(self, records: PlantRecords, source: ModelSource, setup: Mapping[str, Any], step_s: float) -> None:
        self.path = source.path
        self._fmu = Fmu(source.path)
        described = self._fmu.description
        _check_step(described.step_s, step_s)
        mapping = source.mapping
        inputs = map_record(described, records.inputs, mapping.inputs, ("input",), "inputs")
        outputs = map_record(described, records.outputs, mapping.outputs, ("output",), "outputs")
        parameters = map_record(described, records.setup, mapping.setup, ("parameter",), "setup")
        self.given = frozenset(element.field.name for element in outputs)
        """Outputs that the FMU has."""
        for name in records.required:
            if name not in self.given:
                raise FmuError(f"has no output {name}[1]: map it by a mapping file")
        fed = {element.variable.name for element in inputs} | set(source.parameters)
        unfed = [v.name for v in described.variables.values() if v.causality == "input" and v.name not in fed]
        if unfed:
            raise FmuError(f"input {unfed[0]}: no field of that name: map it or give it a value as a parameter")
        if unknown := sorted(set(source.parameters) - set(described.variables)):
            raise FmuError(f"parameters: has no variable {unknown[0]!r}")
        self.inputs = np.zeros(1, record_dtype(records.inputs)).view(np.recarray)
        self.outputs = np.zeros(1, record_dtype(records.outputs)).view(np.recarray)
        self._x, self._y = self.inputs.view("f8"), self.outputs.view("f8")
        self._component = self._fmu.instantiate("plant")
        weakref.finalize(self, self._fmu.free, self._component)
        values = np.zeros(1, record_dtype(records.setup))
        for name, value in setup.items():
            values[name] = value
        for group in _groups(parameters):
            self._fmu.set_values(self._component, group.access, group.variables, group.from_record(values.view("f8")))
        for name, parameter in source.parameters.items():
            self._fmu.set_variable(self._component, name, parameter)
        self._fmu.initialise(self._component)
        self._set = [_Call(self._fmu, "Set", group) for group in _groups(inputs)]
        self._get = [_Call(self._fmu, "Get", group) for group in _groups(outputs)]
        self._step_s = step_s
        self._do_step = _step_function(self._fmu, self._component)

    def step(self) -> np.recarray:
        """Advance by one step from ``inputs.t_s`` with ``inputs``; return ``outputs``, (1,). Raises FmuError."""
        for call in self._set:
            call.put(self._x)
            call(self._fmu, self._component)
        status = self._do_step(float(self._x[0]), self._step_s)
        if status not in (OK, WARNING):
            message = self._fmu.log.value.decode("utf-8", "replace")
            text = status_text(f"fmi{self._fmu.description.version}DoStep", status)
            raise FmuError(text + (f": {message}" if message else ""))
        for call in self._get:
            call(self._fmu, self._component)
            call.group.to_record(call.values, self._y)
        if not np.isfinite(self._y).all():
            raise FmuError(f"{self._not_finite()} is not finite at t = {self._x[0]:g} s")
        return self.outputs

    def _not_finite(self) -> str:
        names: tuple[str, ...] = self.outputs.dtype.names or ()
        return next(name for name in names if not np.isfinite(self.outputs[name]).all())


class _Group:
    """Elements of variables of one type, between a record of 8-byte floats and the values of an FMU's function."""

    def __init__(self, access: str, elements: Sequence[MappedElement]) -> None:
        self.access = access
        self.variables: list[FmiVariable] = []
        first: dict[str, int] = {}
        size = 0
        for element in elements:
            variable = element.variable
            if variable.name not in first:
                self.variables.append(variable)
                first[variable.name] = size
                size += variable.size
        self.size = size
        self._start = np.concatenate([variable.start_values for variable in self.variables])
        self._record = np.array([element.offset // 8 for element in elements])
        self._places = np.array([first[element.variable.name] + element.index for element in elements])
        self._factor = np.array([element.factor for element in elements])
        self._shift = np.array([element.shift for element in elements])

    def name_of(self, place: int) -> tuple[str, str]:
        """Return name and type of the variable that has the element ``place``."""
        ends = np.cumsum([variable.size for variable in self.variables])
        variable = self.variables[int(np.searchsorted(ends, place, side="right"))]
        return variable.name, variable.type

    def from_record(self, record: np.ndarray) -> Any:
        """Return the values of the function in the FMU's units."""
        values = self._start.copy()
        values[self._places] = (record[self._record] - self._shift) / self._factor
        return values

    def to_record(self, values: np.ndarray, record: np.ndarray) -> None:
        """Write the values of the function, converted to SI units, into ``record``."""
        record[self._record] = values[self._places] * self._factor + self._shift


def _groups(elements: Iterable[MappedElement]) -> list[_Group]:
    """Return the elements, grouped by the functions that set and get them."""
    by_access: dict[str, list[MappedElement]] = {}
    for element in elements:
        by_access.setdefault(element.variable.access, []).append(element)
    return [_Group(access, each) for access, each in by_access.items()]


class _Call:
    """Call of the function that sets or gets the values of a group; ``values``: its array."""

    def __init__(self, fmu: Fmu, verb: str, group: _Group) -> None:
        self.group = group
        self.values = np.zeros(group.size, group.variables[0].code)
        self._references = np.array([variable.reference for variable in group.variables], np.uint32)
        self._name = f"{verb}{group.access}"
        self._version = fmu.description.version
        kinds: list[Any] = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
        self._more: tuple[int, ...] = () if self._version == 2 else (group.size,)
        kinds += [ctypes.c_size_t] * len(self._more)
        self._function = ctypes.CFUNCTYPE(ctypes.c_int, *kinds)(fmu.address(self._name))

    def put(self, record: np.ndarray) -> None:
        """Take over the values of a record, 8-byte floats. Raises FmuError for one that the type cannot hold."""
        given = self.group.from_record(record)
        with np.errstate(invalid="ignore"):
            self.values[:] = given
        if self.values.dtype.kind in "iu" and (self.values != given).any():
            place = int(np.flatnonzero(self.values != given)[0])
            name, kind = self.group.name_of(place)
            raise FmuError(f"{name}: {given[place]:g} is no {kind}")

    def __call__(self, fmu: Fmu, component: int) -> None:
        status = self._function(
            component, self._references.ctypes.data, len(self._references), self.values.ctypes.data, *self._more
        )
        if status not in (OK, WARNING):
            raise FmuError(status_text(f"fmi{self._version}{self._name}", status))


def _step_function(fmu: Fmu, component: int) -> Any:
    """Return DoStep as a function of the time and the step, which returns a status."""
    real = ctypes.c_double
    if fmu.description.version == 2:
        kinds: tuple[Any, ...] = (ctypes.c_void_p, real, real, ctypes.c_int)
        function = ctypes.CFUNCTYPE(ctypes.c_int, *kinds)(fmu.address("DoStep"))
        return lambda t_s, step_s: function(component, t_s, step_s, 1)
    flags = [(ctypes.c_bool * 1)() for _ in range(3)]
    last_s = (real * 1)()
    kinds = (ctypes.c_void_p, real, real, ctypes.c_bool, *[ctypes.c_void_p] * 4)
    step_3 = ctypes.CFUNCTYPE(ctypes.c_int, *kinds)(fmu.address("DoStep"))
    return lambda t_s, step_s: step_3(component, t_s, step_s, True, *flags, last_s)


def _check_step(fixed_s: float | None, step_s: float) -> None:
    if fixed_s is None:
        return
    ratio = step_s / fixed_s if fixed_s > 0.0 else math.nan
    if not (round(ratio) >= 1 and abs(ratio - round(ratio)) < _MULTIPLE * ratio):
        raise FmuError(f"allows steps of {fixed_s:g} s and multiples: the step is {step_s:g} s")
