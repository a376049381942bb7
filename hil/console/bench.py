"""Bench of a console session with its outputs: cycles, images, results of the docking monitor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Final

from hil.console.remote_operator import RemoteOperator
from hil.core.camera_images import ThreadedImageSink
from hil.core.clock import WallClock
from hil.core.realtime import RealTime
from hil.errors import BadInput
from hil.frmn.image_memory import RunTime
from hil.frmn.ring import NoTelemetry, Ring, Telemetry
from hil.loop.rate_keeper import WallClockRate
from hil.loop.runner import Runner
from hil.recording.recorder import RING_DTYPES
from hil.recording.session import required_sinks, ring_slots
from hil.recording.sinks import EventRecorder, RecordingSinks
from hil.session import build, with_docking_monitor

RINGS: Final = {name: dtype for name, dtype in RING_DTYPES.items() if name != "cycles"}
"""Rings that the console reads in addition to the cycles, by their names in ``RecordingSinks``."""


@dataclass
class ConsoleBench:
    """Runner and its outputs.

    event_recorder: recorder of operator actions. watched: returns the results of the docking monitor after the run.
    """

    runner: Runner
    telemetry: Ring
    clock: WallClock
    run_time: RunTime
    event_recorder: EventRecorder | None
    watched: with_docking_monitor.MonitorResults
    addresses: dict[str, str] = field(default_factory=dict)
    rings: dict[str, Ring] = field(default_factory=dict)
    wired: build.WiredBench | None = None


@contextmanager
def opened(
    job: build.Job, operator: RemoteOperator, announce: Callable[[str], None], recorder: RecordingSinks | None = None
) -> Iterator[ConsoleBench]:
    """Yield the bench of ``job``; its processes are ended afterwards. recorder: sinks of a recording."""
    if job.rig.value.host.time == "lock_step":
        text = '"lock_step": an operator at the console has the wall clock'
        raise BadInput.single(job.rig.where("host.time"), "rig.host.time", text)
    with ExitStack() as stack:
        sinks = recorder or stack.enter_context(_unrecorded_sinks(job))
        rings = {name: ring for name in RINGS if isinstance(ring := getattr(sinks, name), Ring)}
        assert isinstance(sinks.cycles, Ring)
        assert sinks.run_time is not None
        if job.rig.value.kind != "mock":
            bench = stack.enter_context(build.wired_bench(job, announce, sinks))
            assert isinstance(bench.clock, WallClock)
            watched = stack.enter_context(with_docking_monitor.beside(job, sinks.cycles, bench.clock, announce, sinks))
            runner = bench.runner(operator.on_progress, operator)
            watched.attach(runner)
            yield ConsoleBench(
                runner,
                sinks.cycles,
                bench.clock,
                sinks.run_time,
                bench.event_recorder,
                watched,
                bench.addresses,
                rings,
                bench,
            )
            return
        clock = WallClock(speed=job.speed)
        watched = stack.enter_context(with_docking_monitor.beside(job, sinks.cycles, clock, announce, sinks))
        host = job.rig.value.host
        realtime = stack.enter_context(RealTime(host.fifo, host.cpu))
        rate = WallClockRate(clock, job.scenario.value.step_s)
        maker = sinks.image_encoder(job.rig.value) if job.scenario.value.vmu.source == "rendered" else None
        pictures = ThreadedImageSink(maker) if maker else None
        if pictures:
            stack.callback(pictures.close)
        runner = build.in_memory(job, rate, operator.on_progress, realtime, sinks.cycles, operator, pictures)
        watched.attach(runner)
        yield ConsoleBench(runner, sinks.cycles, clock, sinks.run_time, sinks.attach(runner), watched, {}, rings)


@contextmanager
def _unrecorded_sinks(job: build.Job) -> Iterator[RecordingSinks]:
    """Yield sinks of a session without a recording: only the console reads them."""
    fed = required_sinks(job)
    slots = ring_slots(job) | {"cycles": build.TELEMETRY_ROWS}
    rings = {name: Ring.create(dtype, slots[name], name) for name, dtype in RING_DTYPES.items() if name in fed}
    run_time = RunTime.create()
    takers: dict[str, Telemetry] = {name: rings.get(name, NoTelemetry()) for name in RING_DTYPES}
    try:
        yield RecordingSinks(**takers, run_time=run_time)
    finally:
        run_time.close()
        for ring in rings.values():
            ring.close()
