"""Where a run is tapped: rows, frames, notes and pictures go to whoever records them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from hil.errors import BadInput
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.messages import Event
from hil.modes import Mode
from hil.recording.schema import NOTE, PICTURE, PICTURE_BYTES
from hil.runner import Runner
from hil.safety.alarms import Alarm

_Put = TypeVar("_Put", bound=Telemetry)


class Notes:
    """Puts down events, alarms, modes, orders and settings as they happen, with the cycle that they belong to.

    ``note`` may be called from the loop's thread alone. Texts are cut to the room they have.
    """

    def __init__(self, out: Telemetry, runner: Runner) -> None:
        self._out = out
        self._runner = runner
        self._row = np.zeros(1, NOTE)

    def note(self, kind: str, source: str, text: str, t_s: float | None = None, cycle: int | None = None) -> None:
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
        self.note("event", event.source, event.text, event.t_s)

    def alarm(self, alarm: Alarm) -> None:
        """Put down an alarm."""
        self.note("alarm", alarm.device, alarm.text)

    def mode(self, mode: Mode) -> None:
        """Put down a change of mode."""
        self.note("mode", "bench", mode.value)

    def order(self, cycle: int, text: str) -> None:
        """Put down an order that acts from ``cycle`` on; the replay gives it there again."""
        self.note("order", "operator", text, cycle=cycle)


@dataclass
class Taps:
    """Takers of CYCLE, ARRIVAL, NOTE and PICTURE rows; each keeps a copy of what it is given and never waits."""

    cycles: Telemetry = field(default_factory=NoTelemetry)
    arrivals: Telemetry = field(default_factory=NoTelemetry)
    notes: Telemetry = field(default_factory=NoTelemetry)
    pictures: Telemetry = field(default_factory=NoTelemetry)

    def attach(self, runner: Runner) -> Notes:
        """Tap ``runner``, which has not begun: all but its cycles, which go where its loop's telemetry is."""
        notes = Notes(self.notes, runner)
        loop = runner.loop
        loop.vision.tap = self.arrivals
        for events in (*loop.gnc.logs, runner.events):
            events.tell(notes.event)
        loop.gnc.orders.tell(lambda order: notes.order(*order))
        runner.supervisor.alarms.entered.tell(notes.alarm)
        runner.supervisor.modes.history.tell(notes.mode)
        return notes


def picture_row(camera: str, t_s: float, jpeg: bytes) -> np.ndarray:
    """Return a picture as a row for ``Taps.pictures``, shape (1,); t_s: exposure, time of the run.

    Raises BadInput for one that is larger than PICTURE_BYTES.
    """
    if len(jpeg) > PICTURE_BYTES:
        raise BadInput.single(camera, "", f"picture of {len(jpeg)} bytes, at most {PICTURE_BYTES}: compress it more")
    row = np.zeros(1, PICTURE)
    row["t_s"], row["camera"], row["size"] = t_s, camera.encode(), len(jpeg)
    row["jpeg"][0, : len(jpeg)] = np.frombuffer(jpeg, np.uint8)
    return row


def _cut(text: str, size: int) -> bytes:
    return text.encode()[:size]
