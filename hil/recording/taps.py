"""Where a run is tapped: rows, frames, notes and pictures go to whoever records them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from hil.config.rig import Rig
from hil.core.camera_images import ImageEncoder
from hil.core.messages import Event
from hil.core.modes import Mode
from hil.frmn.image_memory import PictureMemory, wanted_pictures
from hil.frmn.ring import NoTelemetry, Ring, Telemetry
from hil.frmn.run_time import RunTime
from hil.loop.runner import Runner
from hil.recording.schema import NOTE
from hil.safety.alarms import Alarm

_Put = TypeVar("_Put", bound=Telemetry)


class EventRecorder:
    """Puts down events, alarms, modes, orders and settings as they happen, with the cycle that they belong to.

    ``note`` may be called from the loop's thread alone. Texts are cut to the room they have.
    """

    def __init__(self, out: Telemetry, runner: Runner) -> None:
        self._out = out
        self._runner = runner
        self._row = np.zeros(1, NOTE)

    def log_event(self, kind: str, source: str, text: str, t_s: float | None = None, cycle: int | None = None) -> None:
        """Put down one line; t_s: time of the run, cycle: its number; by default those of the last cycle."""
        done = self._runner.loop.gnc.cycle
        last_s = float(self._runner.loop.now.t_s[0]) if done >= 0 else math.nan
        self._row[0] = (
            last_s if t_s is None else t_s,
            self._runner.now_s(),
            done if cycle is None else cycle,
            kind.encode(),
            _cut(source, NOTE["source"].itemsize),
            _cut(text, NOTE["text"].itemsize),
        )
        self._out.put(self._row)

    def event(self, event: Event) -> None:
        """Put down what happened in the run."""
        self.log_event("event", event.source, event.text, event.t_s)

    def alarm(self, alarm: Alarm) -> None:
        """Put down an alarm."""
        self.log_event("alarm", alarm.device, alarm.text)

    def mode(self, mode: Mode) -> None:
        """Put down a change of mode."""
        self.log_event("mode", "bench", mode.value)

    def order(self, cycle: int, text: str) -> None:
        """Put down an order that acts from ``cycle`` on; the replay gives it there again."""
        self.log_event("order", "operator", text, cycle=cycle)

    def setting(self, cycle: int, who: str, text: str) -> None:
        """Put down ``key=value`` that ``who`` has changed from ``cycle`` on; the replay does it there again."""
        self.log_event("setting", who, text, cycle=cycle)


@dataclass
class RecordingSinks:
    """Takers of CYCLE, ARRIVAL, NOTE, PICTURE and PORTION rows; each keeps a copy of what it is given and never waits.

    pictures: of the vision unit; monitor_pictures, portions: of the docking monitor. Each has one writer. run_time:
    is told the run's time for those that know bench time alone.
    """

    cycles: Telemetry = field(default_factory=NoTelemetry)
    arrivals: Telemetry = field(default_factory=NoTelemetry)
    notes: Telemetry = field(default_factory=NoTelemetry)
    pictures: Telemetry = field(default_factory=NoTelemetry)
    monitor_pictures: Telemetry = field(default_factory=NoTelemetry)
    portions: Telemetry = field(default_factory=NoTelemetry)
    run_time: RunTime | None = None

    def attach(self, runner: Runner) -> EventRecorder:
        """Tap ``runner``, which has not begun: all but its cycles, which go where its loop's telemetry is."""
        notes = EventRecorder(self.notes, runner)
        loop = runner.loop
        loop.vision.frame_sink = self.arrivals
        if self.run_time is not None:
            loop.vision.on_run_zero = self.run_time.set_zero
        for events in (*loop.gnc.event_logs, runner.events):
            events.subscribe(notes.event)
        loop.gnc.orders.subscribe(lambda order: notes.order(*order))
        runner.safety.alarms.raised.subscribe(notes.alarm)
        runner.safety.modes.history.subscribe(notes.mode)
        return notes

    def maker(self, rig: Rig) -> ImageEncoder | None:
        """Return what takes the pictures of a vision unit in this process, as ``rig`` wants them; None for nobody."""
        wanted = wanted_pictures(rig)
        if wanted.encoding == "none" or isinstance(self.pictures, NoTelemetry):
            return None
        return ImageEncoder(self.pictures, wanted, self.run_time)

    def monitor_maker(self, rig: Rig) -> ImageEncoder | None:
        """Return what takes the pictures of a docking monitor in this process; None for nobody."""
        wanted = wanted_pictures(rig)
        if wanted.encoding == "none" or isinstance(self.monitor_pictures, NoTelemetry):
            return None
        return ImageEncoder(self.monitor_pictures, wanted)

    def picture_memory(self) -> PictureMemory | None:
        """Return where a vision unit in another process puts its pictures; None where they go into no ring."""
        if not isinstance(self.pictures, Ring) or self.run_time is None:
            return None
        return PictureMemory(self.pictures.descriptor, self.pictures.slots, self.run_time.descriptor)


def _cut(text: str, size: int) -> bytes:
    return text.encode()[:size]
