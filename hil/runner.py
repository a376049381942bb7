"""Runs a scenario on a bench: opens the devices, places the bench, closes the loop, stops the bench first."""

from __future__ import annotations

import gc
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from hil.cycle import Loop, run_cycle
from hil.drivers.base import PoseSource
from hil.errors import BenchError, SafetyTrip
from hil.io_stage import chain_kept_closed
from hil.messages import AXES, Event, new
from hil.modes import Mode, ModeMachine
from hil.rate import Rate
from hil.stages import Move

COMPLETED = "completed"
STOPPED_BY_OPERATOR = "stopped by the operator"
_SETTLE_S = 3.0  # after placing, until the axes stand where they should
_SETTLED_M = 0.001
_SETTLED_RAD = 0.001

Watch = Callable[[Mode, float], None]
"""Told now and then what the bench is doing and how far along it is, 0..1."""


@dataclass(slots=True)
class Outcome:
    """What a run left: ``history`` (n,) of CYCLE, why it ended, and what was counted."""

    history: np.ndarray
    stop: str
    faults: list[str] = field(default_factory=list)
    mode: Mode = Mode.OFF
    overruns: int = 0
    limited_cycles: int = 0
    vision_counters: dict[str, int] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)


class Runner:
    """One run of ``cycles`` cycles.

    frames_to_arm: poses that must have come before the loop is closed. ``watch`` is called every
    ``WATCH_CYCLES`` cycles.
    """

    WATCH_CYCLES = 50

    def __init__(self, loop: Loop, rate: Rate, step_s: float, cycles: int, frames_to_arm: int, watch: Watch) -> None:
        self.loop = loop
        self._rate = rate
        self._step_s = step_s
        self._cycles = cycles
        self._frames_to_arm = frames_to_arm
        self._watch = watch
        self._modes = ModeMachine()
        self._done = 0

    @property
    def source(self) -> PoseSource:
        return self.loop.vision.source

    def run(self) -> Outcome:
        """Run to the end, to a fault, or to Ctrl-C; the bench stands still whatever happened."""
        with _no_garbage_collection(first=self._rate.on_the_wall):
            stop, faults = self._run()
        self._modes.go(Mode.SAFE_STOP if faults else Mode.STANDBY)
        return Outcome(
            history=self.loop.history[: self._done],
            stop=stop,
            faults=faults,
            mode=self._modes.mode,
            overruns=self._rate.overruns,
            limited_cycles=self.loop.bench.limited_cycles,
            vision_counters=self.source.counters(),
            events=self.loop.gnc.events(),
        )

    def _run(self) -> tuple[str, list[str]]:
        stop = COMPLETED
        faults: list[str] = []
        try:
            self._open()
            self._place()
            self._arm()
            self._close_the_loop()
        except BenchError as fault:
            stop = str(fault)
            faults.append(stop)
        except KeyboardInterrupt:
            stop = STOPPED_BY_OPERATOR
            faults.append(stop)
        finally:
            self._shut_down()
        return stop, faults

    def _open(self) -> None:
        self.loop.lines.open(self._rate)
        with chain_kept_closed(self.loop.lines, self._rate):
            self.loop.bench.open(self._rate.now_s())
            self.loop.target.open(self._rate.now_s())
            self.source.open(self._rate.now_s())
        self._modes.go(Mode.STANDBY)

    def _place(self) -> None:
        """Move all axes slowly to the start pose and wait until they stand there."""
        self._modes.go(Mode.PLACING)
        bench, now = self.loop.bench, self.loop.now
        self._rate.restart()
        tick = self._rate.wait()
        bench.read(tick.now_s, now.feedback)
        bench.seed(now.feedback)
        target = new(AXES)
        at_rest = np.zeros(3)
        bench.axes_of(now.truth.r_CT_H, at_rest, now.truth.q_CH, at_rest, target)
        move = Move(bench.params, now.feedback, target)
        wanted = new(AXES)
        start_s = tick.now_s
        cycle = 0
        while not self._stands_at(target):
            moved_s = tick.now_s - start_s
            if moved_s > move.duration_s + _SETTLE_S:
                raise SafetyTrip("bench", "start pose", "not reached", f"{_SETTLE_S:g} s after the move")
            move.at(moved_s + self._step_s, wanted)
            bench.command(wanted, tick.now_s, now.setpoint)
            tick = self._rate.wait()
            self.loop.lines.look(tick.now_s)
            bench.read(tick.now_s, now.feedback)
            bench.check(now.feedback)
            cycle += 1
            if cycle % self.WATCH_CYCLES == 0 and move.duration_s > 0.0:
                self._watch(Mode.PLACING, min(1.0, moved_s / move.duration_s))

        self.loop.target.place(self._rate, self._stand_by)

    def _stand_by(self, now_s: float) -> None:
        """Look after the chaser's axes, which hold, while the target's move."""
        self.loop.lines.look(now_s)
        self.loop.bench.read(now_s, self.loop.now.feedback)
        self.loop.bench.check(self.loop.now.feedback)

    def _stands_at(self, target: np.record) -> bool:
        feedback = self.loop.now.feedback
        return bool(
            np.abs(feedback.rail_m - target.rail_m).max() < _SETTLED_M
            and np.abs(feedback.gimbal_rad - target.gimbal_rad).max() < _SETTLED_RAD
        )

    def _arm(self) -> None:
        """Wait until the vision unit has delivered."""
        self._modes.go(Mode.ARMED)
        frames = 0
        while frames < self._frames_to_arm:
            tick = self._rate.wait()
            self.loop.lines.look(tick.now_s)
            self.loop.target.look(tick.now_s)
            frames += len(self.source.poll(tick.now_s))
            self.loop.bench.read(tick.now_s, self.loop.now.feedback)
            self._watch(Mode.ARMED, 0.0)

    def _close_the_loop(self) -> None:
        self._modes.go(Mode.RUNNING)
        self._rate.restart()
        for k in range(self._cycles):
            tick = self._rate.wait()
            run_cycle(self.loop, k, k * self._step_s, tick.now_s, tick.run_zero_s, tick.lateness_s)
            self._done = k + 1
            if k % self.WATCH_CYCLES == 0:
                self._watch(Mode.RUNNING, k / self._cycles)
        self.loop.gnc.finish((self._cycles - 1) * self._step_s, self.loop.now.supervision)
        self._watch(Mode.RUNNING, 1.0)

    def _shut_down(self) -> None:
        """Stop the bench first, then let go of everything."""
        with _ctrl_c_held_back():
            with chain_kept_closed(self.loop.lines, self._rate):
                self.loop.bench.stop(self._rate.now_s())
                self.loop.target.stop(self._rate.now_s())
                self.source.close()
                self.loop.bench.close()
                self.loop.target.close()
            self.loop.lines.stop(self._rate.now_s())
            self.loop.lines.close()


@contextmanager
def _no_garbage_collection(first: bool) -> Iterator[None]:
    """Keep the collector's pauses away from enabled drives: one full collection can outlast their watchdogs."""
    if first:
        gc.collect()
        gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Let nobody interrupt the stopping of the bench."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
