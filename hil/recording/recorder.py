"""The recorder process: drains the rings of a run on wires into its file. The loop never waits for it.

``python -m hil.recording.recorder`` is the child; it gets its configuration from its parent. It ends when its
parent says how the run ended, or is gone: then it takes what the rings still hold and closes the file.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import sqlite3
import sys
import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.core.camera_images import PICTURE
from hil.core.messages import ARRIVAL, CYCLE
from hil.errors import BadInput
from hil.frmn.mailbox import Mailbox, MailboxBlock
from hil.frmn.ring import Reader, Ring
from hil.monitor.results import PORTION
from hil.recording.catalogue import BROKEN_OFF, Catalogue
from hil.recording.schema import NOTE
from hil.recording.utc import utc_text
from hil.recording.writer import FLUSH_S, RecordingHeader, RecordingStats, RunFile

_LOOK_WALL_S: Final = 0.02
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
READY: Final = b"ready\n"

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

    def look(self) -> bool:
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
        while self.look():
            pass


def record_until_told(recorder: Recorder, parent: socket.socket) -> dict[str, Any] | None:
    """Record until the parent says how the run ended, or is gone: None."""
    said = b""
    while True:
        wait_s = 0.0 if recorder.look() else _LOOK_WALL_S
        if select.select([parent], [], [], wait_s)[0]:
            part = parent.recv(1 << 16)
            said += part
            if not part or said.endswith(b"\n"):
                recorder.drain()
                return json.loads(said) if said.endswith(b"\n") else None


def record(configuration: dict[str, Any]) -> None:
    """Be the recorder of one run."""
    parent = socket.socket(fileno=configuration["socket"])
    rings = {
        name: Ring(descriptor, KINDS[name], slots, name) for name, (descriptor, slots) in configuration["rings"].items()
    }
    path = Path(configuration["file"])
    try:
        file = RunFile(path, RecordingHeader(**configuration["header"]))
    except OSError as error:
        parent.sendall(f"{error.strerror}\n".encode())
        return
    parent.sendall(READY)
    block = MailboxBlock(configuration["state"], CELLS, "recorder")
    recorder = Recorder(file, rings, block["state"])
    said = record_until_told(recorder, parent)
    if said is None:
        account = file.finish({"stop": "the loop's process was gone", "ended_utc": utc_text()})
        with suppress(sqlite3.Error, BadInput):
            Catalogue(path.parent).end(
                configuration["run"], utc_text(), BROKEN_OFF, account.cycles, account.dropped, {}
            )
        return
    account = file.finish(said["end"], said["summary"])
    _answer(parent, account)


def _answer(parent: socket.socket, account: RecordingStats) -> None:
    with suppress(OSError):
        parent.sendall(json.dumps(asdict(account)).encode() + b"\n")


def main() -> None:
    """Read the configuration from standard input and record; Ctrl-C is the parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the parent's end says when to end
    with suppress(OSError):  # where it may: what stands in a ring too long is lost
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    np.seterr(all="ignore")  # what is not a number is recorded as it is
    record(json.loads(sys.stdin.readline()))


if __name__ == "__main__":
    main()
