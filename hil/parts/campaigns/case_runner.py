"""Runner of a campaign's cases: the compiled loop's records from scenario, rig and seed, and the run itself."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hil.bench import guard as guards
from hil.bench.kinematics import write_axes
from hil.config.load import Loaded
from hil.config.rig import BENCH_AXES, Rig
from hil.config.scenario import Scenario
from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.core.kernel_record import kernel_record
from hil.core.messages import ARRIVAL, AXES, AXES_SAMPLE, CYCLE, IMU_SAMPLE, new
from hil.core.plug_ins import kernel_errors, raised_text
from hil.core.sensor_records import SENSOR_ARRIVAL
from hil.drivers.axes import ServoAxes
from hil.dynamics.imu import IMU_NOISE
from hil.errors import BadInput, LinkTimeout
from hil.gnc.estimation.step_memory import new_memory
from hil.gnc_backends.backend import WHOLE, OwnBackends
from hil.gnc_backends.backend_registry import NO_BACKENDS, backends_of, named
from hil.gnc_backends.library import open_library
from hil.gnc_backends.open_backends import OpenBackends
from hil.loop.compiled import run_cycles as shell
from hil.loop.compiled.run_cycles import run_cycles
from hil.loop.compiled.run_stats import RUN_STATS, run_stats_params, start_run_stats
from hil.loop.core_memory import CoreMemory, frames_in_transit, loop_params, set_truth
from hil.loop.runner import COMPLETED
from hil.maths.random_streams import noise_source
from hil.models.camera_timing import TRAVEL_DRAWS
from hil.params import bench as bench_params
from hil.params import dynamics as dynamics_params
from hil.params import gnc as gnc_params
from hil.params import integrity as integrity_params
from hil.params.ready import settled_s
from hil.safety.monitor import SafetyLimits, hold_trip, safety_limits
from hil.safety.motion_guards import breach_alarm
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.model import VISION_NOISE
from hil.session.assembly import axes_at_start, draw_initial_imu_errors
from hil.session.gnc_setup import gnc_setup

_NO_HISTORY = np.zeros(0, CYCLE)
_NO_AXES_SAMPLES = np.zeros(0, AXES_SAMPLE)
_NO_SENSOR_ARRIVALS = np.zeros(0, SENSOR_ARRIVAL).view(np.recarray)
_NO_IMU_SAMPLES = np.zeros(0, IMU_SAMPLE)


class CaseRunner:
    """Runs cases of one scenario on one mock rig, in memory that is allocated once.

    scenario: as the GNC has it. duration_s: of each run. own: backends of navigation and control that the caller gives;
    each case has an instance of its own. Raises BadInput for a GNC that cannot be flown.
    """

    def __init__(self, scenario: Scenario, rig: Rig, duration_s: float, own: OwnBackends = NO_BACKENDS) -> None:
        self._own = own
        scenario = self._named(scenario)
        self.scenario = scenario
        self.rig = rig
        self.alarm: Alarm | None = None
        """Of the axes or the bench guard, that ended the last case."""
        self.cycles = round(duration_s / scenario.step_s) + 1
        exposures = math.floor(duration_s * rig.vmu.rate_hz) + 2
        self._core = CoreMemory(
            self._fixed_params(), scenario.imu_samples, frames_in_transit(rig, scenario.step_s)
        )  # fmt: skip
        self._state, self._stats = self._core.state, kernel_record(new(RUN_STATS))
        self._memory = new_memory(self._core.params.gnc.navigation.fusion)
        self._imu_noise = np.empty((self.cycles * scenario.imu_samples, IMU_NOISE))
        self._vision_noise = np.empty((exposures, VISION_NOISE))
        self._travel_draws = np.empty((exposures, TRAVEL_DRAWS))
        self._arrivals = np.zeros(0, ARRIVAL).view(np.recarray)
        self._leds = vmu_params.camera(rig)[1]
        whole = open_library(scenario.gnc, "campaign", own.gnc, copies=True)
        backends = backends_of(scenario, own, copies=True) if whole is None else {WHOLE: whole}
        self._backends = OpenBackends(backends, gnc_setup(scenario))

    def _named(self, scenario: Scenario) -> Scenario:
        return named(Loaded(scenario, "campaign", {}), self._own).value

    @property
    def user_error(self) -> BaseException | None:
        """What a Python object of the user has raised in the last case."""
        return self._backends.user_error

    @property
    def _params(self) -> np.record:
        return self._core.params

    def _fixed_params(self) -> np.record:
        """Return LOOP_PARAMS with all parameters of the GNC and the rig."""
        scenario, rig = self.scenario, self.rig
        bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
        self._limits: SafetyLimits = safety_limits(rig, bench_params.axis_guard(rig, scenario))
        params = loop_params(scenario, rig, gnc_params.gnc(scenario), bench, self._limits.guard)
        params.counts = 1
        params.stats = run_stats_params(scenario, rig, settled_s((self.cycles - 1) * scenario.step_s))
        return params

    def set_gnc_scenario(self, scenario: Scenario) -> None:
        """Set the scenario of the GNC; length, rig and thrusters must be the same."""
        self.scenario = self._named(scenario)
        self._core.params = kernel_record(self._fixed_params())
        self._memory = new_memory(self._core.params.gnc.navigation.fusion)
        if self._backends.kinds:
            self._backends.setup = gnc_setup(self.scenario)

    def run(self, truth: Scenario, seed: int, history: np.ndarray | None = None) -> tuple[np.record, str]:
        """Run one case; return its RUN_STATS, valid until the next call, and why it ended.

        truth: the scenario of vehicle, sensors and start. history: (n,) of CYCLE, filled for the first n cycles.
        """
        stats = self._stats
        if interlock := self._load(truth, seed):
            return stats, interlock
        self._backends.user_error = None
        with kernel_errors() as raised, self._backends.opened(self._state.gnc.backends, self._params.gnc.settings):
            code = run_cycles(*self._arguments(truth, seed, _NO_HISTORY if history is None else history))
            stats.ended = code
            if raised:
                self._backends.user_error = raised[0]
                return stats, f"sensor: {raised_text('', raised[0])}"
            return stats, self._reason(int(code))

    def _load(self, truth: Scenario, seed: int) -> str:
        """Set the records of a case before its first cycle; return why the bench could not be armed, "" if it could."""
        self._clear()
        self.alarm = None
        self._set_truth(truth, seed)
        return self._interlock()

    def _arguments(self, truth: Scenario, seed: int, history: np.ndarray = _NO_HISTORY) -> tuple[Any, ...]:
        """Return the arguments of ``run_cycles`` for the case that was loaded last, valid until the next one."""
        return (
            self._params,
            dynamics_params.field(truth),
            self._leds,
            noise_source(seed, "imu").standard_normal(out=self._imu_noise),
            noise_source(seed, "vision").standard_normal(out=self._vision_noise),
            noise_source(seed, "transport").random(out=self._travel_draws),
            self._state,
            self._core.now.samples,
            self._memory,
            self._core.poses,
            self._core.frames,
            self._core.delayed,
            self._stats,
            history,
            self._arrivals,
            _NO_AXES_SAMPLES,
            _NO_IMU_SAMPLES,
            _NO_SENSOR_ARRIVALS,
        )

    def noise(self) -> dict[str, tuple[np.ndarray, float]]:
        """Return the standard normals of the last case, rows in the order of time, and rows per second, by source."""
        imu_hz = self.scenario.imu_samples / self.scenario.step_s
        return {"imu": (self._imu_noise, imu_hz), "vision": (self._vision_noise, self.rig.vmu.rate_hz)}

    def prepared(self, truth: Scenario, seed: int) -> tuple[Any, ...]:
        """Return the arguments of ``run_cycles`` before the first cycle of a case, without library and statistics.

        Raises BadInput if the bench could not be armed at the start pose.
        """
        if interlock := self._load(truth, seed):
            raise BadInput.single(truth.name, "initial", interlock)
        self._params.counts = 0
        return self._arguments(truth, seed)

    def _clear(self) -> None:
        self._core.clear()
        np.asarray(self._stats)[...] = np.zeros((), RUN_STATS)
        for block in (self._memory, self._core.now.samples):
            block.view(np.uint8).fill(0)
        start_run_stats(self._stats)

    def _set_truth(self, truth: Scenario, seed: int) -> None:
        params, state = self._params, self._state
        set_truth(params, truth, self.rig, seed, dynamics_params.dss_as_built(truth, seed))
        integrity_params.set_faults(params.stats.integrity, truth.faults)
        state.end = self.cycles
        state.now.truth = dynamics_params.initial_truth(truth)
        draw_initial_imu_errors(truth, seed, state.now.imu)
        rails, turntable = axes_at_start(truth, self.rig)
        mock = state.mock
        ServoAxes(rails, mock.rails)
        ServoAxes(turntable, mock.turntable)
        params.mock.nominal_axes.rate_max = np.concatenate([mock.rails.rate_max, mock.turntable.rate_max])

    def _interlock(self) -> str:
        """Return why the bench could not be armed at the start pose, "" if it could."""
        state, standing = self._state, new(AXES)
        rest = np.zeros(3)
        write_axes(state.mock.rails.position, rest, state.mock.turntable.position, rest, standing)
        breach = guards.first_beyond_travel(self._limits.guard, standing, self._limits.slack, state.breach)
        if breach == guards.NOTHING:
            return ""
        self.alarm = breach_alarm(0.0, BENCH_AXES, breach, state.breach)
        return str(self.alarm.trip())

    def _reason(self, code: int) -> str:
        """Return why a run ended, with the text of ``hil run``."""
        state = self._state
        if code == shell.COMPLETED:
            return COMPLETED
        if code == shell.VISION_SILENT:
            now_s = self._stats.cycles * self.scenario.step_s
            silent_s, allowed_s = now_s - state.mock.transit.last_rx_s, self.rig.vmu.timeout_s
            return str(LinkTimeout("vmu", f"no answer for {silent_s:.3f} s, allowed {allowed_s:g} s"))
        if code == shell.GNC_FAILED:
            return str(self._backends.failure(state.gnc.backends))
        if code == shell.GNC_HOLDS:
            return str(hold_trip(self._backends.hold_reason(state.gnc.backends)))
        if code == shell.NOT_FINITE:
            setpoint = [*state.next.rail_m, *state.next.gimbal_rad]
            axis = next((i for i, value in enumerate(setpoint) if not math.isfinite(value)), 0)
            return str(table.SETPOINT.trip(BENCH_AXES[axis], str(setpoint[axis]), "a finite number"))
        self.alarm = breach_alarm(0.0, BENCH_AXES, code, state.breach)
        return str(self.alarm.trip())
