"""Sinks of a recording: rows, frames, log entries and images of a run go to its recorder."""

from __future__ import annotations

import math

import numpy as np

from hil.config.rig import Rig
from hil.core.alarms import Alarm
from hil.core.build_info import VERSION
from hil.core.camera_images import ImageEncoder
from hil.core.messages import Event
from hil.core.modes import Mode
from hil.core.surroundings import local_user
from hil.frmn.image_memory import ImageMemory, RunTime, image_policy
from hil.frmn.ring import NoTelemetry, Ring, Telemetry
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.recording.audit import Actor, AuditChain
from hil.recording.foxglove import log
from hil.recording.schema import LOG_ENTRY


class EventRecorder:
    """Log of a recording: events, alarms, modes, orders and settings with the cycle to which they belong.

    ``log_event`` must be called from the loop's thread only. Texts are truncated to the size of LOG_ENTRY.
    """

    def __init__(self, out: Telemetry, runner: Runner, audit: AuditChain) -> None:
        self._out = out
        self._audit = audit
        self._runner = runner
        self._row = np.zeros(1, LOG_ENTRY)

    def log_event(self, kind: str, who: Actor, text: str, t_s: float | None = None, cycle: int | None = None) -> None:
        """Write one entry; t_s: time of the run, cycle: its number; by default those of the last cycle."""
        done = self._runner.loop.gnc.cycle
        last_s = float(self._runner.loop.now.t_s[0]) if done >= 0 else math.nan
        self._row[0] = (
            last_s if t_s is None else t_s,
            self._runner.now_s(),
            done if cycle is None else cycle,
            kind.encode(errors="replace"),
            who.name.encode(errors="replace")[: LOG_ENTRY["source"].itemsize],
            text.encode(errors="replace")[: LOG_ENTRY["text"].itemsize],
            self._audit.entries,
            who.key.encode(),
            who.rights.encode(),
            self._audit.configuration.encode(),
            b"",
        )
        self._row["digest"] = self._audit.link(log(self._row[0], 0)).encode()
        self._out.put(self._row)

    def operator(self, kind: str, who: Actor, text: str) -> None:
        """Log an action of an operator."""
        self.log_event(kind, who if who.name else who._replace(name="console"), text)

    def event(self, event: Event) -> None:
        """Log an event of the run."""
        self.log_event("event", Actor(event.source), event.text, event.t_s)

    def alarm(self, alarm: Alarm) -> None:
        """Log an alarm."""
        self.log_event("alarm", Actor(alarm.device), alarm.text)

    def alarm_change(self, change: tuple[Alarm, str]) -> None:
        """Log an alarm that was acknowledged, shelved, or has returned to normal."""
        alarm, text = change
        self.log_event("alarm state", Actor(alarm.device), f"alarm {alarm.number}, {alarm.quantity}: {text}")

    def mode(self, mode: Mode) -> None:
        """Log a change of mode."""
        self.log_event("mode", Actor("bench"), mode.value)

    def order(self, cycle: int, text: str) -> None:
        """Log an order that acts from ``cycle`` on; the replay repeats it there."""
        self.log_event("order", Actor("operator"), text, cycle=cycle)

    def setting(self, cycle: int, who: Actor, text: str) -> None:
        """Log ``key=value``, changed by ``who`` from ``cycle`` on; the replay repeats it there."""
        self._audit.change(text)
        self.log_event("setting", who, text, cycle=cycle)


class RecordingSinks:
    """Sinks of a recording by name, each with one writer: ``sinks["cycles"]``; of those that it lacks, one for nothing.

    cycles: of CYCLE. arrivals: of ARRIVAL. log: of LOG_ENTRY. images: of the vision unit. imu_samples, axes_samples: of
    an IMU and of axes that are faster than the cycle. manipulator_samples: of all axes of a rig whose target is
    rotated. held_samples: of axes that are held. sensor_samples: of further sensors. Others are those of parts.
    run_time: receives the relation of the run's time to bench time, for sources that have bench time only. audit: of
    the log.
    """

    def __init__(self, run_time: RunTime | None = None, **rows: Telemetry) -> None:
        self.run_time, self.audit = run_time, AuditChain()
        self.events: EventRecorder | None = None
        """Of the last runner."""
        self._rows = rows

    def __getitem__(self, name: str) -> Telemetry:
        return self._rows.get(name, NoTelemetry())

    def attach(self, parts: SessionParts) -> None:
        """Let the session of ``parts`` send its rows and events; its cycles go to its telemetry."""
        parts.sinks = self._rows
        if self.run_time is not None:
            parts.on_run_zero.append(self.run_time.set_zero)
        parts.on_built.append(self._record_events)

    def _record_events(self, runner: Runner) -> None:
        recorder = self.events = EventRecorder(self["log"], runner, self.audit)
        recorder.operator("operator", Actor(local_user(), rights="local"), f"started this run, hil {VERSION}")
        for events in (*runner.loop.gnc.event_logs, runner.events):
            events.subscribe(recorder.event)
        runner.loop.gnc.orders.subscribe(lambda order: recorder.order(*order))
        runner.safety.alarms.raised.subscribe(recorder.alarm)
        runner.safety.alarms.changes.subscribe(recorder.alarm_change)
        runner.safety.modes.history.subscribe(recorder.mode)

    def image_encoder(self, rig: Rig) -> ImageEncoder | None:
        """Return the encoder for a vision unit in this process, as ``rig`` selects its images; None for no images."""
        return encoder(self["images"], rig, self.run_time)

    def image_memory(self) -> ImageMemory | None:
        """Return the shared memory for the images of a vision unit in another process; None without a ring."""
        images = self["images"]
        if not isinstance(images, Ring) or self.run_time is None:
            return None
        return ImageMemory(images.descriptor, images.slots, self.run_time.descriptor)


def encoder(out: Telemetry, rig: Rig, run_time: RunTime | None = None) -> ImageEncoder | None:
    """Return what encodes images for ``out`` as ``rig`` selects them; None for no images."""
    policy = image_policy(rig)
    if policy.encoding == "none" or isinstance(out, NoTelemetry):
        return None
    return ImageEncoder(out, policy, run_time)
