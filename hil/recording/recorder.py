"""Recorder: drains the rings of a run on the wall clock into its file. The loop never waits for it.

It ends when its parent sends the end of the run, or dies: then it drains the rings and closes the file.
"""

from __future__ import annotations

import os
import sqlite3
import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Final

import numpy as np

from hil.core.camera_images import PICTURE
from hil.core.child_process import Message, Parent
from hil.core.messages import ARRIVAL, CYCLE
from hil.errors import BadInput
from hil.frmn.mailbox import Mailbox, MailboxBlock
from hil.frmn.ring import Reader, Ring
from hil.monitor.results import PORTION
from hil.recording.catalogue import BROKEN_OFF, Catalogue
from hil.recording.schema import NOTE
from hil.recording.utc import utc_text
from hil.recording.writer import FLUSH_S, RecordingHeader, RunFile

_POLL_WALL_S: Final = 0.02
_AT_MOST: Final = 512  # rows at once, so that no look lasts long
_PICTURES_AT_MOST: Final = 2
_NICENESS: Final = -10  # before what is not in real time; it takes a few percent of a CPU
KINDS: Final = {
    "cycles": CYCLE,
    "arrivals": ARRIVAL,
    "notes": NOTE,
    "pictures": PICTURE,
    "monitor_pictures": PICTURE,
    "portions": PORTION,
}
"""Ring by its name in ``Taps`` -> what is in it."""

STATE: Final = np.dtype([("cycles", "i8"), ("dropped", "i8"), ("size_bytes", "i8"), ("trouble", "S128")])
"""How a recording stands, for whoever watches it: written each ``FLUSH_S`` while the recorder lives, with the time by
``time.monotonic``. trouble: why the disk takes nothing any more."""
CELLS: Final = {"state": STATE}


class Recorder:
    """Moves rows from the rings into the file and counts those that were overwritten before.

    state: STATE, where it tells how the recording stands.
    """

    def __init__(self, file: RunFile, rings: dict[str, Ring], state: Mailbox) -> None:
        self._file = file
        self._state = state
        self._told = np.zeros(1, STATE)
        self._readers: dict[str, Reader] = {name: ring.reader() for name, ring in rings.items()}
        self._flushed_s = time.monotonic()
        self._tell()

    def poll(self) -> bool:
        """Write what has come; return whether there may be more."""
        more = False
        for name, reader in self._readers.items():
            lost = reader.lost
            at_most = _PICTURES_AT_MOST if KINDS[name] is PICTURE else _AT_MOST
            rows = reader.read(at_most)
            self._file.lost(reader.lost - lost)
            if len(rows):
                self._file.takers[name](rows)
            more = more or len(rows) == at_most
        now_s = time.monotonic()
        if now_s - self._flushed_s >= FLUSH_S:
            self._flushed_s = now_s
            self._file.flush()
            self._tell()
        return more

    def _tell(self) -> None:
        account = self._file.account()
        trouble = self._file.trouble.encode()[: STATE["trouble"].itemsize]
        self._told[0] = (account.cycles or 0, account.dropped, account.size_bytes, trouble)
        self._state.write(self._told, time.monotonic())

    def drain(self) -> None:
        """Write all that there is."""
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
        name: Ring(descriptor, KINDS[name], slots, name) for name, (descriptor, slots) in configuration["rings"].items()
    }
    path = Path(configuration["file"])
    try:
        file = RunFile(path, RecordingHeader(**configuration["header"]))
    except OSError as error:
        parent.send(problem=error.strerror)
        return
    parent.send(problem="")
    block = MailboxBlock(configuration["state"], CELLS, "recorder")
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
