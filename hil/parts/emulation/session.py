"""A bench on wires whose devices are emulated, by the wall clock or in lock-step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any, Final

import numpy as np

from hil.bench.field_of_view import camera_errors
from hil.bench.manipulator import relative_axes
from hil.config.rig import Rig
from hil.config.tables.machine import FULL_SCALE, BenchScale
from hil.core.clock import BenchClock
from hil.core.kernel_record import kernel_record
from hil.core.messages import CYCLE
from hil.core.realtime import DefaultScheduling, SchedulingPolicy, short_turns, speed_held
from hil.drivers.serial_port import is_counted
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.loop.rate_keeper import Rate
from hil.loop.session_parts import SessionParts
from hil.params import bench as bench_params
from hil.parts.emulation.emulated_devices import EmulatedDevices
from hil.parts.emulation.lock_step import LockStepConductor
from hil.parts.emulation.shared_state import SharedAxisState
from hil.parts.wires.wired import WiredBench, Wires, in_real_time, wired_bench
from hil.recording.sinks import RecordingSinks
from hil.sensors.vision_unit import parameters as vmu_params
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


class TrueAxesWatch:
    """Telemetry that also compares, in each cycle, the emulated axes with the truth that they are to show.

    now_s: bench time. step_s: period of the cycle.
    """

    def __init__(
        self,
        board: SharedAxisState,
        rig: Rig,
        now_s: Callable[[], float],
        step_s: float,
        shown: BenchScale = FULL_SCALE,
    ) -> None:
        self._rows: Telemetry = NoTelemetry()
        self._board, self._now_s = board, now_s
        self._bench = kernel_record(bench_params.bench_as_built(rig, step_s, shown))
        self._mounting = kernel_record(vmu_params.mounting(rig))
        self._manipulator = bench_params.manipulator(rig)
        self._errors = np.zeros(1), np.zeros(1)
        self._n, self._squares, self._largest = 0, np.zeros(2), np.zeros(2)
        self._compare(np.zeros(1, CYCLE), 0.0)  # compiles the kernel outside the cycle

    def over(self, rows: Telemetry) -> Telemetry:
        """Return this telemetry, which passes each row on to ``rows``."""
        self._rows = rows
        return self

    def put(self, row: np.ndarray) -> None:
        """Pass ``row``, (1,) of CYCLE, on, and compare the axes at its time with its truth."""
        run_zero_s = self._now_s() - float(row["commanded_s"][0])  # the command was stamped just before
        self._rows.put(row)
        self._compare(row, run_zero_s + float(row["t_s"][0]))
        errors = np.concatenate(self._errors)
        self._n += 1
        self._squares += errors * errors
        np.maximum(self._largest, errors, out=self._largest)

    def numbers(self) -> dict[str, Any]:
        """Return rms and largest error, for the table ``bench`` of the JSON."""
        rms = np.sqrt(self._squares / max(1, self._n))
        return {
            f"true_pose_error_{unit}": {"rms": scale * float(rms[i]), "max": scale * float(self._largest[i])}
            for i, (unit, scale) in enumerate((("mm", 1e3), ("deg", math.degrees(1.0))))
        }

    def _compare(self, row: np.ndarray, bench_s: float) -> None:
        rails, gimbals, target = (self._board.read(device, bench_s)[0] for device in ("rails", "turntable", "target"))
        rails, gimbals = relative_axes(self._bench, self._manipulator, rails, gimbals, target)
        truth = row["truth"]
        camera_errors(
            self._bench, self._mounting, rails[None], gimbals[None], truth["r_CT_H"], truth["q_CH"], *self._errors
        )
