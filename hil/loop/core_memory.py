"""Memory of the core: its parameters, its state, and the records of the present cycle as Python sees them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hil.config.bench_geometry import errors_as_built
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.kernel_record import kernel_record
from hil.core.messages import CYCLE, MAX_POSES, POSE, VMU_FRAME, imu_samples, new
from hil.loop.core import LOOP_PARAMS, LOOP_STATE
from hil.params import bench as bench_params
from hil.params import dynamics as dynamics_params
from hil.params.bench import set_geometry
from hil.params.faults import fault_rows
from hil.params.sensors import sensor_sources
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.transit import SPARE_FRAMES

_TRANSIT_MAX_S: Final = 3.0  # longest delay of a frame: latency, jitter and a fault's latency, at most 1 s each
_LINE: Final = 64  # bytes of a line of the processor's cache


class CycleData:
    """Records of the present cycle: views into one row of CYCLE, the row that is recorded.

    Each field of CYCLE is an attribute: a record, or for a number an array with the row as first axis, as writing into
    an array is faster than into a record. row: (1,) of CYCLE; None: of its own. samples: of the IMU since the cycle
    before, (n,) of IMU; ``imu`` is their mean.
    """

    def __init__(self, n_samples: int = 1, row: np.ndarray | None = None) -> None:
        self.row = np.zeros(1, CYCLE) if row is None else row
        self.record = kernel_record(self.row.view(np.recarray)[0])
        self.samples = imu_samples(self.row, n_samples)
        records = self.row.view(np.recarray)
        for name in CYCLE.names or ():
            setattr(self, name, kernel_record(records[name][0]) if CYCLE[name].names else self.row[name])

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


def _aligned_state() -> np.ndarray:
    """Return a zeroed LOOP_STATE, (1,), whose covariance of the filters begins a cache line: the loop is 1 % faster."""
    part, at = LOOP_STATE, 0
    for name in ("gnc", "navigation", "fusion", "filters", "p"):
        fields: Any = part.fields
        part, at = fields[name][0], at + fields[name][1]
    block = np.zeros(LOOP_STATE.itemsize + _LINE, np.uint8)
    begin = -(block.ctypes.data + at) % _LINE
    return block[begin : begin + LOOP_STATE.itemsize].view(LOOP_STATE)


class CoreMemory:
    """What the calls of the core (``hil.loop.core``) read and write; shells and stages hold views of it.

    params: LOOP_PARAMS. state: LOOP_STATE, zeroed but for ``not_before_s``. now: records of ``state.now``. poses:
    (MAX_POSES,) of POSE, those of the present cycle. frames, delayed: of VMU_FRAME, see ``run_cycles``.
    """

    def __init__(self, params: np.record, n_samples: int, frames: int) -> None:
        self.params = kernel_record(params)
        block = _aligned_state()
        self.state: np.record = kernel_record(block.view(np.recarray)[0])
        self._bytes = block.view(np.uint8)
        self.clear()
        assert LOOP_STATE.fields is not None
        row: np.ndarray = np.ndarray(1, CYCLE, block.view(np.uint8).data, LOOP_STATE.fields["now"][1])
        self.now = CycleData(n_samples, row)
        self.poses: np.ndarray = np.zeros(MAX_POSES, POSE).view(np.recarray)
        self.frames: np.ndarray = np.zeros(frames, VMU_FRAME).view(np.recarray)
        self.delayed = self.frames.copy()

    def clear(self) -> None:
        """Set the state to that before a run, without truth, errors and axes."""
        self._bytes.fill(0)  # by fields it takes ten times longer
        self.state.vmu.not_before_s = -math.inf

    def view(self, name: str) -> np.record:
        """Return the record ``name`` of the state, for kernels that are called often."""
        return kernel_record(self.state[name])


def frames_in_transit(rig: Rig, step_s: float) -> int:
    """Return how many frames can be on their way at once, each possibly twice, with SPARE_FRAMES more.

    step_s: period of the loop.
    """
    return 2 * math.ceil((_TRANSIT_MAX_S + step_s) * rig.vmu.rate_hz) + SPARE_FRAMES + 1


def loop_params(scenario: Scenario, rig: Rig, gnc: np.record, bench: np.record, guard: np.record) -> np.record:
    """Return LOOP_PARAMS of the GNC and the rig, without those of the truth.

    gnc, bench, guard: GNC_PARAMS, BENCH_PARAMS, GUARD.
    """
    params = new(LOOP_PARAMS)
    params.step_s = scenario.step_s
    params.ticks = rig.ticks(scenario.step_s)
    params.tick_s = bench.dt_s
    params.mock.vmu_rate_hz, params.mock.vmu_timeout_s = rig.vmu.rate_hz, rig.vmu.timeout_s
    params.mounting, params.mock.camera = vmu_params.mounting(rig), vmu_params.camera(rig)[0]
    params.bench, params.guard, params.gnc = bench, guard, gnc
    params.bench_guard = bench_params.bench_guard(rig, scenario)
    return params


def set_truth(params: np.record, truth: Scenario, rig: Rig, seed: int, dss: np.record) -> None:
    """Write vehicle, sensors, transport of frames, faults and the machine of ``truth`` and ``rig`` to ``params``.

    params: LOOP_PARAMS, with those of the rig. dss: DSS_PARAMS.

    seed: of the run.
    """
    vmu = truth.vmu
    params.mock.bench = params.bench
    set_geometry(params.mock.bench, rig, errors_as_built(rig, truth.bench.errors))
    params.mock.mounting = vmu_params.mounting_as_built(rig, truth)
    params.dss, params.imu = dss, dynamics_params.imu(truth, seed)
    params.mock.vision = vmu_params.model(truth, seed)
    params.mock.travel = (vmu.latency_s, vmu.latency_jitter_s, vmu.duplicate_probability, vmu.loss_probability)
    params.sensors = sensor_sources(truth, seed)
    params.vmu_faults, params.mock.axis_faults = fault_rows(truth, "vmu", seed), fault_rows(truth, "axis", seed)
