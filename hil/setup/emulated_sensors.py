"""Sensors of an emulated rig that are on a wire of their own: what they measure of the emulated axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.sensors import device_of
from hil.core.clock import BenchClock
from hil.core.kernel_record import kernel_record
from hil.core.sensor_records import NORMALS
from hil.drivers.line_sensor.emulator import LineSensorEmulator
from hil.drivers.shared_state import SharedAxisState
from hil.models.faults import SEED_BITS
from hil.params import bench as bench_params
from hil.params.sensors import sensors_of, settings_row
from hil.sensors.check import Trial
from hil.sensors.measurement import noise_of
from hil.setup.emulated_vision import seen_axes


def emulated_sensor(
    scenario: Scenario, rig: Rig, seed: int, board: SharedAxisState, name: str, clock: BenchClock
) -> LineSensorEmulator:
    """Return the emulator of sensor ``name`` of ``scenario``; its kernels are compiled when this returns.

    It measures the pose of the axes, at rest in H and without the state of its module's own, with the noise that the
    modelled sensor has.
    """
    sensors = sensors_of(scenario)
    (kind, config, _), number = sensors[name], list(sensors).index(name)
    protocol = kind.module.wire
    assert protocol is not None
    bench = kernel_record(bench_params.bench(rig, scenario.step_s, scenario.bench))
    seen, trial = seen_axes(scenario, rig, board), Trial(kind, settings_row(kind, config))
    r, q = np.empty(3), np.empty(4)

    def measure_at(t_s: float, count: int) -> Sequence[float] | None:
        pose_of_axes(bench, *seen(t_s), r, q)
        truth = trial.truth
        truth.t_s, truth.r_CT_H, truth.q_CH = t_s, r, q
        for i in range(NORMALS):
            truth.normal[i] = noise_of(seed & SEED_BITS, number, count, i)
        if not trial.measure():
            return None
        values: list[float] = trial.output.sample.value[: len(kind.components)].tolist()
        return values

    measure_at(0.0, 0)
    rate_hz = config.rate_hz or kind.module.rate_hz
    return LineSensorEmulator(device_of(name), protocol, measure_at, (rate_hz, config.latency_s), clock, seed)
