"""Plant of the bench as an FMU, flown by another program against a GNC as an FMU: the truth is that of the run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.core.gnc_records import GNC_SETUP_FIELDS
from hil.core.messages import CYCLE
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.fmi.mapping import record_fields
from hil.session.gnc_setup import gnc_setup
from tests.support.external_gnc import c_example
from tests.support.fmu import example_fmu

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("campaign")]

STEP_S = 0.02


class _Model:
    """An FMU in fmpy."""

    def __init__(self, path: Path, version: int) -> None:
        fmpy = pytest.importorskip("fmpy")
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        described = fmpy.read_model_description(str(path))
        token = described.guid if version == 2 else described.instantiationToken
        self.version = version
        self.fmu = (FMU2Slave if version == 2 else FMU3Slave)(
            guid=token,
            unzipDirectory=fmpy.extract(str(path)),
            modelIdentifier=described.coSimulation.modelIdentifier,
            instanceName=path.stem,
        )
        self.fmu.instantiate()
        self.variables = {v.name: v for v in described.modelVariables}

    def size(self, names: list[str]) -> int:
        return sum(
            int(np.prod([int(d.start) for d in self.variables[name].dimensions or ()], dtype=int)) for name in names
        )

    def start(self) -> None:
        if self.version == 2:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def get(self, kind: str, names: list[str]) -> Any:
        references = [self.variables[name].valueReference for name in names]
        more = {} if self.version == 2 else {"nValues": self.size(names)}
        return getattr(self.fmu, f"get{kind}")(references, **more)

    def set(self, kind: str, names: list[str], values: Any) -> None:
        getattr(self.fmu, f"set{kind}")([self.variables[name].valueReference for name in names], values)


def links(source: _Model, target: _Model) -> dict[str, list[str]]:
    """Return the outputs of ``source`` that ``target`` has as inputs, by their type."""
    found: dict[str, list[str]] = {}
    for name, variable in source.variables.items():
        if variable.causality == "output" and name in target.variables:
            found.setdefault(variable.type, []).append(name)
    return found


def set_up(gnc: _Model) -> None:
    """Set the parameters that ``hil`` sets from the scenario."""
    setup = gnc_setup(load_scenario("scheme-1").value)
    for field in record_fields(GNC_SETUP_FIELDS):
        values = np.ravel(setup[field.name]).tolist()
        names = [f"{field.name}{suffix}" for suffix in field.suffixes] if gnc.version == 2 else [field.name]
        gnc.set(gnc.variables[names[0]].type, names, values)


@pytest.mark.parametrize("version", [2, 3])
def test_plant_flown_by_fmpy_has_the_truth_of_the_run(tmp_path: Path, version: int) -> None:
    validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu
    path = tmp_path / "plant.fmu"
    assert execute(["fmu-export", "scheme-1", "-o", str(path), "--fmi", str(version), "--seed", "5"]) == 0
    assert validate_fmu(str(path)) == []
    made = example_fmu(tmp_path, version)
    assert validate_fmu(str(made)) == []
    plant, gnc = _Model(path, version), _Model(made, version)
    set_up(gnc)
    for model in (gnc, plant):
        model.start()
    sensed, commanded = links(plant, gnc), links(gnc, plant)
    assert sum(len(names) for names in sensed.values()) > 20
    real = "Real" if version == 2 else "Float64"
    where = [f"truth_r_CT_H_m[{i}]" for i in (1, 2, 3)] if version == 2 else ["truth_r_CT_H_m"]

    scenario = load_scenario("scheme-1", [f"gnc.library={c_example(tmp_path)}"]).value
    runner = CaseRunner(scenario, load_rig("mock").value, scenario.duration_s)
    rows = np.zeros(runner.cycles, CYCLE)
    runner.run(scenario, 5, rows)
    truth = [plant.get(real, where)]
    for k in range(len(rows) - 1):
        for kind, names in sensed.items():
            gnc.set(kind, names, plant.get(kind, names))
        gnc.fmu.doStep(k * STEP_S, STEP_S)
        for kind, names in commanded.items():
            plant.set(kind, names, gnc.get(kind, names))
        plant.fmu.doStep(k * STEP_S, STEP_S)
        truth.append(plant.get(real, where))
    deviation = np.abs(np.array(truth) - rows["truth"]["r_CT_H"])
    assert len(truth) == 20001
    assert deviation.max() < 1e-9


def test_export_without_a_compiler_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    out = tmp_path / "plant.fmu"
    assert execute(["fmu-export", "scheme-1", "-o", str(out), "--duration", "2"]) == 2
    assert "install a C compiler, or set CC to one" in capsys.readouterr().err
    assert not out.exists()
