"""GNC, or its navigation or control, in an FMU for co-simulation (FMI 2.0, 3.0): the records of shared libraries."""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from hil.config.load import load_fmu_mapping
from hil.config.scenario import GncConfig
from hil.config.tables.fmu_mapping import FmuMapping
from hil.core.fields import Fields, field_of, offset_of, record_dtype
from hil.core.gnc_records import (
    CONTROL_INPUT_FIELDS,
    GNC_INPUT_FIELDS,
    GNC_SETUP_FIELDS,
    NAVIGATION_INPUT_FIELDS,
    OUTPUT_FIELDS,
)
from hil.core.settings import Setting, checked_settings
from hil.errors import BadInput, DeviceError
from hil.gnc_backends.backend import NO_SETTINGS, WHOLE, BackendInstance
from hil.parts.fmi import step
from hil.parts.fmi.archive import FmuError
from hil.parts.fmi.binary import Fmu
from hil.parts.fmi.description import FmiVariable
from hil.parts.fmi.mapping import MappedElement, map_record

KEY: Final = "gnc.fmu"
_FORMATS: Final = {"f8": "<d", "i8": "<q", "i4": "<i", "u1": "<B"}
_MULTIPLE: Final = 1e-6  # tolerance of the quotient of two steps


def _counted(prefix: str) -> dict[str, str]:
    """Return the arrays of records of what is measured with the fields that have the number that are valid."""
    return {f"{prefix}{name}": f"{prefix}n_{name}" for name in ("samples", "poses", "measurements")}


class StepLayout(NamedTuple):
    """Records of a step. nested: field of an array of records -> field with the number that are valid; dotted names."""

    inputs: Fields
    outputs: Fields
    nested: Mapping[str, str]
    estimates: str
    """Field of the output that is 1 with an estimate; "" if there never is one."""
    estimate: frozenset[str]
    """Fields of an estimate."""


_LAYOUTS: Final = {
    "navigation": StepLayout(
        NAVIGATION_INPUT_FIELDS, OUTPUT_FIELDS["navigation"], _counted(""), "valid",
        frozenset({"r_CT_H", "v_CT_H", "q_CH", "w_CH_C"}),
    ),
    "control": StepLayout(CONTROL_INPUT_FIELDS, OUTPUT_FIELDS["control"], {}, "", frozenset()),
    WHOLE: StepLayout(
        GNC_INPUT_FIELDS, OUTPUT_FIELDS[WHOLE], {"poses": "n_poses", **_counted("measured.")}, "estimate",
        frozenset({"r_CT_H_m", "v_CT_H_mps", "q_CH", "w_CH_C_radps"}),
    ),
}  # fmt: skip


class FmuBackend:
    """The FMU at ``path`` as a backend of ``part``: navigation, control or both. Raises BadInput, made by ``refuse``.

    Its variables have the names of the fields of the part's records. whole: of a whole GNC, with mapping and
    parameters; the settings of others are their tunable parameters. own_process: folder for the unpacked files of a
    process that runs nothing else, so that one instance per process is enough, and that may be killed; None for any
    other process.
    """

    def __init__(
        self,
        path: str,
        part: str,
        refuse: Callable[[str], BadInput],
        whole: GncConfig | None = None,
        own_process: Path | None = None,
    ) -> None:
        self.name = Path(path).name
        self.layout, self._part, self._refuse = _LAYOUTS[part], part, refuse
        self._parameters: Mapping[str, Any] = whole.fmu_parameters if whole is not None else {}
        file = whole.fmu_mapping if whole is not None else None
        mapping = load_fmu_mapping(file) if file is not None else FmuMapping()
        self._tables: list[_Tables] = []
        """Those that no instance uses."""
        try:
            self.fmu = Fmu(Path(path).absolute(), own_process)
            self._map(mapping)
            self._check_parameters()
            if self.only_once and own_process is None:
                instead = "set gnc.fmu_process = true" if part == WHOLE else "it flies as a whole GNC, gnc.fmu"
                raise FmuError(f"can be instantiated only once per process: {instead}")
            self.settings = () if part == WHOLE else self._declared()
        except (FmuError, ValueError) as error:
            raise refuse(str(error)) from error
        self.step_address: int = (step.step_function() if part == WHOLE else step.step_function_of_part()).address

    @property
    def only_once(self) -> bool:
        """Whether the FMU can be instantiated only once per process."""
        return self.fmu.description.only_once

    def check(self, setup: np.record) -> None:
        """Open and close an instance. Raises BadInput if the FMU does not allow it."""
        self.open(setup, np.array([setting.default for setting in self.settings])).close()

    def open(self, setup: np.record, values: np.ndarray = NO_SETTINGS) -> BackendInstance:
        """Return an instance. Raises BadInput if the FMU does not allow it."""
        try:
            return _FmuInstance(self, setup, values)
        except FmuError as error:
            raise self._refuse(str(error)) from error

    def _map(self, mapping: FmuMapping) -> None:
        described, layout = self.fmu.description, self.layout
        self.inputs = map_record(described, layout.inputs, mapping.inputs, ("input",), "inputs")
        self.outputs = map_record(described, layout.outputs, mapping.outputs, ("output",), "outputs")
        self.setup = map_record(described, GNC_SETUP_FIELDS, mapping.setup, ("parameter",), "setup")
        fed = {element.variable.name for element in self.inputs} | set(self._parameters)
        unfed = [v.name for v in described.variables.values() if v.causality == "input" and v.name not in fed]
        if unfed:
            more = f" and {len(unfed) - 1} more" if len(unfed) > 1 else ""
            raise FmuError(f"input {unfed[0]}{more}: no field of that name{self._remedy}")
        self._check_outputs({element.field.name for element in self.outputs})
        self.receives_measurements = any("measurements[" in element.field.name for element in self.inputs)

    def _declared(self) -> tuple[Setting, ...]:
        """Return the tunable parameters that are numbers as settings."""
        of_setup = {element.variable.name for element in self.setup}
        return checked_settings(
            [
                Setting(v.name, float(v.start or 0.0), v.unit or "1")
                for v in self.fmu.description.variables.values()
                if v.causality == "parameter" and v.variability == "tunable" and v.shape == () and v.code != "S"
                and v.name not in of_setup
            ]
        )  # fmt: skip

    def _check_outputs(self, given: set[str]) -> None:
        """Raise FmuError if the outputs lack what the bench cannot do without."""
        layout, demands = self.layout, "force" in {field.name for field in self.layout.outputs}
        if demands and "on" not in given and not {"force", "torque"} <= given:
            missing = "force" if "force" not in given else "torque"
            raise FmuError(f"has no output {missing}[1]: thrusters need force and torque, or on (gnc.fmu_mapping)")
        estimate = layout.estimate & given
        if (estimate or not demands) and estimate != layout.estimate:
            raise FmuError(f"has an estimate without the output {min(layout.estimate - estimate)}")
        if layout.estimates in given and not estimate:
            raise FmuError("has the output estimate without r_CT_H_m, v_CT_H_mps, q_CH and w_CH_C_radps")

    @property
    def _remedy(self) -> str:
        if self._part != WHOLE:
            return ": an FMU of one part has inputs by the names of its record"
        return ": map it (gnc.fmu_mapping) or give it a value (gnc.fmu_parameters)"

    def begin(self, setup: np.record, parameters: Mapping[str, Any]) -> tuple[int, _Tables]:
        """Return a component set up with ``setup`` (GNC_SETUP), and its tables. Raises FmuError."""
        fmu, step_s = self.fmu, float(setup.step_s)
        self._check_step(step_s)
        component = fmu.instantiate("gnc")
        try:
            tables = self._tables.pop() if self._tables else _Tables(self)
            tables.begin(component, step_s)
            self._set_parameters(component, setup, {**self._parameters, **parameters})
            fmu.initialise(component)
        except FmuError:
            fmu.free(component)
            raise
        return component, tables

    def free(self, component: int, tables: _Tables) -> None:
        """End a component; its tables serve another one."""
        self.fmu.free(component)
        self._tables.append(tables)

    def _check_step(self, step_s: float) -> None:
        fixed_s = self.fmu.description.step_s
        if fixed_s is None:
            return
        ratio = step_s / fixed_s if fixed_s > 0.0 else math.nan
        if not (round(ratio) >= 1 and abs(ratio - round(ratio)) < _MULTIPLE * ratio):
            raise FmuError(f"allows steps of {fixed_s:g} s and multiples: step_s is {step_s:g} s")

    def _set_parameters(self, component: int, setup: np.record, parameters: Mapping[str, Any]) -> None:
        """Set the parameters that are fields of GNC_SETUP, in the FMU's units, and the scenario's parameters."""
        block = np.asarray(setup).tobytes()
        for access, variables in _by_access(self.setup).items():
            places = {variable.name: i for i, variable in enumerate(variables)}
            values = [variable.start_values for variable in variables]
            for element in self.setup:
                if (number := places.get(element.variable.name)) is not None:
                    (value,) = struct.unpack_from(_FORMATS[element.field.code], block, element.offset)
                    values[number][element.index] = (value - element.shift) / element.factor
            self.fmu.set_values(component, access, variables, [number for row in values for number in row])
        for name, value in parameters.items():
            self.fmu.set_variable(component, name, value)

    def _check_parameters(self) -> None:
        for name in self._parameters:
            variable = self.fmu.description.variables.get(name)
            if variable is None:
                raise FmuError(f"gnc.fmu_parameters: has no variable {name!r}")
            if variable.causality in ("output", "calculatedParameter", "independent", "structuralParameter"):
                raise FmuError(f"gnc.fmu_parameters: {name} is of causality {variable.causality} and cannot be set")


class _FmuInstance(BackendInstance):
    def __init__(self, backend: FmuBackend, setup: np.record, values: np.ndarray) -> None:
        self._backend, self._names = backend, [setting.name for setting in backend.settings]
        self._component, self._tables = backend.begin(setup, dict(zip(self._names, map(float, values), strict=False)))
        super().__init__(backend.step_address, self._tables.address, free=self._free_component)

    @property
    def message(self) -> bytes:
        """Last message of the FMU."""
        return self._backend.fmu.log.value

    def set_settings(self, values: np.ndarray) -> None:
        """Set the tunable parameters. Raises DeviceError if the FMU refuses one."""
        try:
            for name, value in zip(self._names, values, strict=False):
                self._backend.fmu.set_variable(self._component, name, float(value))
        except FmuError as error:
            raise DeviceError("gnc", str(error)) from error

    def _free_component(self, _address: int) -> None:
        self._backend.free(self._component, self._tables)


class _Tables:
    """Tables of one component at a time, which ``hil.parts.fmi.step`` reads; ``address``: of the COMPONENT."""

    def __init__(self, steps: FmuBackend) -> None:
        self._kept: list[np.ndarray] = []
        self._started: list[tuple[np.ndarray, np.ndarray]] = []
        fmu, layout, outputs = steps.fmu, steps.layout, steps.outputs
        self._fmu = fmu
        block = self._keep(np.zeros(1, step.COMPONENT))
        table = self._table = block.view(np.recarray)[0]
        version = fmu.description.version
        table.version, table.do_step = version, fmu.address("DoStep")
        self._fill(table.input, "Set", [element for element in steps.inputs if element.field.group < 0])
        input_of, output_of = record_dtype(layout.inputs), record_dtype(layout.outputs)
        for nested, (name, count) in zip(table.nested, layout.nested.items(), strict=False):
            mine = [element for element in steps.inputs if element.field.name.startswith(f"{name}[")]
            n = field_of(input_of, name)[0].shape[0]
            groups = self._keep(np.zeros(n, step.GROUP)).view(np.recarray)
            for i in range(n):
                self._fill(groups[i], "Set", [element for element in mine if element.field.group == i])
            nested.groups, nested.n, nested.count_offset = groups.ctypes.data, n, offset_of(input_of, count)
        self._fill(table.output, "Get", outputs)
        given = {element.field.name for element in outputs}
        table.text_offset = offset_of(output_of, "text")
        if "on" in given and "direct" not in given and "force" not in given:
            table.direct = offset_of(output_of, "direct")
        if layout.estimates and given >= layout.estimate and layout.estimates not in given:
            table.estimate = offset_of(output_of, layout.estimates)
        table.log = ctypes.addressof(fmu.log)
        prefix = f"fmi{version}DoStep"
        table.step_text, table.end_text = _text(f"{prefix} failed"), _text("the FMU requests the end of the simulation")
        self.address: int = block.ctypes.data

    def begin(self, component: int, step_s: float) -> None:
        """Use the tables for another component; ``step_s``: its steps."""
        self._table.component, self._table.step_s = component, step_s
        for values, start in self._started:
            values[...] = start

    def _fill(self, group: np.record, verb: str, elements: Sequence[MappedElement]) -> None:
        """Write the copies of ``elements`` and a call for each type to ``group`` (GROUP). verb: "Set" or "Get"."""
        copies = self._keep(np.zeros(len(elements), step.COPY))
        places: dict[str, tuple[np.ndarray, int]] = {}
        calls = []
        for access, variables in _by_access(elements).items():
            references = self._keep(np.array([variable.reference for variable in variables], np.uint32))
            values = self._keep(np.zeros(sum(variable.size for variable in variables), variables[0].code))
            first = 0
            for variable in variables:
                places[variable.name] = (values, first)
                values[first : first + variable.size] = variable.start_values  # of elements that no field has
                first += variable.size
            self._started.append((values, values.copy()))
            function = f"{verb}{access}"
            text = _text(f"fmi{self._fmu.description.version}{function} failed")
            calls.append(
                (self._fmu.address(function), references.ctypes.data, len(references), values.ctypes.data, first, text)
            )
        for row, element in zip(copies, elements, strict=True):
            values, first = places[element.variable.name]
            row["offset"], row["field_code"] = element.offset, step.CODES.index(element.field.code)
            row["address"] = values.ctypes.data + values.itemsize * (first + element.index)
            row["code"] = step.CODES.index(element.variable.code)
            if verb == "Get":
                row["factor"], row["shift"] = element.factor, element.shift
            else:
                row["factor"], row["shift"] = 1.0 / element.factor, -element.shift / element.factor
            row["text"] = _text(f"{element.variable.name} is not a value of {element.field.name}")
        made = self._keep(np.array(calls, step.CALL)) if calls else self._keep(np.zeros(0, step.CALL))
        group.copies, group.n_copies = copies.ctypes.data, len(copies)
        group.calls, group.n_calls = made.ctypes.data, len(made)

    def _keep(self, array: np.ndarray) -> np.ndarray:
        self._kept.append(array)
        return array


def _by_access(elements: Iterable[MappedElement]) -> dict[str, list[FmiVariable]]:
    """Return the variables of ``elements``, each once, by the functions that set and get them."""
    by_access: dict[str, dict[str, FmiVariable]] = {}
    for element in elements:
        by_access.setdefault(element.variable.access, {})[element.variable.name] = element.variable
    return {access: list(variables.values()) for access, variables in by_access.items()}


def _text(text: str) -> np.ndarray:
    block = np.zeros(step.FIELD_TEXT, np.uint8)
    encoded = text.encode()[: step.FIELD_TEXT - 1]
    block[: len(encoded)] = np.frombuffer(encoded, np.uint8)
    return block
