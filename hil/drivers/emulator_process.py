"""Emulated devices in processes of their own, so that killing one is like pulling its plug.

Parent and child speak by pipes: one JSON line of configuration down the child's stdin, one JSON line
``{"pid": ..., "addresses": {name: address}}`` up its stdout; the end of stdin ends the child.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol

from hil.drivers.fault_injection import ControlPort, Faults
from hil.errors import LinkLost, LinkTimeout, ProtocolError

_PR_SET_PDEATHSIG: Final = 1  # linux/prctl.h
_RUN_ENDS_WALL_S: Final = 0.1  # how long the child waits for an emulator that is to end
_EXIT_WALL_S: Final = 0.2  # how long the parent waits for a child whose stdin it closed
_TERMINATE_WALL_S: Final = 0.05
_KILL_WALL_S: Final = 1.0  # a killed one is gone when the kernel has let go of its memory
_LAST_WORDS_BYTES: Final = 2000


class Emulator(Protocol):
    """An emulated device, and the faults that can be switched on in it."""

    @property
    def faults(self) -> Faults | None: ...

    def start(self) -> dict[str, str]:
        """Open the wires; return name -> address."""

    def run(self, stop: threading.Event) -> None:
        """Serve until ``stop`` is set."""

    def close(self) -> None:
        """Let go of the wires."""


def die_with_parent(number: int = signal.SIGKILL) -> None:
    """Let the kernel send this process the signal ``number`` when its parent dies."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


def serve(make_emulator: Callable[[dict[str, Any]], Emulator], when_orphaned: int = signal.SIGKILL) -> None:
    """Be the child: build the emulator from the line on stdin, announce it, run it until stdin ends or SIGTERM.

    when_orphaned: the signal that the kernel sends when the parent dies. SIGTERM lets the child stop what it drives.
    An error of the emulator ends the process by traceback. SIGINT is left to the parent, which stops the
    bench before its devices go. What the emulator prints goes to stderr: stdout is for the announcement.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with_parent(when_orphaned)
    announcement = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    ended, end = os.pipe()
    signal.signal(signal.SIGTERM, lambda *_: os.write(end, b"t"))
    line = sys.stdin.buffer.readline()
    if not line:
        return  # the parent is gone already
    emulator = make_emulator(json.loads(line))
    control = ControlPort(emulator.faults) if emulator.faults else None
    try:
        addresses = emulator.start()
        if emulator.faults and control:
            addresses = {**addresses, f"{emulator.faults.device}.faults": control.address}
        ready = {"pid": os.getpid(), "addresses": addresses}
        # what was imported stays: a collection that walks through all of it lasts longer than a drive's watchdog
        gc.collect()
        gc.freeze()
        with os.fdopen(announcement, "w") as up:
            up.write(json.dumps(ready) + "\n")
        _run_until(emulator, ended, end)
    finally:
        if control:
            control.close()
        emulator.close()


def _run_until(emulator: Emulator, ended: int, end: int) -> None:
    """Run the emulator in a thread until a byte comes out of ``ended`` or stdin ends; raise what it raised."""
    stop = threading.Event()
    failures: list[BaseException] = []

    def run() -> None:
        try:
            emulator.run(stop)
        except BaseException as error:
            failures.append(error)
        finally:
            os.write(end, b"r")

    worker = threading.Thread(target=run, name="emulator", daemon=True)
    worker.start()
    stdin = sys.stdin.fileno()
    while True:
        ready, _, _ = select.select([ended, stdin], [], [])
        if ended in ready or not os.read(stdin, 4096):
            break
    stop.set()
    worker.join(_RUN_ENDS_WALL_S)  # one that hangs on its wire ends with the process
    if failures:
        raise failures[0]


class EmulatorProcess:
    """One emulated device in a child process that runs ``argv`` (a program that calls ``serve``).

    The constructor starts the child and returns; start several, then ``wait_ready`` for each. The child
    does not outlive its parent. The kernel takes the *thread* that starts it for the parent: start it
    from one that lives as long as the bench. ``pass_fds`` are open in the child under the same numbers.
    """

    def __init__(
        self, name: str, argv: Sequence[str], configuration: Mapping[str, Any], pass_fds: Sequence[int] = ()
    ) -> None:
        self.name = name
        self._said = b""
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the child
        try:
            self._process = subprocess.Popen(
                argv,
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._stderr,
                pass_fds=pass_fds,
            )
        except OSError as cause:
            self._stderr.close()
            raise LinkLost(name, f"emulator cannot be started: {cause}") from cause
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._stdin, self._stdout = self._process.stdin, self._process.stdout
        with contextlib.suppress(BrokenPipeError):  # it died at once: wait_ready tells why
            self._stdin.write(json.dumps(configuration).encode() + b"\n")

    @property
    def pid(self) -> int:
        return self._process.pid

    def wait_ready(self, timeout_s: float) -> dict[str, str]:
        """Return the child's addresses, name -> address, within ``timeout_s`` of wall time.

        Raises LinkLost when the child ended, LinkTimeout when it stays silent, ProtocolError when it says
        something else; the text holds the last lines of its stderr.
        """
        deadline_s = time.monotonic() + timeout_s
        while b"\n" not in self._said:
            ready, _, _ = select.select([self._stdout], [], [], max(0.0, deadline_s - time.monotonic()))
            if not ready:
                raise LinkTimeout(self.name, f"emulator is not ready after {timeout_s:g} s{self._last_words()}")
            said = os.read(self._stdout.fileno(), 4096)
            if not said:
                raise LinkLost(self.name, f"emulator ended before it was ready{self._last_words()}")
            self._said += said
        try:
            addresses = json.loads(self._said)["addresses"]
            return {str(name): str(address) for name, address in addresses.items()}
        except (ValueError, LookupError, TypeError, AttributeError) as cause:
            raise ProtocolError(self.name, f"emulator announced {self._said!r}{self._last_words()}") from cause

    def ended(self) -> str:
        """Return how the child ended, "" while it lives; never waits."""
        code = self._process.poll()
        if code is None:
            return ""
        return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"

    def ask_to_end(self) -> None:
        """Close the child's stdin, so that it ends; returns at once. Ask all before closing each."""
        self._stdin.close()

    def kill(self) -> None:
        """End the child at once, as by pulling its plug; ``close`` then only cleans up."""
        self._process.kill()

    def close(self) -> None:
        """End the child, if need be by SIGTERM and then SIGKILL, which comes after 0.25 s; idempotent."""
        self.ask_to_end()
        for number, wall_s in (
            (None, _EXIT_WALL_S),
            (signal.SIGTERM, _TERMINATE_WALL_S),
            (signal.SIGKILL, _KILL_WALL_S),
        ):
            if number is not None:
                self._process.send_signal(number)
            if self._ended_within(wall_s):
                break
        self._stdout.close()
        self._stderr.close()

    def _ended_within(self, wall_s: float) -> bool:
        try:
            self._process.wait(wall_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def _last_words(self) -> str:
        """Return the end of the child's stderr on lines of their own, or nothing."""
        # pread: the child writes on at the file position that both share
        size = os.fstat(self._stderr.fileno()).st_size
        start = max(0, size - _LAST_WORDS_BYTES)
        text = os.pread(self._stderr.fileno(), _LAST_WORDS_BYTES, start).decode(errors="replace").strip()
        return f":\n{text}" if text else ""
