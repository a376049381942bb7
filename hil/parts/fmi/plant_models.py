"""Parts of the plant that a scenario has in FMUs, set up for a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hil.config.load import Loaded, load_fmu_mapping
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.fmu_mapping import FmuMapping
from hil.core.messages import Array
from hil.errors import BadInput, Problem
from hil.frmn.ring import Telemetry
from hil.loop.bench_gyros import BenchGyros
from hil.loop.core_memory import CoreMemory
from hil.maths.random_streams import NormalRows
from hil.params import dynamics as dynamics_params
from hil.params.dynamics import dss_as_built
from hil.parts.fmi.archive import FmuError
from hil.parts.fmi.model_stage import RECORDS, ModelDssStage, PlantModels
from hil.parts.fmi.plant_model import ModelSource, PlantModel


def plant_models(scenario: Scenario, params: np.record, loaded: Loaded[Scenario] | None = None) -> PlantModels | None:
    """Return the parts that are in FMUs, None if all are built in. Raises BadInput. loaded: for its messages.

    params: DSS_PARAMS of the run.
    """
    if not scenario.models:
        return None
    setup = _setup(scenario, params)
    made: dict[str, PlantModel] = {}
    for name, part in scenario.models.items():
        assert part.fmu is not None
        key = f"{name}.fmu"
        mapping = load_fmu_mapping(part.fmu_mapping) if part.fmu_mapping is not None else FmuMapping()
        source = ModelSource(Path(part.fmu).absolute(), mapping, part.fmu_parameters)
        records = RECORDS[name]
        own = {field.name: setup[field.name] for field in records.setup}
        try:
            made[name] = PlantModel(records, source, own, scenario.sample_s)
        except FmuError as error:
            where = "--set" if loaded is None else loaded.where(key)
            raise BadInput.single(where, key, f'"{part.fmu}": {error}') from error
    return PlantModels(**made)


def model_stage(
    scenario: Scenario,
    memory: CoreMemory,
    field: Array,
    imu_noise: NormalRows,
    sample_sink: Telemetry | None,
    gyros: BenchGyros | None,
) -> ModelDssStage:
    """Return the dynamics simulation of a run of ``scenario`` whose parts in FMUs replace built-in ones."""
    models = plant_models(scenario, memory.params.dss)
    assert models is not None
    return ModelDssStage(models, memory, field, imu_noise, sample_sink, gyros)


def check_models(scenario: Loaded[Scenario], _: Loaded[Rig]) -> list[Problem]:
    """Return why a part of the plant in an FMU cannot be used."""
    try:
        plant_models(scenario.value, dss_as_built(scenario.value, 0), scenario)
        return []
    except BadInput as error:
        return list(error.problems)


def _setup(scenario: Scenario, params: np.record) -> dict[str, Any]:
    """Return the fields of all setup records, SI units."""
    truth = dynamics_params.initial_truth(scenario)
    return {
        "step_s": scenario.sample_s,
        "n_thrusters": params.n_thrusters,
        "minimum_on_s": params.minimum_on_s,
        "orbit_rate_radps": params.orbit_rate,
        "initial_r_CT_H_m": truth["r_CT_H"],
        "initial_v_CT_H_mps": truth["v_CT_H"],
        "initial_q_CH": truth["q_CH"],
        "initial_w_CI_C_radps": truth["w_CI_C"],
        "initial_mass_kg": truth["mass_kg"],
        "inertia_kgm2": params.inertia,
    }
