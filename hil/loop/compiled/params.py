"""Parameters and memory of the compiled loop, from scenario and rig."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import VMU_FRAME, new
from hil.loop.compiled.loop_kernel import LOOP_PARAMS
from hil.loop.monitor_stage import monitor_record
from hil.params import bench as bench_params
from hil.params import dynamics as dynamics_params
from hil.params import vision as vision_params
from hil.params.faults import fault_rows

_TRANSIT_MAX_S: Final = 2.0  # longest delay of a frame: latency and jitter of at most 1 s each
_SPARE_FRAMES: Final = 4


def loop_params(scenario: Scenario, rig: Rig, gnc: np.record, bench: np.record, guard: np.record) -> np.record:
    """Return LOOP_PARAMS of the GNC and the rig, without those of the truth.

    gnc, bench, guard: GNC_PARAMS, BENCH_PARAMS, GUARD.
    """
    params = new(LOOP_PARAMS)
    params.step_s = scenario.step_s
    params.ticks = rig.ticks(scenario.step_s)
    params.tick_s = bench.dt_s
    params.vmu_rate_hz, params.vmu_timeout_s = rig.vmu.rate_hz, rig.vmu.timeout_s
    params.mounting, params.camera = vision_params.mounting(rig), vision_params.camera(rig)[0]
    params.bench, params.guard, params.gnc = bench, guard, gnc
    params.bench_guard = bench_params.bench_guard(rig, scenario)
    return params


def set_truth(params: np.record, scenario: Scenario, truth: Scenario, seed: int, dss: np.record) -> None:
    """Write vehicle, sensors, transport of frames and faults of ``truth`` to ``params`` (LOOP_PARAMS). dss: DSS_PARAMS.

    scenario: as the loop has it. seed: of the run.
    """
    vmu = truth.vmu
    params.dss, params.imu = dss, dynamics_params.imu(truth, seed)
    params.vision = vision_params.vision(truth, seed)
    params.travel = (vmu.latency_s, vmu.latency_jitter_s, vmu.duplicate_probability, vmu.loss_probability)
    params.monitor = monitor_record(scenario, truth, seed)
    params.vmu_faults, params.axis_faults = fault_rows(truth, "vmu", seed), fault_rows(truth, "axis", seed)


def frames_in_transit(rig: Rig, step_s: float) -> np.ndarray:
    """Return memory for all frames in transit at once, each possibly twice: (n,) of VMU_FRAME, zeroed.

    step_s: period of the loop.
    """
    n = 2 * math.ceil((_TRANSIT_MAX_S + step_s) * rig.vmu.rate_hz) + _SPARE_FRAMES
    frames: np.ndarray = np.zeros(n, VMU_FRAME).view(np.recarray)
    return frames
