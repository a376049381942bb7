"""From scenario and rig to a bench that can run: the only place that knows which rig it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from hil import parameters
from hil.approach_diary import ApproachDiary
from hil.bench.kinematics import MOTION
from hil.bench.stopping import brake_step
from hil.bench_stage import Bench, Move
from hil.clock import SimulatedClock, WallClock
from hil.config.load import Loaded
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, Rig
from hil.config.scenario import Scenario
from hil.cycle import Loop
from hil.drivers.base import AxisGroup, CountsLosses, DiscreteIo, PoseSource
from hil.dynamics.imu import IMU_NOISE
from hil.emulation import EmulatedDevices
from hil.errors import BadInput, Problem
from hil.eye import Eye, transport
from hil.fitness import (
    approach_problems,
    axes_at,
    flight_problems,
    host_problems,
    line_problems,
    port_problems,
    sign_off_problems,
    turntable_problems,
    turntable_warnings,
)
from hil.frmn.ring import NoTelemetry, Ring, Telemetry
from hil.gnc.watch import FilterWatch
from hil.handling import Watch
from hil.host_processes import TITLES, HostProcesses
from hil.io_stage import IoStage
from hil.late_cycles import LateCycles
from hil.maths.streams import NormalRows, stream
from hil.messages import AXES, CYCLE, PoseFrame, new
from hil.modes import Mode
from hil.orders import Operator
from hil.rate import Rate, SimulatedRate, WallRate
from hil.realtime import REAL_TIME, NoPrecedence, Precedence, RealTime
from hil.runner import Runner
from hil.safety.bucket import LeakyBucket, LinkWatch
from hil.safety.limits import limits_of
from hil.safety.supervisor import Supervisor
from hil.stages import Dss, Gnc, Vision
from hil.target_stage import PlacedTarget
from hil.truth_check import truth_problems

_FRAMES_TO_ARM = 2
_FRAMES_TO_FORGET = 2.0  # in their time one lost frame is forgiven, where the rig file says nothing else
_WARM_UP_CYCLES = 10
_TELEMETRY_ROWS = 2048  # 41 s at 50 Hz: how long a reader may look away before it misses something


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
        *(truth_problems(job.scenario) or flight_problems(job.scenario, job.rig)),
        *approach_problems(job.scenario),
        *_rig_problems(job),
    ]
    if problems := problems or sign_off_problems(job.rig):
        raise BadInput(problems)


def check_rig(job: Job) -> None:
    """Raise BadInput with every fault that keeps the rig's axes from being moved, whatever for."""
    problems = _rig_problems(job)
    if job.rig.value.kind == "mock":  # stands at the start pose from the beginning
        problems += flight_problems(job.scenario, job.rig)
    if problems:
        raise BadInput(problems)


def _rig_problems(job: Job) -> list[Problem]:
    problems = [
        *port_problems(job.rig),
        *host_problems(job.rig),
        *line_problems(job.scenario, job.rig),
        *turntable_problems(job.rig),
    ]
    if job.rig.value.kind == "mock" and job.speed != 1.0:
        problems.append(Problem("--speed", f"{job.speed:g}", "a mock rig has no wall clock: leave --speed away"))
    return problems


@contextmanager
def runner(
    job: Job, watch: Watch, announce: Callable[[str], None], operator: Operator | None = None
) -> Iterator[Runner]:
    """Give a Runner for ``job``; emulators that it needs are started before and ended after.

    announce: told in a line what is being started. operator: gives the orders; None: the run goes
    through by itself. Raises DeviceError when an emulator does not come up.
    """
    scenario, rig = job.scenario.value, job.rig.value
    if rig.kind == "mock":
        yield in_memory(job, SimulatedRate(SimulatedClock(), scenario.step_s), watch, operator=operator)
        return
    with wired_bench(job, announce) as bench:
        yield bench.runner(watch, operator)


class WiredBench:
    """A bench on wires with all its processes up; each ``runner`` is a session at it, one after the other.

    pids: of every process, by the name of its device, or HOST and GUARD. addresses: where the emulators
    listen, with the ports where their faults are switched. board: where the emulated axes are.
    """

    def __init__(
        self,
        job: Job,
        rig: Rig,
        clock: WallClock,
        realtime: RealTime,
        hosts: HostProcesses,
        telemetry: Ring,
        emulated: EmulatedDevices | None,
        addresses: dict[str, str],
    ) -> None:
        self.addresses = addresses
        self.board = emulated.board if emulated else None
        self.pids = {**(emulated.pids if emulated else {}), **hosts.pids}
        self._job = job
        self._rig = rig
        self._clock = clock
        self._realtime = realtime
        self._devices = hosts.devices()
        self._telemetry = telemetry

    def runner(self, watch: Watch = lambda *_: None, operator: Operator | None = None) -> Runner:
        """Return a Runner of the job."""
        rate = WallRate(self._clock, self._job.scenario.value.step_s)
        return _assemble(
            self._job, self._rig, rate, *self._devices, _FRAMES_TO_ARM, watch, operator, self._realtime, self._telemetry
        )


@contextmanager
def wired_bench(job: Job, announce: Callable[[str], None] = lambda _: None) -> Iterator[WiredBench]:
    """Give the bench of ``job``'s rig, which is not a mock; its processes are ended after.

    announce: told in a line what is being started. Raises DeviceError when a process does not come up.
    """
    rig = job.rig.value
    with RealTime(rig.host.fifo, rig.host.cpu) as realtime:
        _insist_on_realtime(job.rig, realtime)
        for grant in realtime.refused():
            announce(str(grant))
        for line in turntable_warnings(rig):
            announce(line)
        wall = WallClock(speed=job.speed)
        with (
            _emulated(job, wall, announce) as (wired, emulated, addresses),
            HostProcesses(wired, wall) as hosts,
            _telemetry() as ring,
        ):
            hosts.wait_ready()
            for name, pid in hosts.pids.items():
                announce(f"{TITLES[name]} {pid}")
            yield WiredBench(job, wired, wall, realtime, hosts, ring, emulated, addresses)


def _insist_on_realtime(rig: Loaded[Rig], realtime: RealTime) -> None:
    """Raise BadInput where hardware would be run by a loop that is not in real time."""
    host = rig.value.host
    if rig.value.kind != "hardware" or not host.insist_on_realtime:
        return
    key = "host.insist_on_realtime"
    problems = [
        Problem(rig.where(key), f"rig.{key}", f"true, but {grant}")
        for grant in realtime.refused()
        if grant.name in REAL_TIME
    ]
    if problems:
        raise BadInput(problems)


@contextmanager
def _telemetry() -> Iterator[Ring]:
    """Give the ring that each cycle's row is put into, for other processes to read."""
    ring = Ring.create(CYCLE, _TELEMETRY_ROWS)
    try:
        yield ring
    finally:
        ring.close()


def in_memory(
    job: Job,
    rate: Rate,
    watch: Watch = lambda *_: None,
    precedence: Precedence | None = None,
    telemetry: Telemetry | None = None,
    operator: Operator | None = None,
) -> Runner:
    """Return a Runner of ``job`` on mocks, whatever its rig, kept in time by ``rate``."""
    devices = _mocks(job.scenario.value, job.rig.value, job.seed)
    return _assemble(job, job.rig.value, rate, *devices, 0, watch, operator, precedence, telemetry)


@contextmanager
def _emulated(
    job: Job, clock: WallClock, announce: Callable[[str], None]
) -> Iterator[tuple[Rig, EmulatedDevices | None, dict[str, str]]]:
    """Give the rig with all its wires; an emulated one gets its emulators for as long as this lasts."""
    rig = job.rig.value
    if rig.kind == "hardware":
        yield rig, None, {}
        return
    with EmulatedDevices(job.scenario.value, rig, clock, job.seed) as emulated:
        wired, addresses = emulated.wait_ready()
        for process in emulated.processes:
            wires = ", ".join(f"{n} on {a}" for n, a in addresses.items() if n.split(".")[0] == process.name)
            announce(f"emulator process {process.pid}: {wires}")
        yield wired, emulated, addresses


def warm_up(job: Job) -> None:
    """Call every kernel of the loop once, in memory: nothing compiles once the bench is powered."""
    scenario, rig = job.scenario.value, job.rig.value
    Move(parameters.bench(rig, scenario.step_s), new(AXES), _start_axes(scenario, rig)).at(0.1, new(AXES))
    brake_step(parameters.bench(rig, scenario.step_s), new(MOTION), new(AXES))
    _a_few_cycles(job).run()


def warm_up_all_but_navigation(job: Job) -> None:
    """Call the kernels of every stage but navigation once."""
    loop = _a_few_cycles(job).loop
    loop.lines.open(SimulatedRate(SimulatedClock(), job.scenario.value.step_s))
    now = loop.now
    loop.bench.open(0.0)
    loop.vision.source.open(0.0)
    loop.bench.read(0.0, now.feedback)
    loop.bench.supervisor.modes.mode = Mode.RUNNING
    loop.bench.seed_for_run(0.0, now.feedback)
    loop.bench.check(0.0, now.feedback)
    loop.bench.brake(0.0, now.setpoint)
    loop.vision.take(0.0, 0.0, now.row[0])
    loop.gnc.guide(0.0, now.supervision, now.reference)
    loop.gnc.supervise(0.0, now.navigation, now.reference, now.supervision)
    loop.gnc.control(now.navigation, now.reference, now.command)
    loop.dss.step(now.truth, now.command)
    loop.dss.sample_imu(now.truth, now.imu)
    loop.bench.follow(now.truth, loop.dss.rate_against_hill(now.truth), 0.0, now.setpoint)


def _a_few_cycles(job: Job) -> Runner:
    """Return a short run of ``job`` on mocks, whatever its rig."""
    scenario = job.scenario.value
    few = Job(job.scenario, job.rig, 0, _WARM_UP_CYCLES * scenario.step_s, 1.0)
    return in_memory(few, SimulatedRate(SimulatedClock(), scenario.step_s))


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
    operator: Operator | None = None,
    precedence: Precedence | None = None,
    telemetry: Telemetry | None = None,
) -> Runner:
    scenario = job.scenario.value
    bench = parameters.bench(rig, scenario.step_s)
    axis_names = (*rails.axis_names, *turntable.axis_names)
    supervisor = Supervisor(limits_of(rig, bench), axis_names, _links(rig, rails, turntable, source))
    sets, strength = parameters.allocation(scenario.chaser)
    navigation = parameters.navigation(scenario)
    loop = Loop(
        dss=_dss(scenario, job.seed),
        bench=Bench(rails, turntable, bench, supervisor),
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
        telemetry=telemetry or NoTelemetry(),
        bench_now_s=rate.now_s,
    )
    if io is not None and rig.io is not None:
        lines = IoStage(io, loop.now.command.on[: rig.io.thruster_lines])
        loop.lines = lines
        loop.bench.emergency_input = lines.emergency_input
    if target is not None and rig.moved_target is not None:
        loop.target = PlacedTarget(target, rig.moved_target)
    loop.now.row["truth"] = parameters.initial_truth(scenario)
    _draw_initial_imu_errors(scenario, job.seed, loop.now.imu)
    late_cycles = LateCycles(rig.late_cycle, rig.host.late_cycles_max, rig.host.late_cycles_window_s)
    late_cycles.on_hold = lambda trip: supervisor.ask_for_hold(str(trip))
    return Runner(
        loop,
        rate,
        precedence or NoPrecedence(),
        late_cycles,
        scenario.step_s,
        job.cycles,
        frames_to_arm,
        watch,
        operator,
    )


def _links(rig: Rig, rails: AxisGroup, turntable: AxisGroup, source: PoseSource) -> list[LinkWatch]:
    """Return a leaky bucket for each device that counts what its wire loses."""
    watches = []
    for device, config in ((rails, rig.rails), (turntable, rig.turntable)):
        if isinstance(device, CountsLosses):
            bucket = LeakyBucket(config.lost_packets_max, config.lost_packets_forget_s)
            watches.append(LinkWatch(device.name, bucket, device.lost_packets))
    forget_s = rig.vmu.lost_packets_forget_s or _FRAMES_TO_FORGET / rig.vmu.rate_hz
    bucket = LeakyBucket(rig.vmu.lost_packets_max, forget_s)
    return [*watches, LinkWatch(source.name, bucket, lambda: _lost_frames(source.counters()))]


def _lost_frames(counters: dict[str, int]) -> int:
    """Return the frames that did not come whole: one with a bad checksum leaves a gap in the numbers as well."""
    return max(counters.get("lost", 0), counters.get("crc_errors", 0))


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


def _start_axes(scenario: Scenario, rig: Rig) -> np.record:
    return axes_at(scenario, rig, scenario.initial.position_m, scenario.initial.attitude_deg)
