"""Recorder: drains the rings of a run on the wall clock into its file. The loop never waits for it.

It ends when its parent sends the end of the run, or dies: then it drains the rings and closes the file.
"""

from __future__ import annotations

import os
import sqlite3
import time
from contextlib import suppress
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from hil.core.camera_images import IMAGE
from hil.core.child_process import Message, Parent
from hil.core.clock import utc_text
from hil.core.fields import record_dtype
from hil.core.messages import ARRIVAL, AXES_SAMPLE, CYCLE, HELD_SAMPLE, IMU_SAMPLE, MANIPULATOR_SAMPLE
from hil.core.part import imported, part_sinks
from hil.core.sensor_records import SENSOR_ARRIVAL
from hil.errors import BadInput
from hil.frmn.mailbox import Mailbox, MailboxBlock
from hil.frmn.ring import Reader, Ring
from hil.recording.catalogue import BROKEN_OFF, Catalogue
from hil.recording.parts import PartedFile
from hil.recording.schema import LOG_ENTRY
from hil.recording.writer import FLUSH_S, RecordingHeader, RunFile

_POLL_WALL_S: Final = 0.02
_ROWS_MAX: Final = 512  # rows per ring and poll
_IMAGES_MAX: Final = 2
_NICENESS: Final = -10  # ahead of other processes without real-time priority; it uses a few percent of a CPU
_DTYPES: Final = {
    "cycles": CYCLE,
    "arrivals": ARRIVAL,
    "log": LOG_ENTRY,
    "images": IMAGE,
    "imu_samples": IMU_SAMPLE,
    "axes_samples": AXES_SAMPLE,
    "sensor_samples": SENSOR_ARRIVAL,
    "manipulator_samples": MANIPULATOR_SAMPLE,
    "held_samples": HELD_SAMPLE,
}


@cache
def ring_dtypes() -> dict[str, np.dtype]:
    """Return the record of each ring, by its name in ``RecordingSinks``; of parts as well."""
    of_parts = {
        name: record_dtype(imported(sink.fields)) if sink.topic else IMAGE for name, sink in part_sinks().items()
    }
    return _DTYPES | of_parts


STATE: Final = np.dtype([("cycles", "i8"), ("dropped", "i8"), ("size_bytes", "i8"), ("problem", "S128")])
"""State of a recording, written every ``FLUSH_S`` while the recorder runs, with the time of ``time.monotonic``.

problem: error after which nothing more is written to the disk."""
STATE_MAILBOX: Final = {"state": STATE}


class Recorder:
    """Moves rows from the rings into the file and counts those that were overwritten. state: receives STATE."""

    def __init__(self, file: RunFile | PartedFile, rings: dict[str, Ring], state: Mailbox) -> None:
        self._file = file
        self._state = state
        self._row = np.zeros(1, STATE)
        self._readers: dict[str, Reader] = {name: ring.reader() for name, ring in rings.items()}
        self._flushed_s = time.monotonic()
        self._publish_state()

    def poll(self) -> bool:
        """Write the available rows; return whether there may be more."""
        more = False
        for name, reader in self._readers.items():
            lost = reader.lost
            rows_max = _IMAGES_MAX if ring_dtypes()[name] is IMAGE else _ROWS_MAX
            rows = reader.read(rows_max)
            self._file.count_lost(reader.lost - lost)
            if len(rows):
                self._file.writers[name](rows)
            more = more or len(rows) == rows_max
        now_s = time.monotonic()
        if now_s - self._flushed_s >= FLUSH_S:
            self._flushed_s = now_s
            self._file.flush()
            self._publish_state()
        return more

    def _publish_state(self) -> None:
        stats = self._file.stats()
        problem = self._file.disk_error.encode()[: STATE["problem"].itemsize]
        self._row[0] = (stats.cycles or 0, stats.dropped, stats.size_bytes, problem)
        self._state.write(self._row, time.monotonic())

    def drain(self) -> None:
        """Write all rows."""
        while self.poll():
            pass


def record_until_ended(recorder: Recorder, parent: Parent) -> Message | None:
    """Record until the parent sends the end of the run; return that message, None if the parent has died."""
    while True:
        wait_s = 0.0 if recorder.poll() else _POLL_WALL_S
        try:
            message = parent.receive(wait_s)
        except TimeoutError:
            continue
        except EOFError:
            message = None
        recorder.drain()
        return message


def run_child(parent: Parent) -> None:
    """Record the run of the process that started this one into one file."""
    with suppress(OSError):  # if allowed: rows that wait too long in a ring are overwritten
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    np.seterr(all="ignore")  # NaN and infinity are recorded as they are
    configuration = parent.configuration
    rings = {
        name: Ring(descriptor, ring_dtypes()[name], slots, name)
        for name, (descriptor, slots) in configuration["rings"].items()
    }
    path = Path(configuration["file"])
    try:
        file = PartedFile(path, RecordingHeader(**configuration["header"]))
    except OSError as error:
        parent.send(problem=error.strerror)
        return
    parent.send(problem="")
    block = MailboxBlock(configuration["state"], STATE_MAILBOX, "recorder")
    recorder = Recorder(file, rings, block["state"])
    end = record_until_ended(recorder, parent)
    if end is not None:
        stats = file.finish(end["end"], end["summary"])
        with suppress(OSError):
            parent.send(**asdict(stats))
        return
    stats = file.finish({"stop": "the loop's process was gone", "ended_utc": utc_text()})
    with suppress(sqlite3.Error, BadInput):
        Catalogue(path.parent).end(configuration["run"], utc_text(), BROKEN_OFF, stats.cycles, stats.dropped, {})
