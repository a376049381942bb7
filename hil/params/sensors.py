"""Parameters of the sensors that a scenario adds: addresses, settings and errors of their modules."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from hil.config.scenario import Scenario
from hil.config.sensors import SensorConfig
from hil.core.messages import Array, new
from hil.gnc.sensor_fusion import SENSOR_FUSION_PARAMS
from hil.maths import chi_square
from hil.models.faults import NUMBER
from hil.params.errors import SEED_BITS
from hil.params.faults import fault_rows
from hil.sensors.compiled import addresses
from hil.sensors.measurement import SENSOR_PARAMS
from hil.sensors.module import SensorKind
from hil.sensors.registry import sensors_of

NIS_TAIL: Final = 1e-10
"""False-alarm probability of a mean NIS, of poses and of further sensors."""


class SensorErrorState(NamedTuple):
    """An error of a sensor as a state of the filters. number: of the error in its module. time_s: inf if constant."""

    sensor: int
    number: int
    sigma: float
    time_s: float


def error_states(scenario: Scenario) -> list[SensorErrorState]:
    """Return the errors of all sensors whose standard deviations are above 0, in the order of their states."""
    found = []
    for number, (name, sensor) in enumerate(sensors_of(scenario).items()):
        values = sensor.values(scenario.sensors[name].settings)
        for index, error in enumerate(sensor.module.errors):
            if values[error.sigma] > 0.0:
                time_s = math.inf if error.time_s is None else values[error.time_s]
                found.append(SensorErrorState(number, index, values[error.sigma], time_s))
    return found


def settings_row(sensor: SensorKind, config: SensorConfig) -> Array:
    """Return the settings of a sensor in the order of their declaration."""
    return np.array(list(sensor.values(config.settings).values()), float)


def sensor_sources(scenario: Scenario, seed: int) -> np.record:
    """Return SENSOR_PARAMS: sensors as they truly are. scenario: of the truth."""
    params = new(SENSOR_PARAMS)
    if not scenario.sensors:
        return params
    params.seed = seed & SEED_BITS
    params.faults = fault_rows(scenario, "sensor", seed)
    for row, fault in zip(params.faults.row, (f for f in scenario.faults if f.family == "sensor"), strict=False):
        row[NUMBER] = list(scenario.sensors).index(fault.member)
    for number, (name, sensor) in enumerate(sensors_of(scenario).items()):
        config, source = scenario.sensors[name], params.source[number]
        row = settings_row(sensor, config)
        source.settings[: len(row)] = row
        source.measure, source.models = addresses(sensor).measure, config.source == "model"
        source.sees_bench, source.n = sensor.module.sees == "bench", len(sensor.components)
        source.rate_hz = min(config.rate_hz or sensor.module.rate_hz, 1.0 / scenario.step_s)
        source.latency_s, source.loss = config.latency_s, config.loss_probability
    params.n = len(scenario.sensors)
    return params


def sensor_fusion(scenario: Scenario, first_state: int, gate: float) -> np.record:
    """Return SENSOR_FUSION_PARAMS. first_state: index of the first error of a sensor. gate: probability of a sample.

    gate: that a sound innovation is rejected.
    """
    params, integrity = new(SENSOR_FUSION_PARAMS), scenario.gnc.integrity
    if not scenario.sensors:
        return params
    params.mean_shift, params.cusum_limit = integrity.mean_shift_sigmas, integrity.cusum_limit_sigmas
    params.nis_weight = 1.0 / integrity.nis_window
    params.suspect_after = integrity.close_after
    params.gate = math.sqrt(chi_square.upper_quantile(gate, 1))
    params.nis_limit = chi_square.limit_of_recent_mean(integrity.nis_window, 1, NIS_TAIL)
    states = error_states(scenario)
    for number, (name, sensor) in enumerate(sensors_of(scenario).items()):
        config, slot = scenario.sensors[name], params.slot[number]
        row = settings_row(sensor, config)
        slot.settings[: len(row)] = row
        slot.innovate, slot.enabled, slot.n = addresses(sensor).innovate, config.enabled, len(sensor.components)
        for group in range((slot.n + 2) // 3):
            slot.gate[group] = chi_square.upper_quantile(gate, min(3, slot.n - 3 * group))
        slot.errors = len(sensor.module.errors)
        slot.component[: slot.errors] = [error.component for error in sensor.module.errors]
        for k, state in enumerate(states):
            if state.sensor == number:
                slot.state[state.number] = first_state + k
    params.n = len(scenario.sensors)
    return params
