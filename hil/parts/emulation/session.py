"""A bench on wires whose devices are emulated, by the wall clock or in lock-step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Final

from hil.core.clock import BenchClock
from hil.core.realtime import DefaultScheduling, SchedulingPolicy, short_turns, speed_held
from hil.drivers.serial_port import is_counted
from hil.loop.rate_keeper import Rate
from hil.loop.session_parts import SessionParts
from hil.parts.emulation.emulated_devices import EmulatedDevices
from hil.parts.emulation.lock_step import LockStepConductor
from hil.parts.emulation.true_axes import TrueAxesWatch
from hil.parts.wires.wired import WiredBench, Wires, in_real_time, wired_bench
from hil.recording.sinks import RecordingSinks
from hil.session.assembly import Job
from hil.session.sample_sources import datagram_sensors, wired_sensors

_GRID_S: Final = 0.02  # lock-step: longest time between two steps of emulators and servers


@contextmanager
def emulated_bench(
    job: Job, announce: Callable[[str], None] = lambda _: None, sinks: RecordingSinks | None = None
) -> Iterator[WiredBench]:
    """Give the bench of ``job``'s rig, whose devices are emulated; arguments: see ``wired_bench``."""
    timed = _in_lock_step(job) if job.rig.value.host.time == "lock_step" else in_real_time(job, announce)
    if job.rig.value.host.time != "lock_step" and job.speed > speed_held():
        announce(f"--speed {job.speed:g}: this computer keeps the time of an emulated rig up to {speed_held():g}")
    with wired_bench(job, announce, sinks, timed, _emulators) as bench:
        yield bench


@contextmanager
def _in_lock_step(job: Job) -> Iterator[tuple[BenchClock, SchedulingPolicy]]:
    """Give the clock of a bench in lock-step; its loop needs no privileges."""
    conductor = LockStepConductor(min(_GRID_S, job.tick_s), job.rig.value.host.lock_step_timeout_s)
    with closing(conductor), short_turns():
        yield conductor, DefaultScheduling()


@contextmanager
def _emulators(
    job: Job, clock: BenchClock, announce: Callable[[str], None], sinks: RecordingSinks | None
) -> Iterator[Wires]:
    """Give the rig with all its wires; the emulators run as long as this lasts."""
    rig, images = job.rig.value, sinks.image_memory() if sinks else None
    sensors = wired_sensors(job.truth, rig)
    if is_counted(clock):  # by the wall clock a program of the user's sends them
        sensors += datagram_sensors(job.truth)
    with EmulatedDevices(job.truth, rig, clock, job.seed, images, sensors) as emulated:
        wired, addresses = emulated.wait_ready()
        for device, pid in emulated.pids.items():
            wires = ", ".join(f"{n} on {a}" for n, a in addresses.items() if emulated.process_of(n) == device)
            announce(f"emulator process {pid}: {wires}")

        def watch(parts: SessionParts, rate: Rate) -> None:
            scenario = job.scenario.value
            axes = TrueAxesWatch(emulated.board, wired, rate.now_s, scenario.step_s, scenario.bench)
            parts.layers.insert(1, axes.over)
            parts.meters["bench"] = axes.numbers

        yield Wires(wired, emulated.server, emulated.processes, addresses, emulated.board, watch)
