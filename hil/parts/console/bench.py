"""Bench of a console session with its outputs: cycles, images, results of the docking monitor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

from hil.core.camera_images import ThreadedImageSink
from hil.core.clock import WallClock
from hil.core.realtime import RealTime
from hil.errors import BadInput
from hil.frmn.image_memory import RunTime
from hil.frmn.ring import NoTelemetry, Ring, Telemetry
from hil.loop.outcome import Outcome
from hil.loop.rate_keeper import WallClockRate
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.parts.console.remote_operator import RemoteOperator
from hil.parts.wires.wired import TELEMETRY_ROWS, WiredBench
from hil.recording.recorder import ring_dtypes
from hil.recording.session import required_sinks, ring_slots
from hil.recording.sinks import EventRecorder, RecordingSinks
from hil.report.long_run import accumulate
from hil.report.tally import Tallied
from hil.session import build


@dataclass
class ConsoleBench:
    """Runner and its outputs. event_recorder: recorder of operator actions. numbers: see ``accumulate``."""

    runner: Runner
    telemetry: Ring
    clock: WallClock
    run_time: RunTime
    event_recorder: EventRecorder | None
    numbers: Callable[[Outcome], Tallied | None]
    addresses: dict[str, str] = field(default_factory=dict)
    rings: dict[str, Ring] = field(default_factory=dict)
    wired: WiredBench | None = None


@contextmanager
def opened(
    job: build.Job, operator: RemoteOperator, announce: Callable[[str], None], recorder: RecordingSinks | None = None
) -> Iterator[ConsoleBench]:
    """Yield the bench of ``job``; its processes are ended afterwards. recorder: sinks of a recording."""
    if job.rig.value.host.time == "lock_step":
        text = '"lock_step": an operator at the console has the wall clock'
        raise BadInput.single(job.rig.where("host.time"), "rig.host.time", text)
    parts = SessionParts(operator, operator.on_progress, announce)
    numbers = accumulate(parts, job)
    with ExitStack() as stack:
        sinks = recorder or stack.enter_context(_unrecorded_sinks(job))
        rings = {name: ring for name in ring_dtypes() if name != "cycles" and isinstance(ring := sinks[name], Ring)}
        cycles = sinks["cycles"]
        assert isinstance(cycles, Ring)
        assert sinks.run_time is not None
        if job.rig.value.kind != "mock":
            bench: WiredBench = stack.enter_context(build.wired_bench(job, announce, sinks))
            assert isinstance(bench.clock, WallClock)
            bench.connect(parts)
            build.attach_parts(job, parts, sinks, stack)
            runner = bench.built(parts)
            yield ConsoleBench(
                runner, cycles, bench.clock, sinks.run_time, sinks.events, numbers, bench.addresses, rings, bench
            )
            return
        clock = WallClock(speed=job.speed)
        host = job.rig.value.host
        parts.scheduling = stack.enter_context(RealTime(host.fifo, host.cpu))
        parts.telemetry, parts.clock = cycles, clock
        build.attach_parts(job, parts, sinks, stack)
        rate = WallClockRate(clock, job.scenario.value.step_s)
        maker = sinks.image_encoder(job.rig.value) if job.scenario.value.vmu.source == "rendered" else None
        pictures = ThreadedImageSink(maker) if maker else None
        if pictures:
            stack.callback(pictures.close)
        runner = build.in_memory(job, rate, parts, pictures)
        yield ConsoleBench(runner, cycles, clock, sinks.run_time, sinks.events, numbers, {}, rings)


@contextmanager
def _unrecorded_sinks(job: build.Job) -> Iterator[RecordingSinks]:
    """Yield sinks of a session without a recording: only the console reads them."""
    fed = required_sinks(job)
    slots = ring_slots(job) | {"cycles": TELEMETRY_ROWS}
    rings = {name: Ring.create(dtype, slots[name], name) for name, dtype in ring_dtypes().items() if name in fed}
    run_time = RunTime()
    takers: dict[str, Telemetry] = {name: rings.get(name, NoTelemetry()) for name in ring_dtypes()}
    try:
        yield RecordingSinks(**takers, run_time=run_time)
    finally:
        run_time.close()
        for ring in rings.values():
            ring.close()
