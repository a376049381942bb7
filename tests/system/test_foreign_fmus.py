"""FMUs of others: the Reference FMUs of the Modelica Association, and one made by pythonfmu.

``HIL_REFERENCE_FMUS`` is a checkout of github.com/modelica/Reference-FMUs, whose models are compiled here.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.fmi.archive import DESCRIPTION
from hil.parts.fmi.binary import OK, Fmu, platform_folders

pytestmark = pytest.mark.slow

MODELS = ("BouncingBall", "Dahlquist", "Feedthrough", "Resource", "Stair", "VanDerPol")
STEP_S = 0.1
PYTHON_GNC = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real

AXES = (1, 2, 3)


class Gncpy(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.values = {}
        inputs = [f"reference_r_CT_H_m[{i}]" for i in AXES] + [f"poses[1].r_TC_C_m[{i}]" for i in AXES]
        for name in inputs:
            self.add(Real, name, Fmi2Causality.input, 0.0)
        self.add(Integer, "n_poses", Fmi2Causality.input, 0)
        for i in AXES:
            self.add(Integer, f"force[{i}]", Fmi2Causality.output, 0)
            self.add(Integer, f"torque[{i}]", Fmi2Causality.output, 0)

    def add(self, kind, name, causality, start):
        self.values[name] = start
        read, write = (lambda: self.values[name]), (lambda value: self.values.__setitem__(name, value))
        variability = Fmi2Variability.discrete
        self.register_variable(kind(name, causality=causality, variability=variability, getter=read, setter=write))

    def do_step(self, t, dt):
        if self.values["n_poses"] > 0:
            for i in AXES:
                error = -self.values[f"poses[1].r_TC_C_m[{i}]"] - self.values[f"reference_r_CT_H_m[{i}]"]
                self.values[f"force[{i}]"] = -1 if error > 0.02 else 1 if error < -0.02 else 0
        return True
"""


def reference_fmu(folder: Path, model: str, version: int) -> Path:
    """Return a Reference FMU, compiled from its sources."""
    root = Path(os.environ.get("HIL_REFERENCE_FMUS", ""))
    if not os.environ.get("HIL_REFERENCE_FMUS"):
        pytest.skip("HIL_REFERENCE_FMUS is not set")
    binary = folder / f"{model}.so"
    sources = [root / "src" / f"fmi{version}Functions.c", root / "src" / "cosimulation.c", root / model / "model.c"]
    options = [
        "-w",
        "-O1",
        "-fPIC",
        "-shared",
        f"-DFMI_VERSION={version}",
        "-DDISABLE_PREFIX",
        f"-I{root / 'include'}",
        f"-I{root / model}",
    ]
    subprocess.run(["cc", *options, *map(str, sources), "-o", str(binary), "-lm"], check=True)
    path = folder / f"{model}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(root / model / f"FMI{version}.xml", DESCRIPTION)
        archive.write(binary, f"binaries/{platform_folders(version)[0]}/{binary.name}")
        for resource in (root / model).glob("y.*"):
            archive.write(resource, f"resources/{resource.name}")
    return path


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("model", MODELS)
def test_reference_fmu_loads_and_steps(tmp_path: Path, model: str, version: int) -> None:
    fmu = Fmu(reference_fmu(tmp_path, model, version))
    component = fmu.instantiate(model)
    fmu.initialise(component)
    real, whole, pointer = ctypes.c_double, ctypes.c_int, ctypes.c_void_p
    for k in range(10):
        if version == 2:
            step = ctypes.CFUNCTYPE(whole, pointer, real, real, whole)(fmu.address("DoStep"))
            assert step(component, k * STEP_S, STEP_S, 1) == OK
        else:
            flag = ctypes.POINTER(ctypes.c_bool)
            kind = ctypes.CFUNCTYPE(whole, pointer, real, real, ctypes.c_bool, flag, flag, flag, ctypes.POINTER(real))
            flags, last = [ctypes.c_bool() for _ in range(3)], real()
            assert kind(fmu.address("DoStep"))(component, k * STEP_S, STEP_S, True, *flags, last) == OK
    if model == "Dahlquist":  # x' = -x by Euler's method in steps of 0.1 s
        x = fmu.description.variables["x"]
        get = ctypes.CFUNCTYPE(whole, pointer, pointer, ctypes.c_size_t, pointer, ctypes.c_size_t)
        reference, value = ctypes.c_uint32(x.reference), real()
        get(fmu.address(f"Get{x.access}"))(component, ctypes.addressof(reference), 1, ctypes.addressof(value), 1)
        assert value.value == pytest.approx(0.9**10, rel=1e-12)
    fmu.free(component)


@pytest.mark.parametrize("isolated", ["true", "false"])
def test_fmu_made_by_pythonfmu_is_run(tmp_path: Path, isolated: str) -> None:
    pytest.importorskip("pythonfmu")
    source = tmp_path / "gncpy.py"
    source.write_text(PYTHON_GNC)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", str(source), "-d", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    settings = (f"gnc.fmu={tmp_path / 'Gncpy.fmu'}", f"gnc.fmu_process={isolated}", "gnc.fmu_timeout_s=5.0")
    scenario, rig = load_scenario("scheme-1", settings).value, load_rig("mock").value
    runner = CaseRunner(scenario, rig, 4.0)
    rows = np.zeros(runner.cycles, CYCLE)
    _, stop = runner.run(scenario, 0, rows)
    assert stop == "completed"
    assert np.abs(rows["command"]["force"]).max() == 1
