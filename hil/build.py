"""From scenario and rig to a bench that can run: the only place that knows which rig it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from hil import parameters
from hil.approach_diary import ApproachDiary
from hil.clock import SimulatedClock, WallClock
from hil.config.load import Loaded
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, Rig
from hil.config.scenario import Scenario
from hil.cycle import Loop
from hil.drivers.base import AxisGroup, DiscreteIo, PoseSource
from hil.dynamics.imu import IMU_NOISE
from hil.emulation import EmulatedDevices
from hil.errors import BadInput, Problem
from hil.eye import Eye, transport
from hil.fitness import (
    approach_problems,
    axes_at,
    layout_problems,
    line_problems,
    port_problems,
    pose_problems,
)
from hil.gnc.watch import FilterWatch
from hil.io_stage import IoStage
from hil.maths.streams import NormalRows, stream
from hil.messages import AXES, CYCLE, PoseFrame, new
from hil.priority import precedence
from hil.rate import Rate, SimulatedRate, WallRate
from hil.runner import Runner, Watch
from hil.stages import Bench, Dss, Gnc, Move, Vision
from hil.target_stage import PlacedTarget
from hil.truth_check import truth_problems

_FRAMES_TO_ARM = 2
_WARM_UP_CYCLES = 10


_Devices = tuple[AxisGroup, AxisGroup, PoseSource, DiscreteIo | None, AxisGroup | None]
"""Rails, turntable, vision unit, digital lines, what moves the target."""


@dataclass(frozen=True)
class Job:
    """What is to be run, checked."""

    scenario: Loaded[Scenario]
    rig: Loaded[Rig]
    seed: int
    duration_s: float
    speed: float

    @property
    def cycles(self) -> int:
        """Cycles of the run, the one at t = 0 and the one at t = duration included."""
        return round(self.duration_s / self.scenario.value.step_s) + 1


def check(job: Job) -> None:
    """Raise BadInput with every fault that shows only when scenario and rig meet."""
    problems = [
        *truth_problems(job.scenario),
        *layout_problems(job.scenario),
        *pose_problems(job.scenario, job.rig),
        *approach_problems(job.scenario),
        *port_problems(job.rig),
        *line_problems(job.scenario, job.rig),
    ]
    if job.rig.value.kind == "mock" and job.speed != 1.0:
        problems.append(Problem("--speed", f"{job.speed:g}", "a mock rig has no wall clock: leave --speed away"))
    if problems:
        raise BadInput(problems)


@contextmanager
def runner(job: Job, watch: Watch, announce: Callable[[str], None]) -> Iterator[Runner]:
    """Give a Runner for ``job``; emulators that it needs are started before and ended after.

    announce: told in a line what is being started. Raises DeviceError when an emulator does not come up.
    """
    scenario, rig = job.scenario.value, job.rig.value
    if rig.kind == "mock":
        clock = SimulatedClock()
        devices = _mocks(scenario, rig, job.seed)
        yield _assemble(job, rig, SimulatedRate(clock, scenario.step_s), *devices, 0, watch)
        return
    with precedence() as refused:
        if refused:
            announce(refused)
        wall = WallClock(speed=job.speed)
        with _wired_rig(job, wall, announce) as wired:
            rate = WallRate(wall, scenario.step_s)
            yield _assemble(job, wired, rate, *_drivers(wired, wall), _FRAMES_TO_ARM, watch)


@contextmanager
def _wired_rig(job: Job, clock: WallClock, announce: Callable[[str], None]) -> Iterator[Rig]:
    """Give the rig with all its wires; an emulated one gets its emulators for as long as this lasts."""
    rig = job.rig.value
    if rig.kind == "hardware":
        yield rig
        return
    with EmulatedDevices(job.scenario.value, rig, clock, job.seed) as emulated:
        wired, addresses = emulated.wait_ready()
        for process in emulated.processes:
            wires = ", ".join(f"{n} on {a}" for n, a in addresses.items() if n.split(".")[0] == process.name)
            announce(f"emulator process {process.pid}: {wires}")
        yield wired


def warm_up(job: Job) -> None:
    """Call every kernel of the loop once, in memory: nothing compiles once the bench is powered."""
    scenario, rig = job.scenario.value, job.rig.value
    Move(parameters.bench(rig, scenario.step_s), new(AXES), _start_axes(scenario, rig)).at(0.1, new(AXES))
    _in_memory(job).run()


def warm_up_all_but_navigation(job: Job) -> None:
    """Call the kernels of every stage but navigation once."""
    loop = _in_memory(job).loop
    now = loop.now
    loop.bench.open(0.0)
    loop.vision.source.open(0.0)
    loop.bench.read(0.0, now.feedback)
    loop.bench.seed(now.feedback)
    loop.bench.check(now.feedback)
    loop.vision.take(0.0, 0.0, now.row[0])
    loop.gnc.guide(0.0, now.supervision, now.reference)
    loop.gnc.supervise(0.0, now.navigation, now.reference, now.supervision)
    loop.gnc.control(now.navigation, now.reference, now.command)
    loop.dss.step(now.truth, now.command)
    loop.dss.sample_imu(now.truth, now.imu)
    loop.bench.follow(now.truth, loop.dss.rate_against_hill(now.truth), 0.0, now.setpoint)


def _in_memory(job: Job) -> Runner:
    """Return a short run of ``job`` on mocks, whatever its rig."""
    scenario, rig = job.scenario.value, job.rig.value
    few = Job(job.scenario, job.rig, job.seed, _WARM_UP_CYCLES * scenario.step_s, 1.0)
    rate = SimulatedRate(SimulatedClock(), scenario.step_s)
    return _assemble(few, rig, rate, *_mocks(scenario, rig, 0), 0, lambda *_: None)


def _assemble(
    job: Job,
    rig: Rig,
    rate: Rate,
    rails: AxisGroup,
    turntable: AxisGroup,
    source: PoseSource,
    io: DiscreteIo | None,
    target: AxisGroup | None,
    frames_to_arm: int,
    watch: Watch,
) -> Runner:
    scenario = job.scenario.value
    sets, strength = parameters.allocation(scenario.chaser)
    navigation = parameters.navigation(scenario)
    loop = Loop(
        dss=_dss(scenario, job.seed),
        bench=Bench(
            rails,
            turntable,
            parameters.bench(rig, scenario.step_s),
            (rig.rails.following_error_max_m, math.radians(rig.turntable.following_error_max_deg)),
        ),
        vision=Vision(source, parameters.stations(rig)),
        gnc=Gnc(
            navigation,
            parameters.guidance(scenario),
            parameters.supervision(scenario),
            parameters.control(scenario, strength),
            sets,
            len(scenario.chaser.thrusters.position_m),
            ApproachDiary(scenario.gnc.guidance.sequence, scenario.requirements.dwell_s),
            FilterWatch(navigation, _shadow_limits(scenario)),
        ),
        history=np.zeros(job.cycles, CYCLE),
    )
    if io is not None and rig.io is not None:
        loop.lines = IoStage(io, loop.now.command.on[: rig.io.thruster_lines])
    if target is not None and rig.moved_target is not None:
        loop.target = PlacedTarget(target, rig.moved_target)
    loop.now.row["truth"] = parameters.initial_truth(scenario)
    _draw_initial_imu_errors(scenario, job.seed, loop.now.imu)
    return Runner(loop, rate, scenario.step_s, job.cycles, frames_to_arm, watch)


def _shadow_limits(scenario: Scenario) -> tuple[float, float] | None:
    shadow = scenario.gnc.shadow
    return (shadow.position_limit_m, math.radians(shadow.attitude_limit_deg)) if shadow.enabled else None


def _dss(scenario: Scenario, seed: int) -> Dss:
    """Return the simulation with thrusters as chance has built them."""
    draws = stream(seed, "thrusters").standard_normal(parameters.thruster_draws_shape(scenario))
    return Dss(
        parameters.dss(scenario, draws),
        parameters.field(scenario),
        parameters.imu(scenario),
        NormalRows(stream(seed, "imu"), IMU_NOISE),
    )


def _draw_initial_imu_errors(scenario: Scenario, seed: int, imu: np.record) -> None:
    """Draw the true drift and bias about their means."""
    draws = stream(seed, "initial").standard_normal(6)
    drift = np.array(scenario.imu.gyro_drift_degps) + scenario.imu.gyro_drift_initial_sigma_degps * draws[:3]
    bias_sigma = scenario.imu.accelerometer_bias_initial_sigma_mps2
    imu.drift_C = np.radians(drift)
    imu.bias_C = np.array(scenario.imu.accelerometer_bias_mps2) + bias_sigma * draws[3:]


def _mocks(scenario: Scenario, rig: Rig, seed: int) -> _Devices:
    """Return mocks of the devices; the axes stand at the start pose from the beginning."""
    from hil.drivers.io.mock import MockIo
    from hil.drivers.mock_axes import MockAxes
    from hil.drivers.vmu.mock import MockVmu

    start = _start_axes(scenario, rig)
    rails_config = rig.rails.model_copy(
        update={
            name: getattr(rig.rails, name).model_copy(update={"park_m": float(start.rail_m[i])})
            for i, name in enumerate(RAIL_NAMES)
        }
    )
    turntable_config = rig.turntable.model_copy(
        update={
            name: getattr(rig.turntable, name).model_copy(update={"park_deg": math.degrees(start.gimbal_rad[i])})
            for i, name in enumerate(GIMBAL_NAMES)
        }
    )
    rails = MockAxes("rails", RAIL_NAMES, rails_config)
    turntable = MockAxes("turntable", GIMBAL_NAMES, turntable_config)
    eye = Eye(parameters.bench(rig, scenario.step_s), parameters.stations(rig), parameters.vision(scenario), seed)

    def pose_at(t_s: float) -> PoseFrame:
        return eye.look(rails.read(t_s).position, turntable.read(t_s).position, t_s)

    io = MockIo(rig.io) if rig.io is not None and rig.has_io else None
    target = MockAxes("target", RAIL_NAMES, rig.moved_target) if rig.moved_target else None
    return rails, turntable, MockVmu(rig.vmu, pose_at, transport(scenario.vmu, seed)), io, target


def _drivers(rig: Rig, clock: WallClock) -> _Devices:
    """Return the drivers of a rig with wires."""
    from hil.drivers.io.driver import ModbusIo
    from hil.drivers.rails.driver import ModbusRails
    from hil.drivers.vmu.driver import Rs422Vmu

    turntable: AxisGroup
    if rig.turntable.driver == "ascii":
        from hil.drivers.turntable.ascii_driver import AsciiTurntable

        turntable = AsciiTurntable(rig.turntable, clock)
    else:
        from hil.drivers.turntable.cia402_driver import Cia402Turntable

        turntable = Cia402Turntable(rig.turntable, clock)
    io = ModbusIo(rig.io, clock) if rig.io is not None and rig.has_io else None
    target = ModbusRails(rig.moved_target, clock, "target") if rig.moved_target else None
    return ModbusRails(rig.rails, clock), turntable, Rs422Vmu(rig.vmu, clock), io, target


def _start_axes(scenario: Scenario, rig: Rig) -> np.record:
    return axes_at(scenario, rig, scenario.initial.position_m, scenario.initial.attitude_deg)
