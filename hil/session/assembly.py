"""Assembly of a loop from its parts, for any devices: stages, safety monitor, runner; and the mock devices."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hil.bench import manipulator
from hil.bench.kinematics import axes_of_pose
from hil.bench.manipulator import ChaserMotion, relative_axes
from hil.checks.faults import unfused_sensors
from hil.config.load import Loaded
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, Rails, Rig, Turntable, Vmu
from hil.config.scenario import CYCLES_MAX, Scenario
from hil.core.kernel_record import kernel_record
from hil.core.messages import AXES, CYCLE, Array, PoseFrame, new
from hil.core.part import provided
from hil.drivers.base import AxisGroup, CountsLosses, DiscreteIo, PoseSource
from hil.drivers.mock_axes import MockAxes
from hil.drivers.vmu.transport import Transport
from hil.dynamics.imu import IMU_NOISE
from hil.errors import BadInput, Problem
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.gnc.estimation.filter_monitor import FilterMonitor
from hil.gnc_backends.backend import OwnBackends
from hil.gnc_backends.backend_registry import NO_BACKENDS, backends_of, named
from hil.gnc_backends.base import GncBackend
from hil.gnc_backends.builtin import BuiltinGnc
from hil.gnc_backends.library import key_of, open_library
from hil.gnc_backends.whole import WholeGnc
from hil.loop.bench_gyros import BenchGyros
from hil.loop.bench_stage import NO_INPUTS, BenchStage, SafetyInputs
from hil.loop.controlled_stop import BrakeTimes
from hil.loop.core_memory import CoreMemory, frames_in_transit, loop_params, set_truth
from hil.loop.cycle import CyclesOf, Loop
from hil.loop.overrun_monitor import OverrunMonitor
from hil.loop.rate_keeper import Rate
from hil.loop.run_plan import RunPlan
from hil.loop.runner import Runner
from hil.loop.safety_io_stage import SafetyIo, SafetyIoStage
from hil.loop.sensor_stage import SensorStage
from hil.loop.session_parts import SessionParts
from hil.loop.stages import DssStage, FrameUsed, RunZero, VisionStage
from hil.loop.target_stage import AxesTogether, HeldAxes, TargetInMotion
from hil.maths.random_streams import NormalRows, noise_source
from hil.models.axis_faults import set_axis_faults
from hil.params import bench as bench_params
from hil.params import dynamics as dynamics_params
from hil.params import gnc as gnc_params
from hil.params.sensors import sensors_of
from hil.safety.condition_alarms import HealthAlarms
from hil.safety.monitor import SafetyMonitor, safety_limits
from hil.safety.packet_loss import LeakyBucket, LinkWatch
from hil.session.gnc_setup import approach_event_log, backend_setup, gnc_setup
from hil.session.pose_model import PoseSensor, make_pose_sensor, transport
from hil.session.sample_sources import datagram_sensors, wired_sensors

if TYPE_CHECKING:
    from hil.core.camera_images import ImageSink
    from hil.loop.floating import MeasuredTruth
    from hil.session.floating import SimulatedVehicle

ROWS_MAX = 100_000
"""Rows of a run that are kept in memory, 0.2 GB; of a longer one they are handed over part by part."""
_UNTIL_STOPPED_CYCLES = 2**40
_NO_VISION_M = 1e-3  # range up to which poses are expected
_FRAMES_TO_FORGET = 2.0  # one lost frame drains from the bucket in their time, unless the rig file sets another
_SETTLED = 5.0  # lags after which a robot is within 1 % of its last motion


class Devices(NamedTuple):
    """Devices of a bench. source: the vision unit; io: the digital I/O; target: the axes that move the target.

    held: further axes, by names, that stand during a run.
    """

    rails: AxisGroup
    turntable: AxisGroup
    source: PoseSource
    io: DiscreteIo | None
    target: AxisGroup | None
    held: Mapping[str, AxisGroup] = {}

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes of rails and turntable."""
        return (*self.rails.axis_names, *self.turntable.axis_names)


@dataclass(frozen=True)
class Job:
    """A run to do.

    dispersed: the true scenario, if it differs from the nominal one that guidance, navigation and control are designed
    for. make_backend: makes the GNC backend instead of the scenario's. own: backends of navigation and control that the
    caller gives. paced: a mock rig runs in real time. compiled:
    False for the cycle in Python, also where the compiled loop can run the job. until_stopped: Ctrl-C ends the run,
    instead of ``duration_s``.
    """

    scenario: Loaded[Scenario]
    rig: Loaded[Rig]
    seed: int
    duration_s: float
    speed: float
    dispersed: Scenario | None = None
    make_backend: Callable[[Scenario], GncBackend] | None = None
    paced: bool = False
    compiled: bool = True
    until_stopped: bool = False
    own: OwnBackends = NO_BACKENDS

    def __post_init__(self) -> None:
        """Select the rig's cameras for ``vmu.source = "cameras"``; name the backends and all of their settings.

        Raises BadInput if there are none, and for a run of more cycles than can be recorded.
        """
        object.__setattr__(self, "scenario", named(self.scenario, self.own))
        if not self.rig.value.has_vmu:
            object.__setattr__(self, "scenario", replace(self.scenario, value=without_vision(self.scenario.value)))
        if self.scenario.value.vmu.source == "cameras" and self.rig.value.has_vmu:
            object.__setattr__(self, "rig", with_cameras(self.scenario, self.rig))
        if self.cycles > CYCLES_MAX and not self.until_stopped:
            text = f"{self.duration_s:g}: has {self.cycles} cycles of step_s, at most {CYCLES_MAX} are allowed"
            raise BadInput.single(self.scenario.where("duration_s"), "duration_s", text)

    @property
    def truth(self) -> Scenario:
        """Scenario of vehicle, sensors and start; ``scenario`` is the GNC's."""
        return self.dispersed or self.scenario.value

    @property
    def cycles(self) -> int:
        """Cycles of the run, the one at t = 0 and the one at t = duration included."""
        if self.until_stopped:
            return _UNTIL_STOPPED_CYCLES
        return round(self.duration_s / self.scenario.value.step_s) + 1

    @property
    def waits_for_all(self) -> bool:
        """Whether time stands while a row is recorded: in memory, or in lock-step."""
        rig = self.rig.value
        return (rig.kind == "mock" and not self.paced) or rig.host.time == "lock_step"

    @property
    def ticks(self) -> int:
        """Setpoints per cycle."""
        return self.rig.value.ticks(self.scenario.value.step_s)

    @property
    def tick_s(self) -> float:
        """Period of the rate keeper, the fastest rate that waits for its time, s."""
        return self.scenario.value.step_s / self.ticks


def without_vision(scenario: Scenario) -> Scenario:
    """Return ``scenario`` for a bench without a vision unit: no poses are expected, and none are modelled."""
    integrity = scenario.gnc.integrity.model_copy(update={"vision_range_m": _NO_VISION_M})
    errors = scenario.vmu.errors.model_copy(update={"needs_view": True})
    gnc = scenario.gnc.model_copy(update={"integrity": integrity})
    return scenario.model_copy(update={"gnc": gnc, "vmu": scenario.vmu.model_copy(update={"errors": errors})})


def with_cameras(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> Loaded[Rig]:
    """Return the rig whose vision unit is the cameras in ``[vmu.cameras]``. Raises BadInput."""
    vmu = rig.value.vmu
    if vmu.driver == "mock":
        text = f'"cameras": rig "{rig.value.name}" is in memory, use one on wires, as emulated'
        raise BadInput.single(scenario.where("vmu.source"), "vmu.source", text)
    selected = Vmu.model_validate(vmu.model_dump(mode="json") | {"driver": "cameras"}, strict=False)
    interface = selected.settings.interface
    if rig.value.kind == "emulated" and interface != "genicam":
        key = "vmu.cameras.interface"
        raise BadInput.single(rig.where(key), f"rig.{key}", f'"{interface}": emulated cameras have "genicam"')
    missing = [side for side in ("left", "right") if getattr(selected.settings, side) is None]
    if missing and rig.value.kind == "hardware":
        keys = " and ".join(f"vmu.cameras.{side}" for side in missing)
        raise BadInput.single(rig.source, keys, 'is missing: needed for vmu.source = "cameras"')
    return replace(rig, value=rig.value.model_copy(update={"vmu": selected}))


def core_memory(job: Job, rig: Rig) -> CoreMemory:
    """Return the memory of the core for ``job`` on ``rig``, before its first cycle."""
    scenario = job.scenario.value
    gnc, bench = gnc_params.gnc(scenario), bench_params.bench(rig, scenario.step_s, scenario.bench)
    params = loop_params(scenario, rig, gnc, bench, bench_params.axis_guard(rig, scenario))
    set_truth(params, job.truth, rig, job.seed, dynamics_params.dss_as_built(job.truth, job.seed))
    memory = CoreMemory(params, scenario.imu_samples, frames_in_transit(rig, scenario.step_s))
    memory.now.row["truth"] = dynamics_params.initial_truth(job.truth)
    draw_initial_imu_errors(job.truth, job.seed, memory.now.imu)
    return memory


def assemble(
    job: Job,
    rig: Rig,
    rate: Rate,
    devices: Devices,
    parts: SessionParts,
    memory: CoreMemory | None = None,
    cycles: CyclesOf | None = None,
) -> Runner:
    """Return a Runner of ``job`` on these devices, timed by ``rate``.

    parts: all that the session has besides. memory: of the core; None: a new one. cycles: makes what runs the cycles
    instead of the cycle in Python.
    """
    memory = memory or core_memory(job, rig)
    scenario, sinks = job.scenario.value, parts.sinks
    safety = SafetyMonitor(safety_limits(rig, memory.params.guard), devices.axis_names, _links(rig, devices))
    lines = _safety_io(rig, devices.io, memory)
    moving, held = _target(job, rig, devices, sinks)
    inputs = SafetyInputs(lines.emergency_input, lines.local_enable) if lines else NO_INPUTS
    measured = _measured_truth(memory, rig)
    axes = devices.rails, devices.turntable, memory, safety
    floats = measured.bench(axes, inputs, lines) if measured is not None and lines is not None else None
    stage = floats or BenchStage(*axes, moving, inputs)
    sensors = _sensors(job, rig, devices, stage, memory, parts)
    gnc, on_frame_used = _backend(job, rig, rate, memory)
    gnc.request_hold = safety.request_hold
    if floats is not None:
        floats.order_abort = gnc.order_abort
    vision_sinks = on_frame_used, sinks.get("arrivals")
    conditions = gnc.filter_monitor.conditions if gnc.filter_monitor is not None else None
    loop = Loop(
        memory=memory,
        dss=_dss(job, rig, memory, parts, measured),
        bench=stage,
        vision=(VisionStage if measured is None else measured.vision)(devices.source, memory, *vision_sinks),
        gnc=gnc,
        history=np.zeros(min(job.cycles, ROWS_MAX), CYCLE),
        telemetry=reduce(lambda rows, layer: layer(rows), parts.layers, parts.telemetry or NoTelemetry()),
        safety_io=lines or SafetyIo(),
        target=AxesTogether([*([moving] if moving else []), *held.values()]),
        run_zero=RunZero(parts.on_run_zero),
        axis_faults=_axis_faults(job, devices, memory),
        bench_now_s=rate.now_s,
        health_alarms=HealthAlarms(
            safety.alarms, scenario, *((sensors.disagreement, sensors.suspect) if sensors else ())
        ),
        sensors=sensors,
        on_full=parts.on_full,
        axes_sink=sinks.get("axes_samples") if job.ticks > 1 else None,
    )
    if conditions is not None:
        loop.health_alarms.watch(conditions)
    overrun_monitor = OverrunMonitor(
        rig.on_overrun,
        rig.host.overruns_max,
        rig.host.overruns_window_s,
        job.ticks,
        lambda trip: safety.request_hold(str(trip)),
    )
    plan = RunPlan(
        scenario.step_s,
        job.cycles,
        parts.frames_to_arm,
        park_position(rig),
        rig.bench.park_after_run,
        BrakeTimes(rig.brake_close_s, rig.brake_open_s),
        job.ticks,
        job.until_stopped,
        rig.io.warning_s if rig.io is not None and rig.has_io and rig.io.coils.warning is not None else 0.0,
        rig.host.lock_step_timeout_s,
        _SETTLED * max((robot.lag_s or 0.0 for robot in rig.robots.values()), default=0.0),
    )
    if sensors is not None:
        parts.meters["sensors"] = sensors.numbers
    if measured is not None:
        parts.meters["truth"] = measured.numbers
    if moving is not None:
        parts.meters["manipulator"] = moving.numbers
    if rig.held_axes:
        parts.meters["held_axes"] = lambda: {name: held[name].numbers() for name in rig.held_axes}
    runner = Runner(loop, rate, overrun_monitor, plan, parts, cycles)
    for attach in parts.on_built:
        attach(runner)
    return runner


def _safety_io(rig: Rig, io: DiscreteIo | None, memory: CoreMemory) -> SafetyIoStage | None:
    """Return the stage of the digital lines, None without any."""
    if io is None or rig.io is None:
        return None
    memory.params.mock.thruster_lines = rig.io.thruster_lines
    tested_pump_s = rig.io.pump_timeout_s if rig.kind == "hardware" else None
    return SafetyIoStage(io, memory.now.command.on[: rig.io.thruster_lines], tested_pump_s)


def _axis_faults(job: Job, devices: Devices, memory: CoreMemory) -> Callable[[float], None] | None:
    """Return what applies the faults of axes in memory at a time of the run, None without any."""
    if not any(fault.family == "axis" for fault in job.truth.faults):
        return None
    assert isinstance(devices.rails, MockAxes)
    assert isinstance(devices.turntable, MockAxes)
    params, rails, turntable = memory.params.mock, devices.rails.servo, devices.turntable.servo
    params.nominal_axes.rate_max = np.concatenate([rails.rate_max, turntable.rate_max])
    faults, nominal = kernel_record(params.axis_faults), kernel_record(params.nominal_axes)
    return lambda t_s: set_axis_faults(faults, nominal, t_s, rails, turntable)


def _target(
    job: Job, rig: Rig, devices: Devices, sinks: Mapping[str, Telemetry]
) -> tuple[TargetInMotion | None, dict[str, HeldAxes]]:
    """Return the axes that move the target in the run, and those that are held at their places, by name."""
    groups, sink = {"target": devices.target, **devices.held}, sinks.get("held_samples")
    held: dict[str, HeldAxes] = {}
    for number, (name, table) in enumerate(rig.groups_at_places.items()):
        axes = groups[name]
        assert axes is not None
        if table is not rig.shared_rails:
            held[name] = HeldAxes(axes, table, number, sink)
    if devices.target is None or (config := rig.moving_target) is None:
        return None, held
    step_s, params = job.scenario.value.step_s, bench_params.manipulator(rig)
    assert params is not None
    start = dynamics_params.initial_truth(job.truth)
    bench, limits = bench_params.bench(rig, step_s), bench_params.manipulator_limits(rig, step_s)
    sink = sink if params.rails else sinks.get("manipulator_samples")
    moving = TargetInMotion(devices.target, config, params, bench, limits, start, sink)
    moving.protect(bench_params.target_guards(rig, job.scenario.value))
    return moving, held


def _sensors(
    job: Job, rig: Rig, devices: Devices, bench: BenchStage, memory: CoreMemory, parts: SessionParts
) -> SensorStage | None:
    """Return the sensors of a scenario other than vision unit and IMU, None without any."""
    if not memory.params.sensors.n:
        return None
    scenario = job.scenario.value
    kinds = {name: sensor.kind for name, sensor in sensors_of(scenario).items()}
    wired = [*wired_sensors(scenario, rig), *datagram_sensors(scenario)] if parts.clock is not None else []
    for number, name in enumerate(kinds):
        if name in wired:
            memory.params.sensors.source[number].models = 0
    sink, is_kept = parts.sinks.get("sensor_samples", NoTelemetry()), not job.until_stopped
    axes, alarms = _seen_axes(devices, bench), bench.safety.alarms
    return SensorStage(memory, kinds, axes, parts.sample_sources, alarms, sink, is_kept)


def _seen_axes(devices: Devices, bench: BenchStage) -> Callable[[], tuple[Array, Array]]:
    """Return what gives the positions of rails and turntable, m and rad, that a modelled sensor on the bench sees."""
    target, moving = devices.target, bench.manipulator

    def axes() -> tuple[Array, Array]:
        if isinstance(bench.rails, MockAxes) and isinstance(bench.turntable, MockAxes):
            positions = np.asarray(bench.rails.servo.position), np.asarray(bench.turntable.servo.position)
        else:
            positions = bench.feedback[0].position, bench.feedback[1].position
        if moving is not None:
            at = target.servo.position if isinstance(target, MockAxes) else moving.feedback.position
            return relative_axes(bench.params, moving.params, *positions, at)
        return positions

    return axes


def _backend(job: Job, rig: Rig, rate: Rate, memory: CoreMemory) -> tuple[GncBackend, FrameUsed | None]:
    """Return the GNC backend, of the job, the rig's flight computer or the scenario, and what each used frame calls."""
    scenario, computer = job.scenario.value, rig.flight_computer
    if job.make_backend is not None:
        return job.make_backend(scenario), None
    if computer.command_words == "none":
        return make_backend(scenario, job.own, memory), None
    make = provided("rig.flight_computer.command_words", rig.name)
    backend: tuple[GncBackend, FrameUsed | None] = make(computer, rate.now_s, backend_setup(scenario))
    return backend


def make_gnc(scenario: Scenario, own: OwnBackends = NO_BACKENDS, memory: CoreMemory | None = None) -> BuiltinGnc:
    """Return the built-in GNC of ``scenario`` with its backends, before its first cycle. Raises BadInput.

    own: backends that the caller gives. memory: of the core in which it works; None: its own.
    """
    params, state = (gnc_params.gnc(scenario), None) if memory is None else (memory.params.gnc, memory.state.gnc)
    monitor = FilterMonitor(params.navigation, _shadow_limits(scenario))
    backends = backends_of(scenario, own)
    return BuiltinGnc(
        params, approach_event_log(scenario), monitor, backends, gnc_setup(scenario) if backends else None, state
    )


def make_backend(scenario: Scenario, own: OwnBackends = NO_BACKENDS, memory: CoreMemory | None = None) -> GncBackend:
    """Return the built-in GNC, or that of ``own`` or ``scenario`` elsewhere. Raises BadInput if it cannot be loaded.

    Arguments: see ``make_gnc``.
    """
    library = open_library(scenario.gnc, own=own.gnc)
    if library is None:
        return make_gnc(scenario, own, memory)
    return WholeGnc(library, backend_setup(scenario), memory.state.gnc if memory is not None else None)


def library_problems(scenario: Loaded[Scenario], own: OwnBackends = NO_BACKENDS) -> list[Problem]:
    """Return why a binary or a backend of the GNC of ``scenario`` cannot be used."""
    gnc = scenario.value.gnc
    try:
        library = open_library(gnc, scenario.where(key_of(gnc)), own.gnc)
        if library is not None:
            library.check(gnc_setup(scenario.value))
            if not library.receives_measurements:
                return unfused_sensors(scenario, library.name)
        for backend in backends_of(scenario.value, own, scenario.where).values():
            backend.check(gnc_setup(scenario.value))
        return []
    except BadInput as error:
        return list(error.problems)


def park_position(rig: Rig) -> np.record:
    """Return AXES, at rest, of the park position: each axis' ``park_m`` or ``park_deg``."""
    axes: np.record = new(AXES)
    axes.rail_m = [getattr(rig.rails, name).park_m for name in RAIL_NAMES]
    axes.gimbal_rad = np.radians([getattr(rig.turntable, name).park_deg for name in GIMBAL_NAMES])
    return axes


def _links(rig: Rig, devices: Devices) -> list[LinkWatch]:
    """Return a leaky bucket for each device that counts lost packets."""
    rails, turntable, source, _, target, held = devices
    groups: dict[str, AxisGroup | None] = {"rails": rails, "turntable": turntable, "target": target, **held}
    watches: list[LinkWatch] = []
    for name, config in rig.axis_groups.items():
        device = groups[name]
        if isinstance(device, CountsLosses):
            bucket = LeakyBucket(config.lost_packets_max, config.lost_packets_window_s)
            watches.append(LinkWatch(device.name, bucket, device.lost_packets))
    forget_s = rig.vmu.lost_packets_window_s or _FRAMES_TO_FORGET / rig.vmu.rate_hz
    bucket = LeakyBucket(rig.vmu.lost_packets_max, forget_s)
    return [*watches, LinkWatch(source.name, bucket, lambda: _lost_frames(source.counters()))]


def _lost_frames(counters: dict[str, int]) -> int:
    """Return the number of lost frames; one with a bad checksum leaves a gap in the counter as well."""
    return max(counters.get("lost", 0), counters.get("crc_errors", 0))


def _shadow_limits(scenario: Scenario) -> tuple[float, float] | None:
    shadow = scenario.gnc.shadow
    return (shadow.position_limit_m, math.radians(shadow.attitude_limit_deg)) if shadow.enabled else None


def _dss(
    job: Job, rig: Rig, memory: CoreMemory, parts: SessionParts, measured: MeasuredTruth | None = None
) -> DssStage:
    """Return the dynamics simulation with this run's thruster errors, or the prediction of the ``measured`` truth.

    Raises BadInput for an FMU that is unsuitable.
    """
    scenario, noise = job.truth, NormalRows(noise_source(job.seed, "imu"), IMU_NOISE)
    if measured is not None:
        return measured.dss(memory, dynamics_params.field(scenario), noise)
    stage = provided("models", "scenario") if scenario.models else lambda _, *parts: DssStage(*parts)
    sink = parts.sinks.get("imu_samples") if job.scenario.value.imu_samples > 1 else None
    gyros = None if parts.imu is None else BenchGyros(parts.imu, rig, memory)
    made: DssStage = stage(scenario, memory, dynamics_params.field(scenario), noise, sink, gyros)
    return made


def _measured_truth(memory: CoreMemory, rig: Rig) -> MeasuredTruth | None:
    """Return the truth of a vehicle that floats."""
    if rig.floating is None:
        return None
    from hil.loop.floating import MeasuredTruth

    return MeasuredTruth(memory, rig.floating, rig.vmu.rate_hz)


def _simulated_vehicle(scenario: Scenario, rig: Rig, seed: int) -> SimulatedVehicle | None:
    """Return the simulation of a vehicle that floats."""
    if rig.floating is None:
        return None
    from hil.session.floating import SimulatedVehicle

    return SimulatedVehicle(scenario, rig, seed)


def draw_initial_imu_errors(scenario: Scenario, seed: int, imu: np.record) -> None:
    """Draw the true gyro drift and accelerometer bias about their means."""
    draws = noise_source(seed, "initial").standard_normal(6)
    drift = np.array(scenario.imu.gyro_drift_degps) + scenario.imu.gyro_drift_initial_sigma_degps * draws[:3]
    bias_sigma = scenario.imu.accelerometer_bias_initial_sigma_mps2
    imu.drift_C = np.radians(drift)
    imu.bias_C = np.array(scenario.imu.accelerometer_bias_mps2) + bias_sigma * draws[3:]


class Mocks(NamedTuple):
    """Mock devices; pose sensor of the vision unit and transport of its frames."""

    devices: Devices
    sensor: PoseSensor
    transport: Transport


def mocks(scenario: Scenario, rig: Rig, seed: int, memory: CoreMemory, images: ImageSink | None = None) -> Mocks:
    """Return mock devices in ``memory``, with the axes at the start pose. images: sink of a rendered unit's images."""
    from hil.drivers.io.mock import MockIo
    from hil.drivers.vmu.mock import MockVmu

    rails_config, turntable_config = axes_at_start(scenario, rig)
    mock = memory.state.mock
    axes: Callable[..., MockAxes] = MockAxes
    if rig.robots:
        from hil.drivers.arm.mock import MockRobots  # of few rigs

        axes = MockRobots(rig).axes
    rails = axes("rails", rails_config, mock.rails)
    turntable = axes("turntable", turntable_config, mock.turntable)
    sensor = make_pose_sensor(scenario, rig, seed, images, mock.vision_memory)

    target = axes("target", rig.target_axes) if rig.target_axes else None
    bench = bench_params.bench_as_built(rig, scenario.step_s, scenario.bench)
    parameters = bench_params.manipulator(rig)

    vehicle = _simulated_vehicle(scenario, rig, seed)

    def pose_at(t_s: float) -> PoseFrame | None:
        if vehicle is not None:
            shown = vehicle.axes_at(t_s)
            return sensor.measure(shown.rail_m, shown.gimbal_rad, t_s)
        seen = rails.position_at(t_s), turntable.position_at(t_s)
        if parameters is not None and target is not None:
            seen = relative_axes(bench, parameters, *seen, target.position_at(t_s))
        return sensor.measure(*seen, t_s)

    io = MockIo(rig.io) if rig.io is not None and rig.has_io else None
    if io is not None and vehicle is not None:
        io.fire = vehicle.fire
    frames = transport(scenario.vmu, seed)
    source = MockVmu(rig.vmu, pose_at, frames, mock.transit, memory.frames)
    held = {name: MockAxes(name, table) for name, table in rig.held_axes.items()}
    return Mocks(Devices(rails, turntable, source, io, target, held), sensor, frames)


def axes_at_start(scenario: Scenario, rig: Rig) -> tuple[Rails, Turntable]:
    """Return the settings of rails and turntable with the scenario's start pose as the initial position."""
    start = start_axes(scenario, rig)
    rails_config = rig.rails.model_copy(
        update={
            name: getattr(rig.rails, name).model_copy(update={"park_m": float(start.rail_m[i])})
            for i, name in enumerate(RAIL_NAMES)
            if name in rig.rails.driven
        }
    )
    turntable_config = rig.turntable.model_copy(
        update={
            name: getattr(rig.turntable, name).model_copy(update={"park_deg": math.degrees(start.gimbal_rad[i])})
            for i, name in enumerate(GIMBAL_NAMES)
            if name in rig.turntable.driven
        }
    )
    return rails_config, turntable_config


def start_axes(scenario: Scenario, rig: Rig) -> np.record:
    """Return AXES, at rest, of the scenario's start pose, which a planar chaser has in its plane."""
    axes, rest, truth = new(AXES), np.zeros(3), dynamics_params.initial_truth(scenario)
    r, q = truth.r_CT_H, truth.q_CH
    bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
    if (params := bench_params.manipulator(rig)) is not None:
        at = manipulator.start_axes(params, bench, bench_params.manipulator_limits(rig, scenario.step_s), r, q)
        shown = manipulator.shown_motion(params, at, rest, ChaserMotion(r, rest, q, rest))
        r, q = shown.r, shown.q
    axes_of_pose(bench, r, rest, q, rest, axes)
    return axes
