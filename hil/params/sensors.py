"""Parameters of the sensors that a scenario adds: addresses, settings and errors of their modules."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from hil.config.rig import BenchGeometry
from hil.config.scenario import Scenario
from hil.config.tables.sensors import SensorConfig
from hil.core.messages import Array, new
from hil.core.part import provided
from hil.core.sensor_records import MAX_SENSORS, SENSOR_ERRORS_MAX
from hil.gnc.estimation.sensor_fusion import SENSOR_FUSION_PARAMS
from hil.maths import chi_square, quat
from hil.models.faults import NUMBER, SEED_BITS, VALUE
from hil.params.dynamics import sun_direction
from hil.params.faults import fault_rows
from hil.sensors.measurement import SENSOR_PARAMS

if TYPE_CHECKING:
    from hil.sensors.module import SensorKind

MONITOR: Final = "monitor"
"""Name of the sensor of the table ``[monitor]``."""
NIS_TAIL: Final = 1e-10
"""False-alarm probability of a mean NIS, of poses and of further sensors."""


class LoopSensor(NamedTuple):
    """A sensor of a loop. kind: its module. models: whether its measurements are modelled."""

    kind: SensorKind
    config: SensorConfig
    models: bool


def sensors_of(scenario: Scenario) -> dict[str, LoopSensor]:
    """Return the sensors of the scenario's loop by their names: added ones, then the docking monitor. Raises BadInput.

    The docking monitor is one of them if its interlock acts.
    """
    sensors = _added(scenario)
    if scenario.monitor.source != "none" and scenario.monitor.interlock:
        config = provided("monitor.source", "scenario")(scenario)
        sensors[MONITOR] = LoopSensor(_kind_of(config), config, scenario.monitor.source == "model")
    return sensors


def _added(scenario: Scenario) -> dict[str, LoopSensor]:
    """Return the sensors that the scenario adds: without the docking monitor, whose scene is a file to be read."""
    return {
        name: LoopSensor(_kind_of(config), config, config.source == "model")
        for name, config in scenario.sensors.items()
    }


def _kind_of(config: SensorConfig) -> SensorKind:
    from hil.sensors.registry import sensor  # of few runs

    return sensor(config.kind)


class SensorErrorState(NamedTuple):
    """An error of a sensor as a state of the filters. number: of the error in its module. time_s: inf if constant."""

    sensor: int
    number: int
    sigma: float
    time_s: float


def error_states(scenario: Scenario) -> list[SensorErrorState]:
    """Return the errors of all fused sensors with standard deviations above 0, in the order of their states."""
    states = []
    for number, (kind, config, _) in enumerate(_added(scenario).values()):  # the docking monitor is a witness
        if config.use == "witness":
            continue
        values = kind.values(config.settings)
        for index, error in enumerate(kind.module.errors):
            if values[error.sigma] > 0.0:
                time_s = math.inf if error.time_s is None else values[error.time_s]
                states.append(SensorErrorState(number, index, values[error.sigma], time_s))
    return states


def constant_error_sigmas(scenario: Scenario) -> Array:
    """Return the standard deviations of the constant errors of the sensors, (sensors, SENSOR_ERRORS_MAX), SI."""
    sigmas = np.zeros((MAX_SENSORS, SENSOR_ERRORS_MAX))
    for state in error_states(scenario):
        if math.isinf(state.time_s):
            sigmas[state.sensor, state.number] = state.sigma
    return sigmas


def settings_row(kind: SensorKind, config: SensorConfig) -> Array:
    """Return the settings of a sensor in the order of their declaration."""
    return np.array(list(kind.values(config.settings).values()), float)


def sensor_sources(scenario: Scenario, seed: int) -> np.record:
    """Return SENSOR_PARAMS: sensors as they truly are. scenario: of the truth."""
    params, sensors = new(SENSOR_PARAMS), sensors_of(scenario)
    if not sensors:
        return params
    from hil.sensors.trial import rehearsed  # of few runs

    params.n, params.seed, params.sun_I = len(sensors), seed & SEED_BITS, sun_direction(scenario)
    params.faults = fault_rows(scenario, "sensor", seed, MONITOR)
    names, q_vc = list(sensors), quat.from_matrix(np.array(BenchGeometry(lever_arm_m=(0.0, 0.0, 0.0)).camera_axes))
    faults = [fault for fault in scenario.faults if fault.family in ("sensor", MONITOR)]
    for row, fault in zip(params.faults.row, faults, strict=False):
        row[NUMBER] = names.index(fault.member or MONITOR)
        if fault.family == MONITOR and fault.kind in ("offset", "drift"):  # of the chaser in c: the target moves in v
            row[VALUE : VALUE + 3] = -quat.transform(q_vc, row[VALUE : VALUE + 3].copy())
    for source, (kind, config, models) in zip(params.source, sensors.values(), strict=False):
        row = settings_row(kind, config)
        source.settings[: len(row)] = row
        # those of datagrams are measured in memory; on wires the samples are the wire's
        source.measure, source.models = rehearsed(kind).measure, models or config.source == "udp"
        source.sees_bench, source.n = kind.module.sees == "bench", len(kind.components)
        source.rate_hz = min(config.rate_hz or kind.module.rate_hz, 1.0 / scenario.step_s)
        source.latency_s, source.loss = config.latency_s, config.loss_probability
    return params


def sensor_fusion(scenario: Scenario, first_state: int, gate: float) -> np.record:
    """Return SENSOR_FUSION_PARAMS. first_state: index of the first error of a sensor. gate: probability of a sample.

    gate: that a sound innovation is rejected.
    """
    params, integrity, sensors = new(SENSOR_FUSION_PARAMS), scenario.gnc.integrity, sensors_of(scenario)
    if not sensors:
        return params
    from hil.sensors.trial import rehearsed

    params.n, params.fused = len(sensors), sum(config.use == "fusion" for _, config, _ in sensors.values())
    params.mean_shift, params.cusum_limit = integrity.mean_shift_sigmas, integrity.cusum_limit_sigmas
    params.nis_weight = 1.0 / integrity.nis_window
    params.suspect_after = integrity.close_after
    params.gate = math.sqrt(chi_square.upper_quantile(gate, 1))
    params.nis_limit = chi_square.limit_of_recent_mean(integrity.nis_window, 1, NIS_TAIL)
    states = error_states(scenario)
    for number, (slot, (kind, config, _)) in enumerate(zip(params.slot, sensors.values(), strict=False)):
        values = kind.values(config.settings)
        slot.settings[: len(values)] = list(values.values())
        slot.innovate, slot.enabled, slot.n = rehearsed(kind).innovate, config.enabled, len(kind.components)
        slot.witness = config.use == "witness"
        slot.sigmas, slot.samples = config.interlock_sigmas, config.interlock_samples
        for group in range((slot.n + 2) // 3):
            slot.gate[group] = chi_square.upper_quantile(gate, min(3, slot.n - 3 * group))
        slot.errors = len(kind.module.errors)
        slot.component[: slot.errors] = [error.component for error in kind.module.errors]
        slot.sigma[: slot.errors] = [values[error.sigma] for error in kind.module.errors]
        for k, state in enumerate(states):
            if state.sensor == number:
                slot.state[state.number] = first_state + k
    return params
