"""Model description of an FMU: parsed from XML within bounds, the same records for FMI 2.0 and 3.0."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from hil.parts.fmi.archive import FmuError
from hil.parts.fmi.units import FmiUnit, unit_of_bases

_DEPTH_MAX: Final = 40
_ELEMENTS_MAX: Final = 2_000_000
_SIZE_MAX: Final = 100_000  # elements of an array
_TYPES_2: Final = {"Real": "f8", "Integer": "i4", "Enumeration": "i4", "Boolean": "i4", "String": "S"}
_TYPES_3: Final = {
    "Float64": "f8",
    "Float32": "f4",
    "Int8": "i1",
    "UInt8": "u1",
    "Int16": "i2",
    "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4",
    "Int64": "i8",
    "UInt64": "u8",
    "Enumeration": "i8",
    "Boolean": "u1",
    "String": "S",
}
_ACCESS_2: Final = {"Enumeration": "Integer"}
_ACCESS_3: Final = {"Enumeration": "Int64"}


_FLAGS: Final = {"true": 1.0, "false": 0.0}


@dataclass(frozen=True)
class FmiVariable:
    """A variable. type: name in FMI; code: numpy's of its values; access: suffix of its functions, as in fmi2SetReal.

    shape: () for a scalar. unit: name, "" for none.
    """

    name: str
    reference: int
    causality: str
    variability: str
    type: str
    code: str
    access: str
    shape: tuple[int, ...] = ()
    start: str | None = None
    unit: str = ""

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def start_values(self) -> list[float]:
        """Start value of each element; 0 for one that is not stated as a number."""
        values = [0.0] * self.size
        for i, text in enumerate((self.start or "").split()[: self.size]):
            try:
                values[i] = _FLAGS[text] if text in _FLAGS else float(text)
            except ValueError:
                break
        return values

    def element(self, indices: str) -> int | None:
        """Return the number of the element with ``indices``, "2,1", from 1, last one fastest; None for no element."""
        numbers = [int(index) - 1 if index.isdecimal() else -1 for index in indices.split(",")]
        place = 0
        for number, size in itertools.zip_longest(numbers, self.shape, fillvalue=-1):
            if not 0 <= number < size:
                return None
            place = place * size + number
        return place


@dataclass(frozen=True)
class ModelDescription:
    """Model description of an FMU for co-simulation.

    version: 2 or 3. token: guid, or instantiation token. steps_vary: the communication step may change. step_s: the
    step that is fixed, or of which all steps are multiples; None if unlimited.
    """

    version: int
    model: str
    identifier: str
    token: str
    steps_vary: bool
    step_s: float | None
    only_once: bool
    variables: Mapping[str, FmiVariable] = field(default_factory=dict)
    units: Mapping[str, FmiUnit] = field(default_factory=dict)


def parse(text: bytes) -> ModelDescription:
    """Return the model description in ``text``. Raises FmuError."""
    root = _tree(text)
    if root.tag != "fmiModelDescription":
        raise FmuError(f"its model description begins with {root.tag[:40]!r}, expected fmiModelDescription")
    version = root.get("fmiVersion", "")
    if version.startswith("2."):
        number = 2
    elif version.startswith("3."):
        number = 3
    else:
        raise FmuError(f"has FMI version {version[:20]!r}, allowed 2.0, 3.0")
    simulation = root.find("CoSimulation")
    if simulation is None:
        other = "model exchange" if root.find("ModelExchange") is not None else "scheduled execution"
        raise FmuError(f"is for {other} only: export it for co-simulation")
    identifier = simulation.get("modelIdentifier", "")
    if not identifier.isidentifier():
        raise FmuError(f"has the model identifier {identifier[:40]!r}, expected a name of C")
    return ModelDescription(
        version=number,
        model=root.get("modelName", identifier),
        identifier=identifier,
        token=root.get("guid" if number == 2 else "instantiationToken", ""),
        steps_vary=_flag(simulation, "canHandleVariableCommunicationStepSize"),
        step_s=_fixed_step(root, simulation, number),
        only_once=_flag(simulation, "canBeInstantiatedOnlyOncePerProcess"),
        variables=_variables(root, number),
        units={unit.get("name", ""): _unit(unit) for unit in root.iterfind("UnitDefinitions/Unit")},
    )


def _fixed_step(root: Element, simulation: Element, version: int) -> float | None:
    """Return the step that the FMU prescribes, s; None if any is allowed."""
    internal = _number(simulation, "fixedInternalStepSize")
    if internal is not None:
        return internal
    if _flag(simulation, "canHandleVariableCommunicationStepSize"):
        return None
    experiment = root.find("DefaultExperiment")
    return None if experiment is None else _number(experiment, "stepSize")


def _variables(root: Element, version: int) -> dict[str, FmiVariable]:
    section = root.find("ModelVariables")
    elements = list(section) if section is not None else []
    declared = _declared_units(root)
    sizes = {e.get("valueReference"): e.get("start", "") for e in elements}
    variables: dict[str, FmiVariable] = {}
    for element in elements:
        if version == 2:
            inner = next((e for e in element if e.tag in _TYPES_2), None)
            if inner is None:
                continue
            types, access = _TYPES_2, _ACCESS_2
            shape: tuple[int, ...] = ()
        else:
            if element.tag not in _TYPES_3:
                continue  # clocks and binaries
            inner, types, access = element, _TYPES_3, _ACCESS_3
            shape = tuple(_dimension(d, sizes, element.get("name", "")) for d in element.iterfind("Dimension"))
        name = element.get("name", "")
        if name in variables:
            raise FmuError(f"has two variables {name[:80]!r}")
        kind = inner.tag
        start = inner.get("start")
        if version == 3 and kind == "String":
            strings = [e.get("value", "") for e in element.iterfind("Start")]
            start = " ".join(strings) if strings else None
        variables[name] = FmiVariable(
            name=name,
            reference=_whole(element.get("valueReference", ""), f"the value reference of {name}"),
            causality=element.get("causality", "local"),
            variability=element.get("variability", "continuous"),
            type=kind,
            code=types[kind],
            access=access.get(kind, kind),
            shape=shape,
            start=start,
            unit=inner.get("unit") or declared.get(inner.get("declaredType", ""), ""),
        )
        if variables[name].size > _SIZE_MAX:
            raise FmuError(f"variable {name} has {variables[name].size} elements, allowed {_SIZE_MAX}")
    return variables


def _declared_units(root: Element) -> dict[str, str]:
    """Return the units of the declared types."""
    units = {}
    for element in root.iterfind("TypeDefinitions/*"):
        inner = next(iter(element.findall("Real")), element)
        if unit := inner.get("unit"):
            units[element.get("name", "")] = unit
    return units


def _dimension(element: Element, sizes: Mapping[str | None, str], name: str) -> int:
    """Return the size of a dimension; one given by a structural parameter has that parameter's start value."""
    text = element.get("start") or sizes.get(element.get("valueReference"), "")
    return _whole(text, f"a dimension of {name}")


def _unit(element: Element) -> FmiUnit:
    base = element.find("BaseUnit")
    if base is None:
        return FmiUnit(None)
    exponents = {name: int(_number(base, name) or 0) for name in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
    factor, offset = _number(base, "factor"), _number(base, "offset")
    return unit_of_bases(exponents, 1.0 if factor is None else factor, offset or 0.0)


def _flag(element: Element, name: str) -> bool:
    return element.get(name) in ("true", "1")


def _number(element: Element, name: str) -> float | None:
    text = element.get(name)
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FmuError(f"its model description has {name} = {text[:40]!r}, expected a number")
    return value


def _whole(text: str, what: str) -> int:
    if not text.isdecimal() or len(text) > 20:
        raise FmuError(f"its model description has {text[:40]!r} for {what}, expected a whole number")
    return int(text)


def _tree(text: bytes) -> Element:
    """Return the root of the XML document. Documents with a DTD, and so with entities, are refused."""
    builder = TreeBuilder()
    parser = expat.ParserCreate()
    depth = elements = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if depth > _DEPTH_MAX or elements > _ELEMENTS_MAX:
            raise FmuError("its model description is nested too deeply or has too many elements")
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    def doctype(*_: object) -> None:
        raise FmuError("its model description has a document type: entities are not allowed")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(text, True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # of XML, and of encodings that expat does not have
        raise FmuError(f"its model description is not XML in UTF-8 or UTF-16: {error}") from error
    root: Element = builder.close()
    return root
