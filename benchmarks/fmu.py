"""Cost of a GNC as an FMU: per step, compared with fmpy if installed; per case of a campaign, with the library.

python benchmarks/fmu.py
"""

from __future__ import annotations

import ctypes
import importlib.util
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, GncMode
from hil.core.messages import new
from hil.gnc_backends.c_header import HEADER_FILE
from hil.gnc_backends.library import open_library
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.fmi.package import build
from hil.session.gnc_setup import gnc_setup

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "gnc_c"
STEPS, BLOCKS, CASES = 2000, 30, 15
STEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


def made(folder: Path) -> dict[str, str]:
    """Return the settings of the example as a library and as FMUs."""
    library = folder / "gnc.so"
    command = ["cc", "-O2", "-fPIC", "-shared", f"-I{HEADER_FILE.parent}", str(EXAMPLE / "gnc.c")]
    subprocess.run([*command, "-o", str(library), "-lm"], check=True)
    spec = importlib.util.spec_from_file_location("build_fmu", EXAMPLE / "build_fmu.py")
    assert spec is not None
    assert spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    settings = {"library": f"gnc.library={library}"}
    for version in (2, 3):
        build(example.gnc_model([EXAMPLE / "gnc.c"]), version, folder / f"gnc-{version}.fmu")
        settings[f"FMI {version}.0"] = f"gnc.fmu={folder / f'gnc-{version}.fmu'}"
    return settings


def fastest_us(step: Callable[[int], object]) -> float:
    """Return the mean of the fastest block of steps."""
    times = []
    for block in range(BLOCKS):
        begun_s = time.perf_counter()
        for k in range(STEPS):
            step(block * STEPS + k)
        times.append((time.perf_counter() - begun_s) / STEPS)
    return 1e6 * min(times)


def steps(settings: dict[str, str]) -> None:
    """Print the cost of a step, called from Python."""
    for name, setting in settings.items():
        scenario = load_scenario("scheme-1", [setting]).value
        library = open_library(scenario.gnc)
        assert library is not None
        with library.open(gnc_setup(scenario)) as instance:
            sent, output, call = new(GNC_INPUT), new(GNC_OUTPUT), STEP(instance.step_address)
            sent.mode, sent.reference_q_CH = GncMode.RUNNING, (0.0, 0.0, 0.0, 1.0)
            places = instance.address, np.asarray(sent).ctypes.data, np.asarray(output).ctypes.data
            print(f"step, {name:8} {fastest_us(lambda _, call=call, places=places: call(*places)):7.2f} us")


def fmpy_step(path: Path) -> None:
    """Print the cost of the same step by fmpy: all inputs but the poses set, all outputs read."""
    if importlib.util.find_spec("fmpy") is None:
        print("step, fmpy     not installed")
        return
    import fmpy
    from fmpy.fmi2 import FMU2Slave

    described = fmpy.read_model_description(str(path))
    fmu = FMU2Slave(
        guid=described.guid, unzipDirectory=fmpy.extract(str(path)), modelIdentifier="gnc", instanceName="gnc"
    )
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    chosen: dict[tuple[str, str], list[int]] = {}
    for variable in described.modelVariables:
        if not variable.name.startswith("poses"):
            chosen.setdefault((variable.causality, variable.type), []).append(variable.valueReference)
    reals, integers = chosen["input", "Real"], chosen["input", "Integer"]
    values, numbers = [0.0] * len(reals), [0] * len(integers)

    def step(k: int) -> None:
        fmu.setReal(reals, values)
        fmu.setInteger(integers, numbers)
        fmu.doStep(0.02 * k, 0.02)
        fmu.getReal(chosen["output", "Real"])
        fmu.getInteger(chosen["output", "Integer"])

    print(f"step, fmpy     {fastest_us(step):7.2f} us")


def cases(settings: dict[str, str]) -> None:
    """Print the time of a case of scheme 1; the variants take turns."""
    runners = {}
    for name, setting in settings.items():
        scenario = load_scenario("scheme-1", [setting]).value
        runners[name] = scenario, CaseRunner(scenario, load_rig("mock").value, scenario.duration_s)
    times: dict[str, list[float]] = {name: [] for name in runners}
    for seed in range(CASES):
        for name, (scenario, runner) in runners.items():
            begun_s = time.perf_counter()
            runner.run(scenario, seed)
            times[name].append(time.perf_counter() - begun_s)
    fastest = {name: min(found) for name, found in times.items()}
    for name, best_s in fastest.items():
        relative = fastest["library"] / best_s
        print(f"case, {name:8} {1e3 * best_s:7.1f} ms, speed {100.0 * relative:.0f} % of the library's")


def main() -> int:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as name:
        settings = made(Path(name))
        steps(settings)
        fmpy_step(Path(name) / "gnc-2.fmu")
        cases(settings)
    return 0


if __name__ == "__main__":
    sys.exit(main())
