"""Mapping of the variables of an FMU to the fields of a record: by name, or by a mapping file."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from hil.config.tables.fmu_mapping import MappedVariables, VariableNames
from hil.core.fields import Fields, record_dtype
from hil.parts.fmi.archive import FmuError
from hil.parts.fmi.description import FmiVariable, ModelDescription
from hil.parts.fmi.units import FmiUnit, to_si

Mapped = Mapping[str, VariableNames | MappedVariables]
_QUATERNION: Final = re.compile(r"(^|[._])q_[A-Z]+$")


@dataclass(frozen=True)
class RecordField:
    """A plain field of a record: dotted name with the index of its record, from 1; unit, "1" for none; type code.

    offset: of the first element, bytes; shape: () for a scalar. group: index of the nested record, -1 for none.
    """

    name: str
    unit: str
    code: str
    offset: int
    shape: tuple[int, ...]
    group: int

    @property
    def suffixes(self) -> list[str]:
        """Endings of the names of the elements in a model description, from 1, last index fastest."""
        indices = itertools.product(*(range(1, n + 1) for n in self.shape))
        return [f"[{','.join(map(str, index))}]" for index in indices] if self.shape else [""]


@dataclass(frozen=True)
class MappedElement:
    """One element of a field, and its place: element ``index`` of ``variable``. SI value = factor * value + offset."""

    field: RecordField
    offset: int
    variable: FmiVariable
    index: int
    factor: float
    shift: float


def record_fields(fields: Fields) -> list[RecordField]:
    """Return the plain fields of numbers of a record; texts are left out."""
    return list(_record_fields(fields, "", 0, -1))


def _record_fields(fields: Fields, prefix: str, base: int, group: int) -> Iterator[RecordField]:
    dtype = record_dtype(fields)
    for field in fields:
        part, offset = dtype.fields[field.name][:2]  # type: ignore[index]
        if isinstance(field.type, str):
            if part.base.kind in "iuf":
                code = part.base.str[1:]
                unit = "1" if field.unit == "SI" else field.unit  # of each component its own: an FMU states none
                yield RecordField(f"{prefix}{field.name}", unit, code, base + offset, part.shape, group)
            continue
        if field.shape == ():
            yield from _record_fields(field.type, f"{prefix}{field.name}.", base + offset, group)
            continue
        assert isinstance(field.shape, int)
        for i in range(field.shape):
            start = base + offset + i * part.base.itemsize
            yield from _record_fields(field.type, f"{prefix}{field.name}[{i + 1}].", start, i)


def map_record(
    description: ModelDescription, fields: Fields, mapped: Mapped, causalities: Sequence[str], table: str
) -> list[MappedElement]:
    """Return all elements of a record that the FMU has.

    mapped: of the mapping file's ``table``. causalities: of variables that are allowed. Raises FmuError.
    """
    leaves = record_fields(fields)
    names = {field.name for field in leaves}
    for name in mapped:
        if name not in names:
            raise FmuError(f"mapping, {table}: no field {name!r}, allowed {_listed(sorted(names))}")
    elements: list[MappedElement] = []
    for field in leaves:
        entry = mapped.get(field.name)
        explicit = entry is not None
        choice = entry if isinstance(entry, MappedVariables) else MappedVariables(variables=entry or field.name)
        places = _places(description, field, choice.variables, explicit, table)
        for (variable, index), (suffix, element) in zip(places, _elements(field, choice), strict=bool(places)):
            if variable.causality not in causalities:
                if explicit:
                    allowed = " or ".join(causalities)
                    raise FmuError(
                        f"{variable.name}, for {table} {field.name}{suffix}: is a variable of causality "
                        f"{variable.causality}, expected {allowed}"
                    )
                break
            if variable.code == "S":
                raise FmuError(f"{variable.name}, for {table} {field.name}{suffix}: is a String, expected a number")
            factor, shift = _conversion(description, variable, field, choice.unit)
            elements.append(MappedElement(field, element, variable, index, factor, shift))
    return elements


def _elements(field: RecordField, choice: MappedVariables) -> list[tuple[str, int]]:
    """Return the elements of ``field`` in the order of the FMU: suffix of the name, offset in the record."""
    size = int(field.code[1])
    elements = [(suffix, field.offset + i * size) for i, suffix in enumerate(field.suffixes)]
    if choice.order == "scalar_first":
        if not _QUATERNION.search(field.name):
            raise FmuError(f"mapping, {field.name}: is no quaternion and has no order")
        elements = [elements[3], *elements[:3]]
    return elements


def _places(
    description: ModelDescription, field: RecordField, variables: VariableNames, explicit: bool, table: str
) -> list[tuple[FmiVariable, int]]:
    """Return (variable, index) of each element; nothing if the FMU has none of them by name."""
    declared, suffixes = description.variables, field.suffixes
    if not isinstance(variables, str):
        if len(variables) != len(suffixes):
            raise FmuError(f"mapping, {table} {field.name}: has {len(suffixes)} elements, not {len(variables)}")
        names: Iterable[str] = variables
    elif variables in declared:
        variable = declared[variables]
        if variable.size != len(suffixes):
            what = f"{table} {field.name}" if variables != field.name else table
            raise FmuError(f"{variables}, for {what}: has {variable.size} elements, expected {len(suffixes)}")
        return [(variable, i) for i in range(variable.size)]
    else:
        names = [f"{variables}{suffix}" for suffix in suffixes]
        from_zero = [f"{variables}{_from_zero(suffix)}" for suffix in suffixes]
        if field.shape and from_zero[0] in declared:
            names = from_zero
        if not explicit and not any(name in declared for name in names):
            return []
    return [_element(description, name, f"{table} {field.name}") for name in names]


def _element(description: ModelDescription, name: str, what: str) -> tuple[FmiVariable, int]:
    """Return (variable, index) of a scalar, or of the element of an array that ``name`` names, as ``force[2]``."""
    variable = description.variables.get(name)
    if variable is not None:
        if variable.shape and variable.size != 1:
            raise FmuError(f"{name}, for {what}: is an array, expected a number, or an element as {name}[1]")
        return variable, 0
    base, bracket, indices = name.removesuffix("]").rpartition("[")
    array = description.variables.get(base) if bracket and name.endswith("]") else None
    if array is None or not array.shape:
        raise FmuError(f"has no variable {name!r}, for {what}")
    if (index := array.element(indices)) is None:
        shape = " x ".join(map(str, array.shape))
        raise FmuError(f"{name}, for {what}: {base} has {shape} elements, counted from 1")
    return array, index


def _from_zero(suffix: str) -> str:
    return re.sub(r"\d+", lambda match: str(int(match[0]) - 1), suffix)


def _conversion(
    description: ModelDescription, variable: FmiVariable, field: RecordField, unit: str | None
) -> tuple[float, float]:
    name = variable.unit if unit is None else unit
    if not name:
        return 1.0, 0.0
    defined = FmiUnit(None) if unit is not None else description.units.get(name, FmiUnit(None))
    try:
        return to_si(defined, name, field.unit)
    except FmuError as error:
        raise FmuError(f"{variable.name}, for {field.name}: {error}") from None


def _listed(names: Sequence[str], most: int = 40) -> str:
    return ", ".join(names[:most]) + (" ..." if len(names) > most else "")
