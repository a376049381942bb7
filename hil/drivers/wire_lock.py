"""Locks of a rig's wires: one controller at a time, of any user.

Each wire has a lock file in a folder that all users share; the lock ends with the process that holds it, however that
ends. It is taken before anything is opened, so that the second controller does not disturb the first.
"""

from __future__ import annotations

import hashlib
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Final

from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.driver_registry import Wire
from hil.core.files import KIB
from hil.core.surroundings import shared_lock
from hil.errors import BadInput, Problem, one_line

_FOLDER: Final = "hil-wires"
_COMMAND: Final = 200  # characters of the holder's command


def wires_in_use(_: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each wire of ``rig`` that another process holds."""
    try:
        with locked_wires(rig.value):
            return []
    except BadInput as error:
        return list(error.problems)


@contextmanager
def locked_wires(rig: Rig) -> Iterator[None]:
    """Hold the locks of all wires of ``rig``; raise BadInput, one line per wire that another process holds.

    Emulators make their own wires: of an emulated rig nothing is locked.
    """
    with ExitStack() as held:
        problems = []
        if rig.kind == "hardware":
            of = {normalised(wire): wire for wire in rig.wires() if wire.address is not None}
            for name, wire in sorted(of.items()):  # the same order in each process
                descriptor, holder = _lock(name)
                if holder:
                    problems.append(Problem(f"rig.{wire.key}", str(wire.address), f"is in use by {holder}"))
                else:
                    held.callback(os.close, descriptor)
        if problems:
            raise BadInput(problems)
        yield


def normalised(wire: Wire) -> str:
    """Return the same text for each way to write the address of a wire. An interface that is unknown stays as it is."""
    address = str(wire.address)
    if wire.kind == "serial":
        return f"serial {os.path.realpath(address)}"
    if wire.kind == "tcp":
        host, _, port = address.rpartition(":")
        try:
            host = str(socket.getaddrinfo(host, None, socket.AF_INET)[0][4][0])
        except OSError:
            host = host.lower()
        return f"tcp {host}:{port}"
    return f"{wire.kind} {address}"


def _lock(name: str) -> tuple[int, str]:
    """Return the descriptor of the lock and "", or -1 and the process that holds it."""
    try:
        descriptor, is_ours = shared_lock(_FOLDER, f"{hashlib.sha256(name.encode()).hexdigest()[:24]}.lock")
    except OSError as error:
        raise BadInput.single(str(error.filename), "", f"the wire {name} cannot be locked: {error.strerror}") from error
    if not is_ours:
        holder = os.pread(descriptor, KIB, 0).decode(errors="replace")
        os.close(descriptor)
        return -1, one_line(holder, _COMMAND) or "another process"
    with suppress(OSError):  # a file that another user has made
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"process {os.getpid()}: {' '.join(sys.argv)}"[:_COMMAND].encode(errors="replace"), 0)
    return descriptor, ""
