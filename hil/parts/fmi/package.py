"""FMUs made of a model in C: model description, tables of the variables, binary for this computer, archive."""

from __future__ import annotations

import hashlib
import itertools
import os
import shutil
import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from hil.core.build_info import VERSION
from hil.core.surroundings import temporary_folder
from hil.errors import BadInput
from hil.parts.fmi.archive import DESCRIPTION
from hil.parts.fmi.binary import platform_folders

SHELL: Final = Path(__file__).parent / "shell"
_TYPES: Final = {"f8": "FMI_F8", "i4": "FMI_I4", "i8": "FMI_I8", "u1": "FMI_U1"}
_ELEMENTS_3: Final = {"f8": "Float64", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}
_UNITS: Final[Mapping[str, Mapping[str, int]]] = {
    "s": {"s": 1},
    "m": {"m": 1},
    "kg": {"kg": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N m": {"kg": 1, "m": 2, "s": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s^2": {"rad": 1, "s": -2},
    "rad^2": {"rad": 2},
    "m/s": {"m": 1, "s": -1},
    "m/s^2": {"m": 1, "s": -2},
    "m^2": {"m": 2},
    "m rad": {"m": 1, "rad": 1},
    "1/s": {"s": -1},
    "1/s^2": {"s": -2},
    "kg m^2": {"kg": 1, "m": 2},
}
_FLAGS: Final = ("-std=c11", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off")
_ZIP_DATE: Final = (1980, 1, 1, 0, 0, 0)  # the same model makes the same file


@dataclass(frozen=True)
class ModelVariable:
    """A variable of a model. offset: of its first element in the model's block, bytes; code: f8, i4, i8 or u1.

    causality: "input", "output" or "parameter". unit: SI unit of a field table.
    """

    name: str
    causality: str
    code: str
    offset: int
    shape: tuple[int, ...] = ()
    unit: str = "1"
    meaning: str = ""
    tunable: bool = False
    """A parameter that may change during the run."""

    @property
    def size(self) -> int:
        return int(np.prod(self.shape, dtype=int))


@dataclass(frozen=True)
class Model:
    """A model in C. start: its block with the start values. sources: C files; objects: compiled files.

    resources: files that the model reads. step_s: the only step allowed, None for any. extra: further files of the
    archive, by name in it.
    """

    name: str
    description: str
    variables: Sequence[ModelVariable]
    start: bytes
    sources: Sequence[Path]
    objects: Sequence[Path] = ()
    resources: Mapping[str, bytes] = field(default_factory=dict)
    step_s: float | None = None
    duration_s: float | None = None
    include: Sequence[Path] = ()
    extra: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def token(self) -> str:
        """Token that binds the binary to the description."""
        digest = hashlib.sha256(self.name.encode() + self.start)
        for path in (*self.sources, *self.objects):
            digest.update(path.read_bytes())
        for content in self.resources.values():
            digest.update(content)
        digest.update(repr(list(self.variables)).encode())
        text = digest.hexdigest()
        return f"{{{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:32]}}}"


def build(model: Model, version: int, out: Path) -> None:
    """Write the FMU of ``model`` for FMI ``version``, 2 or 3, with a binary for this computer, to ``out``.

    Raises BadInput without a C compiler, or if the file cannot be written.
    """
    with temporary_folder("fmu") as name:
        folder = Path(name)
        tables = folder / "fmi_tables.c"
        tables.write_text(tables_in_c(model, version))
        binary = folder / f"{model.name}.so"
        sources = [SHELL / "fmi_shell.c", tables, *model.sources]
        _compile(sources, model, version, binary)
        files = {
            DESCRIPTION: describe(model, version),
            f"binaries/{platform_folders(version)[0]}/{binary.name}": binary.read_bytes(),
            **{f"resources/{name}": content for name, content in model.resources.items()},
            **{f"sources/{path.name}": path.read_bytes() for path in (*sources, SHELL / "fmi_shell.h")},
            **{f"sources/{path.name}": path.read_bytes() for folder in model.include for path in folder.glob("*.h")},
            **model.extra,
        }
        if version == 3:
            files["sources/buildDescription.xml"] = _build_description(model, [path.name for path in sources])
        _write_zip(files, folder / "made.fmu")
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            shutil.move(folder / "made.fmu", out)
        except OSError as error:
            raise BadInput.single(str(out), "", f"cannot be written: {error.strerror}") from error


def _compile(sources: Sequence[Path], model: Model, version: int, out: Path) -> None:
    compiler = os.environ.get("CC", "cc")
    include = [f"-I{folder}" for folder in (SHELL, *model.include)]
    command = [compiler, *_FLAGS, f"-DFMI={version}", *include, *map(str, sources), *map(str, model.objects)]
    try:
        done = subprocess.run([*command, "-o", str(out), "-lm"], capture_output=True, text=True, check=False)
    except OSError as error:
        text = f"{compiler}: cannot be started ({error.strerror}): install a C compiler, or set CC to one"
        raise BadInput.single("C compiler", "", text) from error
    if done.returncode != 0:
        raise BadInput.single("C compiler", "", f"{compiler} failed: {done.stderr.strip().splitlines()[-1:]}")


def tables_in_c(model: Model, version: int) -> str:
    """Return the C source of the tables that ``fmi_shell.h`` names."""
    rows = []
    for variable in model.variables:
        may_be_set = int(variable.causality != "output")
        size = int(variable.code[1])
        if version == 3:
            rows.append((variable.offset, variable.size, _TYPES[variable.code], may_be_set))
        else:
            rows += [(variable.offset + i * size, 1, _TYPES[variable.code], may_be_set) for i in range(variable.size)]
    table = "\n".join(f"    {{{', '.join(map(str, row))}}}," for row in rows)
    block = ",".join(map(str, model.start))
    return (
        f'#include "fmi_shell.h"\n\nconst fmi_variable fmi_variables[] = {{\n{table}\n}};\n'
        f"const uint32_t fmi_n_variables = {len(rows)};\n"
        f'const char fmi_token[] = "{model.token}";\n'
        f"const size_t fmi_block_bytes = {len(model.start)};\n"
        f"const unsigned char fmi_start_block[] = {{{block}}};\n"
    )


def describe(model: Model, version: int) -> bytes:
    """Return the model description."""
    attributes = {
        "fmiVersion": f"{version}.0",
        "modelName": model.name,
        "guid" if version == 2 else "instantiationToken": model.token,
        "description": model.description,
        "generationTool": f"hil {VERSION}",
        "variableNamingConvention": "structured",
    }
    root = Element("fmiModelDescription", attributes)
    simulation = SubElement(root, "CoSimulation", modelIdentifier=model.name)
    fixed = model.step_s is not None
    simulation.set("canHandleVariableCommunicationStepSize", "false" if fixed else "true")
    if fixed and version == 3:
        simulation.set("fixedInternalStepSize", repr(model.step_s))
    if version == 2 and not model.objects:
        files = SubElement(simulation, "SourceFiles")
        for name in ("fmi_shell.c", "fmi_tables.c", *(path.name for path in model.sources)):
            SubElement(files, "File", name=name)
    units = SubElement(root, "UnitDefinitions")
    for unit in sorted({variable.unit for variable in model.variables} - {"1", ""} | {"s"}):
        exponents = {base: str(n) for base, n in _UNITS[unit].items()}
        SubElement(SubElement(units, "Unit", name=unit), "BaseUnit", exponents)
    experiment = SubElement(root, "DefaultExperiment", startTime="0.0")
    if model.duration_s is not None:
        experiment.set("stopTime", repr(model.duration_s))
    if model.step_s is not None:
        experiment.set("stepSize", repr(model.step_s))
    _variables(root, model, version)
    indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root)


def _variables(root: Element, model: Model, version: int) -> None:
    """Append the variables and the structure of ``model``."""
    section = SubElement(root, "ModelVariables")
    outputs = []
    reference = 0
    for variable in model.variables:
        values = np.frombuffer(model.start, variable.code, variable.size, variable.offset)
        is_parameter = variable.causality == "parameter"
        common = {
            "causality": variable.causality,
            "variability": "discrete" if not is_parameter else "tunable" if variable.tunable else "fixed",
            **({"description": variable.meaning} if variable.meaning else {}),
        }
        is_output = variable.causality == "output"
        unit = {"unit": variable.unit} if variable.code == "f8" and variable.unit not in ("1", "") else {}
        if version == 3:
            start = {} if is_output else {"start": " ".join(repr(v.item()) for v in values)}
            names = {"name": variable.name, "valueReference": str(reference)}
            element = SubElement(section, _ELEMENTS_3[variable.code], {**names, **common, **start, **unit})
            for n in variable.shape:
                SubElement(element, "Dimension", start=str(n))
            outputs += [str(reference)] * is_output
            reference += 1
            continue
        indices = itertools.product(*(range(1, n + 1) for n in variable.shape))
        for index, value in zip(indices, values, strict=True):
            name = f"{variable.name}[{','.join(map(str, index))}]" if index else variable.name
            element = SubElement(section, "ScalarVariable", {"name": name, "valueReference": str(reference), **common})
            start = {} if is_output else {"start": repr(value.item())}
            SubElement(element, "Real" if variable.code == "f8" else "Integer", {**start, **unit})
            reference += 1
            outputs += [str(reference)] * is_output
    structure = SubElement(root, "ModelStructure")
    if version == 3:
        SubElement(section, "Float64", name="time", valueReference=str(reference), causality="independent", unit="s",
                   variability="continuous")  # fmt: skip
        for name in ("Output", "InitialUnknown"):
            for output in outputs:
                SubElement(structure, name, valueReference=output)
        return
    for name in ("Outputs", "InitialUnknowns"):
        if outputs:
            parts = SubElement(structure, name)
            for output in outputs:
                SubElement(parts, "Unknown", index=output)


def _build_description(model: Model, sources: Sequence[str]) -> bytes:
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=model.name)
    files = SubElement(configuration, "SourceFileSet", language="C11")
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    SubElement(files, "PreprocessorDefinition", name="FMI", value="3")
    indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root)


def _write_zip(files: Mapping[str, bytes], out: Path) -> None:
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, _ZIP_DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, content)
