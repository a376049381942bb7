"""GNC in an FMU for co-simulation (FMI 2.0, 3.0): the same interface to the cycle as a shared library."""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from hil.config.fmu_mapping import FmuMapping
from hil.config.load import load_fmu_mapping
from hil.config.scenario import GncConfig
from hil.core.gnc_records import GNC_INPUT, GNC_INPUT_FIELDS, GNC_OUTPUT_FIELDS, GNC_SETUP_FIELDS
from hil.core.messages import MAX_POSES
from hil.errors import BadInput
from hil.fmi import step
from hil.fmi.archive import FmuError
from hil.fmi.binary import Fmu
from hil.fmi.description import FmiVariable
from hil.fmi.mapping import MappedElement, map_record
from hil.gnc_backends.shared_library import Instance

KEY: Final = "gnc.fmu"
_ESTIMATE: Final = frozenset({"r_CT_H_m", "v_CT_H_mps", "q_CH", "w_CH_C_radps"})
_FORMATS: Final = {"f8": "<d", "i8": "<q", "i4": "<i", "u1": "<B"}
_MULTIPLE: Final = 1e-6  # tolerance of the quotient of two steps


class FmuLibrary:
    """The FMU of a scenario's GNC. Raises BadInput if it cannot be used.

    source: option or file that names it, for messages. step_address: of a function with the signature of
    ``hil_gnc_step``. own_process: folder for the unpacked files of a process that runs nothing else, so
    that one instance per process is enough, and that may be killed; None for any other process.
    """

    def __init__(self, gnc: GncConfig, source: str = "--set", own_process: Path | None = None) -> None:
        assert gnc.fmu is not None
        self.path = Path(gnc.fmu).absolute()
        self.name = self.path.name
        self._shown, self._source, self._own_process = gnc.fmu, source, own_process is not None
        self._parameters = gnc.fmu_parameters
        self._tables: list[_Tables] = []
        """Those that no instance uses."""
        mapping = load_fmu_mapping(gnc.fmu_mapping) if gnc.fmu_mapping is not None else FmuMapping()
        try:
            self._fmu = Fmu(self.path, own_process)
            self._map(mapping)
        except FmuError as error:
            raise self._refusal(error) from error
        self.step_address: int = step.step_function().address

    @property
    def only_once(self) -> bool:
        """Whether the FMU can be instantiated only once per process."""
        return self._fmu.description.only_once

    def open(self, setup: np.record) -> Instance:
        """Return a GNC set up with ``setup`` (GNC_SETUP). Raises BadInput if the FMU does not allow it."""
        fmu = self._fmu
        try:
            self._check_step(float(setup.step_s))
            component = fmu.instantiate("gnc")
            try:
                tables = self._tables.pop() if self._tables else _Tables(fmu, self.inputs, self.outputs)
                tables.begin(component, float(setup.step_s))
                self._set_parameters(component, setup)
                fmu.initialise(component)
            except FmuError:
                fmu.free(component)
                raise
        except FmuError as error:
            raise self._refusal(error) from error

        def close(_pointer: int) -> None:
            fmu.free(component)
            self._tables.append(tables)

        return Instance(close, tables.address)

    def _map(self, mapping: FmuMapping) -> None:
        """Find the variables of the records, and check what the bench cannot do without."""
        described = self._fmu.description
        if described.only_once and not self._own_process:
            raise FmuError("can be instantiated only once per process: set gnc.fmu_process = true")
        self.inputs = map_record(described, GNC_INPUT_FIELDS, mapping.inputs, ("input",), "inputs")
        self.outputs = map_record(described, GNC_OUTPUT_FIELDS, mapping.outputs, ("output",), "outputs")
        self._setup = map_record(described, GNC_SETUP_FIELDS, mapping.setup, ("parameter",), "setup")
        for name in self._parameters:
            variable = described.variables.get(name)
            if variable is None:
                raise FmuError(f"gnc.fmu_parameters: has no variable {name!r}")
            if variable.causality in ("output", "calculatedParameter", "independent", "structuralParameter"):
                raise FmuError(f"gnc.fmu_parameters: {name} is of causality {variable.causality} and cannot be set")
        fed = {element.variable.name for element in self.inputs} | set(self._parameters)
        unfed = [v.name for v in described.variables.values() if v.causality == "input" and v.name not in fed]
        if unfed:
            more = f" and {len(unfed) - 1} more" if len(unfed) > 1 else ""
            raise FmuError(
                f"input {unfed[0]}{more}: no field of that name: map it (gnc.fmu_mapping) or give it a value "
                "(gnc.fmu_parameters)"
            )
        given = {element.field.name for element in self.outputs}
        if "on" not in given and not {"force", "torque"} <= given:
            missing = "force" if "force" not in given else "torque"
            raise FmuError(f"has no output {missing}[1]: thrusters need force and torque, or on (gnc.fmu_mapping)")
        estimate = _ESTIMATE & given
        if estimate and estimate != _ESTIMATE:
            raise FmuError(f"has an estimate without the output {min(_ESTIMATE - estimate)}")
        if "estimate" in given and not estimate:
            raise FmuError("has the output estimate without r_CT_H_m, v_CT_H_mps, q_CH and w_CH_C_radps")

    def _check_step(self, step_s: float) -> None:
        described = self._fmu.description
        fixed_s = described.step_s
        if fixed_s is None:
            return
        ratio = step_s / fixed_s if fixed_s > 0.0 else math.nan
        if not (round(ratio) >= 1 and abs(ratio - round(ratio)) < _MULTIPLE * ratio):
            raise FmuError(f"allows steps of {fixed_s:g} s and multiples: step_s is {step_s:g} s")

    def _set_parameters(self, component: int, setup: np.record) -> None:
        """Set the parameters that are fields of GNC_SETUP, in the FMU's units, and those of the scenario."""
        block = np.asarray(setup).tobytes()
        for access, variables in _by_access(self._setup).items():
            places = {variable.name: i for i, variable in enumerate(variables)}
            values = [[0.0] * variable.size for variable in variables]
            for element in self._setup:
                if (place := places.get(element.variable.name)) is not None:
                    (number,) = struct.unpack_from(_FORMATS[element.field.code], block, element.offset)
                    values[place][element.index] = (number - element.shift) / element.factor
            self._fmu.set_values(component, access, variables, [number for row in values for number in row])
        for name, value in self._parameters.items():
            self._fmu.set_variable(component, name, value)

    def _refusal(self, error: FmuError) -> BadInput:
        return BadInput.single(self._source, KEY, f'"{self._shown}": {error}')


class _Tables:
    """Tables of one component at a time, which ``hil.fmi.step`` reads; ``address``: of the COMPONENT."""

    def __init__(self, fmu: Fmu, inputs: Sequence[MappedElement], outputs: Sequence[MappedElement]) -> None:
        self._kept: list[np.ndarray] = []
        self._started: list[tuple[np.ndarray, np.ndarray]] = []
        self._fmu = fmu
        block = self._keep(np.zeros(1, step.COMPONENT))
        table = self._table = block.view(np.recarray)[0]
        version = fmu.description.version
        table.version, table.do_step = version, fmu.address("DoStep")
        self._fill(table.input, "Set", [element for element in inputs if element.field.group < 0])
        groups = self._keep(np.zeros(MAX_POSES, step.GROUP)).view(np.recarray)
        for i in range(MAX_POSES):
            self._fill(groups[i], "Set", [element for element in inputs if element.field.group == i])
        table.poses, table.n_poses = groups.ctypes.data, MAX_POSES
        table.poses_offset = step.offset_of(GNC_INPUT, "n_poses")
        self._fill(table.output, "Get", outputs)
        given = {element.field.name for element in outputs}
        table.direct = "on" in given and "direct" not in given and "force" not in given
        table.estimate = given >= _ESTIMATE and "estimate" not in given
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
                self._start_values(values, first, variable)
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

    @staticmethod
    def _start_values(values: np.ndarray, first: int, variable: FmiVariable) -> None:
        """Elements of an array that no field has keep their start values."""
        for i, text in enumerate((variable.start or "").split()[: variable.size]):
            number = {"true": 1.0, "false": 0.0}.get(text)
            try:
                values[first + i] = float(text) if number is None else number
            except (ValueError, OverflowError):
                return

    def _keep(self, array: np.ndarray) -> np.ndarray:
        self._kept.append(array)
        return array


def _by_access(elements: Iterable[MappedElement]) -> dict[str, list[FmiVariable]]:
    """Return the variables of ``elements``, each once, by the functions that set and get them."""
    found: dict[str, dict[str, FmiVariable]] = {}
    for element in elements:
        found.setdefault(element.variable.access, {})[element.variable.name] = element.variable
    return {access: list(variables.values()) for access, variables in found.items()}


def _text(text: str) -> np.ndarray:
    block = np.zeros(step.FIELD_TEXT, np.uint8)
    encoded = text.encode()[: step.FIELD_TEXT - 1]
    block[: len(encoded)] = np.frombuffer(encoded, np.uint8)
    return block
