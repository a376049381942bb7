"""Plant of the bench as an FMU: truth, sensors, thrusters, mock axes of one case, without GNC and without Python.

The FMU holds the machine code of the compiled loop, the one that campaigns run, and its records and random numbers for
one seed. It has the inputs of a GNC as outputs and the outputs of a GNC as inputs.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import llvmlite.binding as llvm
import numba
import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.docking_monitor import DockingMonitorConfig
from hil.core.fields import record_dtype
from hil.core.gnc_records import GNC_INPUT_FIELDS, GNC_OUTPUT_FIELDS, GncState
from hil.core.kernel_library import whole_module
from hil.core.messages import CYCLE
from hil.core.surroundings import temporary_folder
from hil.errors import BadInput, Problem
from hil.gnc.backend_step import BACKENDS, SLOT
from hil.gnc.step import GNC_STATE
from hil.gnc_backends.c_header import HEADER_FILE
from hil.loop.compiled import run_cycles as shell
from hil.loop.compiled.run_cycles import run_cycles
from hil.loop.core import LOOP_STATE
from hil.loop.mock_bench import MOCK_STATE
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.fmi.mapping import record_fields
from hil.parts.fmi.package import Model, ModelVariable, build
from hil.sensors.vision_unit.transit import FRAME_TRANSIT

_OMITTED: Final = ("history", "arrivals", "axes_log", "samples_log")
"""Last arguments of ``run_cycles``, which the FMU does without."""
_PARTS: Final = tuple(inspect.signature(run_cycles).parameters)[: -len(_OMITTED)]
_FIXED: Final = ("params", "field", "leds", "imu_noise", "vision_noise", "travel_draws")
_CHANGED: Final = tuple(name for name in _PARTS if name not in _FIXED)
_CODES: Final = (
    "COMPLETED",
    "FOLLOWING",
    "TRAVEL_LEFT",
    "VISION_SILENT",
    "NOT_FINITE",
    "GNC_FAILED",
    "GNC_HOLDS",
)
"""Reasons for a return of ``run_cycles``."""
_ROWS: Final = {"imu_noise": "cycle", "vision_noise": "exposure", "travel_draws": "exposure"}
"""Parts of which each call gets the rows from a number on."""
_ALIGNMENT: Final = 64
_TRUTH: Final = (
    ("truth_r_CT_H_m", "r_CT_H", "m", "true position"),
    ("truth_v_CT_H_mps", "v_CT_H", "m/s", "true velocity"),
    ("truth_q_CH", "q_CH", "1", "true attitude, scalar last"),
    ("truth_w_CI_C_radps", "w_CI_C", "rad/s", "true rate against inertial space"),
    ("truth_mass_kg", "mass_kg", "kg", "mass of the chaser"),
)
_ENTRY: Final = "hil_run_cycles"
_EXTRA: Final = "extra/hil"


@dataclass(frozen=True)
class PlantCase:
    """The case that the FMU flies. scenario: as the GNC has it; truth: of vehicle, sensors and start."""

    scenario: Scenario
    rig: Rig
    truth: Scenario
    seed: int
    duration_s: float


def export_plant(case: PlantCase, version: int, out: Path) -> None:
    """Write the FMU of ``case`` for FMI ``version``, 2 or 3, to ``out``. Raises BadInput."""
    if models := case.truth.models:
        text = f"{', '.join(models)}: in an FMU already: the exported plant has the built-in models"
        raise BadInput.single("hil fmu-export", f"{next(iter(models))}.fmu", text)
    if case.truth.sensors:
        text = "not available: an exported plant has vision unit and IMU alone"
        raise BadInput([Problem("hil fmu-export", f"sensors.{name}", text) for name in case.truth.sensors])
    alone = {"gnc": case.scenario.gnc.built_in(), "monitor": DockingMonitorConfig()}
    scenario = case.scenario.model_copy(update=alone)
    runner = CaseRunner(scenario, case.rig, case.duration_s)
    prepared = runner.prepared(case.truth.model_copy(update={"monitor": alone["monitor"]}), case.seed)
    arguments = dict(zip(_PARTS, prepared, strict=False))
    with temporary_folder("fmu") as name:
        folder = Path(name)
        loop = _loop_module(prepared)
        (folder / "loop.o").write_bytes(_machine_code(loop))
        data, places = _data(arguments)
        header = folder / "plant_layout.h"
        header.write_text(_layout(arguments, places, len(data), runner.cycles - 1, case.scenario.step_s))
        variables, start = _variables()
        model = Model(
            name="plant",
            description=f"{case.scenario.name} of the bench, seed {case.seed}",
            variables=variables,
            start=start,
            sources=[Path(__file__).with_name("plant.c")],
            objects=[folder / "loop.o"],
            resources={"plant.bin": data},
            step_s=case.scenario.step_s,
            duration_s=case.duration_s,
            include=[HEADER_FILE.parent, folder],
            extra={f"{_EXTRA}/loop.ll": _portable(str(loop)), f"{_EXTRA}/README.txt": _README},
        )
        build(model, version, out)


def _variables() -> tuple[list[ModelVariable], bytes]:
    """Return the variables and the start values of the model's block, whose layout plant.c has."""
    command, sensed = record_dtype(GNC_OUTPUT_FIELDS), record_dtype(GNC_INPUT_FIELDS)
    variables = [
        ModelVariable(f.name, "input", f.code, f.offset, f.shape, f.unit)
        for f in record_fields(GNC_OUTPUT_FIELDS)
        if f.name != "cycle"
    ]
    variables += [
        ModelVariable(f.name, "output", f.code, command.itemsize + f.offset, f.shape, f.unit)
        for f in record_fields(GNC_INPUT_FIELDS)
    ]
    offset = command.itemsize + sensed.itemsize
    for name, field, unit, meaning in _TRUTH:
        shape = CYCLE["truth"][field].shape
        variables.append(ModelVariable(name, "output", "f8", offset, shape, unit, meaning))
        offset += CYCLE["truth"][field].itemsize
    start = np.zeros(1, command)
    start["state"] = GncState.WORKING
    return variables, start.tobytes() + bytes(offset - command.itemsize + 8)


def _data(arguments: Mapping[str, Any]) -> tuple[bytes, dict[str, int]]:
    """Return all parts in one block, and their places; those that a cycle changes lie one after the other."""
    block, places = bytearray(), {}
    for name in (*_FIXED, *_CHANGED):
        block += bytes(-len(block) % _ALIGNMENT)
        places[name] = len(block)
        block += np.asarray(arguments[name]).tobytes()
    return bytes(block), places


def _layout(arguments: Mapping[str, Any], places: Mapping[str, int], size: int, steps: int, step_s: float) -> str:
    """Return plant_layout.h: places of the parts, offsets of the fields, and the call of the loop."""
    truth = []
    at = 0
    for _, name, _, _ in _TRUTH:
        kind = CYCLE["truth"][name]
        n = kind.itemsize // 8
        offset = _offset(LOOP_STATE, "now") + _offset(CYCLE, "truth") + _offset(CYCLE["truth"], name)
        truth.append(f"{{{offset}, {at}, {n}}}")
        at += n
    backends = _offset(LOOP_STATE, "gnc") + _offset(GNC_STATE, "backends") + _offset(BACKENDS, "gnc")
    transit = _offset(LOOP_STATE, "mock") + _offset(MOCK_STATE, "transit")
    numbers = {
        "STEP_S": repr(step_s),
        "CYCLES": steps,
        "BYTES": size,
        "CHANGED_BYTES": size - places[_CHANGED[0]],
        "PARTS": len(_PARTS),
        "OPENED": _offset(LOOP_STATE, "opened"),
        "CYCLE": _offset(LOOP_STATE, "cycle"),
        "END": _offset(LOOP_STATE, "end"),
        "NEXT_EXPOSURE": transit + _offset(FRAME_TRANSIT, "next_exposure"),
        "FIRST_EXPOSURE": transit + _offset(FRAME_TRANSIT, "first_exposure"),
        "STEP_ADDRESS": backends + _offset(SLOT, "step"),
        "INSTANCE": backends + _offset(SLOT, "instance"),
        "TRUTH": at,
        "TRUTH_FIELDS": len(truth),
        "STATE": _PARTS.index("state"),
    }
    lines = ["/* Generated with the FMU: layout of the records of the compiled loop and of plant.bin. */"]
    lines += [f"#define PLANT_{name} {value}" for name, value in numbers.items()]
    lines.append(f"static const size_t PLANT_PART_PLACES[] = {{{', '.join(str(places[name]) for name in _PARTS)}}};")
    lines.append("static const struct { size_t offset, at, n; } PLANT_TRUTH_PLACES[] = {" + ", ".join(truth) + "};")
    lines.append(f"enum {{ {', '.join(f'{name} = {getattr(shell, name)}' for name in _CODES)} }};")
    return "\n".join([*lines, _call(arguments), ""])


def _call(arguments: Mapping[str, Any]) -> str:
    """Return the C function that calls the loop: records are pointers, an array is taken apart as the compiler does it.

    Of an array: its memory and its parent, both null; elements, bytes of one; data; shape; strides.
    """
    types, values = ["int64_t *", "void **"], ["&code", "&raised"]
    for name in (*_PARTS, *_OMITTED):
        if isinstance(arguments.get(name), np.record):
            types.append("void *")
            values.append(f"part[{_PARTS.index(name)}]")
            continue
        if name in arguments:
            array = np.asarray(arguments[name])
            shape, strides, size, itemsize = array.shape, array.strides, array.size, array.itemsize
            data = f"part[{_PARTS.index(name)}]"
            if rows := _ROWS.get(name):
                per_row = len(arguments["samples"]) if name == "imu_noise" else 1
                data += f" + {rows} * {per_row * strides[0]}"
        else:
            shape, strides, size, itemsize, data = (0,), (0,), 0, 0, "nothing"
        types += ["void *", "void *", "int64_t", "int64_t", "void *", *["int64_t"] * 2 * len(shape)]
        values += ["NULL", "NULL", str(size), str(itemsize), data, *map(str, (*shape, *strides))]
    return (
        f"int32_t {_ENTRY}({', '.join(types)});\n"
        "static int64_t plant_loop(unsigned char **part, int64_t cycle, int64_t exposure)\n{\n"
        "    static unsigned char nothing[4096];\n    int64_t code = -1;\n    void *raised = NULL;\n"
        f"    if ({_ENTRY}({', '.join(values)}) != 0)\n        return 7;\n    return code;\n}}"
    )


def _loop_module(arguments: Sequence[Any]) -> llvm.ModuleRef:
    """Return the code of ``run_cycles`` that campaigns run, with one function that other code can call."""
    loop: Any = run_cycles
    loop.compile(tuple(numba.typeof(argument) for argument in arguments))
    compiled = next(iter(loop.overloads.values()))
    text = str(whole_module(compiled.library))
    name = compiled.fndesc.llvm_func_name
    text = re.sub(rf'(define )linkonce_odr (?:range\(.*?\) )?(i32 @)"?{re.escape(name)}"?\(', rf"\1\2{_ENTRY}(", text)
    text = text.replace(name, _ENTRY)
    for counted in ("NRT_incref", "NRT_decref"):  # those of plant.c: the compiler's are of one processor
        definition = rf"^define [^\n]*@{counted}\([^\n]*\n.*?^}}\n"
        text = re.sub(definition, f"declare void @{counted}(ptr)\n", text, flags=re.M | re.S)
    text = re.sub(r"^define linkonce_odr ", "define internal ", text, flags=re.M)
    text = text.replace(" = common local_unnamed_addr global", " = internal local_unnamed_addr global")
    module = llvm.parse_assembly(text)
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, llvm.create_pass_builder(_machine(), llvm.create_pipeline_tuning_options()))
    return module


def _machine() -> Any:
    """Return a target as in the compiled loop, for code that a shared library can hold."""
    config: Any = numba.config
    target = llvm.Target.from_triple(llvm.get_process_triple())
    return target.create_target_machine(
        cpu=config.CPU_NAME or llvm.get_host_cpu_name(), opt=3, reloc="pic", codemodel="default"
    )


def _machine_code(module: llvm.ModuleRef) -> bytes:
    code: bytes = _machine().emit_object(module)
    return code


def _portable(text: str) -> bytes:
    """Return the code without the lines that are of this computer."""
    return re.sub(r"^(target|source_filename) .*\n", "", text, flags=re.M).encode()


def _offset(dtype: np.dtype, name: str) -> int:
    assert dtype.fields is not None
    offset: int = dtype.fields[name][1]
    return offset


_README: Final = b"""This FMU for another system

The binary is compiled from sources/*.c and extra/hil/loop.ll, the intermediate code of LLVM of the compiled loop. With
clang, or any driver of it, for example for Windows:

    clang -O2 -shared -DFMI=2 -Wno-override-module -ffp-contract=off -Isources \\
        sources/*.c extra/hil/loop.ll -o plant.dll

and the file goes to binaries/win64/plant.dll (FMI 3.0: -DFMI=3, binaries/x86_64-windows/plant.dll). Little-endian
64-bit systems only. Results agree to rounding: sin, cos, atan2 and asin are those of the system.
"""
