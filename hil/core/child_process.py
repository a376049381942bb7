"""Child processes of a bench: start, configuration, ready message, results and end, the same for all of them.

The parent starts ``python -m module`` and sends the configuration down the child's stdin; the child sends its ready
message up its stdout. Every message is one line of JSON. The end of stdin asks the child to end. A child's stderr is
kept in a file, and the error that reports the child's failure quotes its last lines.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import gc
import json
import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Any, Final, Protocol, Self, cast
from weakref import WeakValueDictionary

from hil.core.fork_server import ForkedProcess, ForkServer
from hil.core.plug_ins import STACK_SIGNAL, Stack, kernel_error, place_in, plug_in_error, without_exit
from hil.core.surroundings import host_limit, unnamed_file
from hil.errors import DeviceError, HilError, LinkLost, LinkTimeout, PlugInError, ProtocolError, one_line

log = logging.getLogger("hil")
_PR_SET_PDEATHSIG: Final = 1  # linux/prctl.h
_EXIT_WALL_S: Final = 0.2  # allowed from the end of stdin to the end of the process
_TERMINATE_WALL_S: Final = 0.05
_KILL_WALL_S: Final = 1.0  # for the kernel to release the memory of a killed process
_SERVICE_EXIT_WALL_S: Final = 0.1  # allowed for a service to return after ``stop`` is set
_STDERR_BYTES: Final = 2000
_STACK_BYTES: Final = 1 << 16
_STACK_WALL_S: Final = 0.5  # for a process to write its stack, however busy the computer is
_OOM_KILLS: Final = Path("/proc/vmstat")
_running: WeakValueDictionary[int, ChildProcess] = WeakValueDictionary()


Message = dict[str, Any]
"""One line of JSON, an object."""
_RAISED: Final = "raised"
"""Key of the last message of a child: the device and what has ended its service."""
_FATAL: Final = "Fatal Python error"


def child_of(pid: int) -> ChildProcess | None:
    """Return the child of this process with the number ``pid``, None if it is none."""
    return _running.get(pid)


def _oom_kills() -> int:
    """Return how many processes this computer has ended since its start because it had no memory left."""
    with contextlib.suppress(OSError, ValueError):
        return next(int(n) for name, n in map(str.split, _OOM_KILLS.read_text().splitlines()) if name == "oom_kill")
    return 0


class ChildProcess:
    """A child process that runs ``python -m module``; ``name`` is its name in errors and in the list of processes.

    server: forks the child instead, which calls ``main`` of the module.

    The constructor starts the child and returns; start several, then ``wait_ready`` for each. ``pass_fds`` are open in
    the child under the same numbers. new_session: keep the terminal's Ctrl-C away from the child. The kernel takes the
    *thread* that starts a child for its parent: start it from one that lives as long as the bench. Raises LinkLost if
    the process cannot be started.
    """

    def __init__(
        self,
        name: str,
        module: str,
        configuration: Mapping[str, Any],
        pass_fds: Sequence[int] = (),
        new_session: bool = False,
        server: ForkServer | None = None,
    ) -> None:
        self.name = name
        self._ready: Message | None = None
        self._stderr = unnamed_file()  # lives as long as the child
        self._process: subprocess.Popen[bytes] | ForkedProcess
        try:
            if server is not None:
                self._process = server.start(module, name, self._stderr.fileno(), pass_fds)
            else:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", module, name],
                    bufsize=0,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=self._stderr,
                    pass_fds=pass_fds,
                    start_new_session=new_session,
                )
        except OSError as cause:
            self._stderr.close()
            raise LinkLost(name, f"cannot be started: {cause}") from cause
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._stdin, self._stdout = self._process.stdin, self._process.stdout
        self._lines = _LineReader(self._stdout.fileno())
        self._oom_kills, self._end_text, self._logged = _oom_kills(), "", 0
        _running[self.pid] = self
        self.send(configuration)

    @property
    def pid(self) -> int:
        return self._process.pid

    def wait_ready(self, timeout_s: float) -> Message:
        """Return the child's ready message, which it sends within ``timeout_s`` of wall time.

        Raises LinkLost if the child has ended, DeviceError for what has ended its service, LinkTimeout if it sends
        nothing, ProtocolError if the line is no JSON object.
        """
        if self._ready is None:
            self._ready = self._receive(timeout_s, "was not ready", "before it was ready")
        return self._ready

    def receive(self, timeout_s: float) -> Message:
        """Return the child's next message. Raises as ``wait_ready`` does."""
        return self._receive(timeout_s, "sent nothing", "without a result")

    def _receive(self, timeout_s: float, if_silent: str, if_ended: str) -> Message:
        if self._stdout.closed:
            self.wait_end(_EXIT_WALL_S)
            raise LinkLost(self.name, f"{self.exit_status() or 'is closed'} {if_ended}")
        try:
            line = self._lines.read(timeout_s)
        except TimeoutError:
            where = place_in(self.stack())
            stands = f": {where}" if where else self.last_stderr()
            raise LinkTimeout(self.name, f"{if_silent} within {timeout_s:g} s{stands}") from None
        if not line.endswith(b"\n"):
            self.wait_end(_EXIT_WALL_S)
            how = self.exit_status() or "closed its output"
            where = place_in(self._crash())
            raise LinkLost(self.name, f"{how} {if_ended}{f', {where}' if where else self.last_stderr()}")
        try:
            message = json.loads(line)
        except ValueError:
            message = None
        if not isinstance(message, dict):
            raise ProtocolError(self.name, f"sent {line!r}, expected a JSON object{self.last_stderr()}")
        if (raised := message.get(_RAISED)) is not None:
            self.log_traceback()
            raise PlugInError(*raised)
        return message

    def send(self, message: Mapping[str, Any]) -> None:
        """Send one message; if the child has ended, the next ``receive`` reports it."""
        with contextlib.suppress(BrokenPipeError):
            rest = memoryview(json.dumps(message).encode() + b"\n")
            while rest:
                rest = rest[os.write(self._stdin.fileno(), rest) :]

    def signal(self, number: int) -> None:
        """Send the child a signal; without effect once it has ended."""
        self._process.send_signal(number)

    def exit_status(self) -> str:
        """Return how the child ended, "" while it runs; never waits."""
        code = self._process.poll()
        if code is None:
            return ""
        if code >= 0:
            return f"ended with exit code {code}"
        no_memory = code == -signal.SIGKILL and _oom_kills() > self._oom_kills
        return f"was ended by {signal.Signals(-code).name}" + (": the computer had no memory left" if no_memory else "")

    def end_text(self) -> str:
        """Return how the child ended and why, as one line: what it raised, or where it was; "" while it runs."""
        if not self._end_text and (status := self.exit_status()):
            raised, where = self._raised(), place_in(self._crash())
            self._end_text = f"{status}{f': {raised}' if raised else f', {where}' if where else ''}"
        return self._end_text

    def _raised(self) -> str:
        """Return what has ended the service of a child that has ended, "" if it sent nothing of it."""
        if self._stdout.closed:
            return ""
        with contextlib.suppress(TimeoutError, ValueError):
            while (line := self._lines.read(0.0)).endswith(b"\n"):
                if raised := json.loads(line).get(_RAISED):
                    device, what = raised
                    return str(what) if device == self.name else f"{device}: {what}"
        return ""

    def _crash(self) -> Stack:
        """Return the stack at a fatal signal, innermost first; [] without one."""
        text = self._stderr_text(0)
        return Stack(text[text.rindex(_FATAL) :], current=True) if _FATAL in text else Stack()

    def stack(self) -> Stack:
        """Return where the threads of the child are, innermost first; [] if it does not answer."""
        if self._stderr.closed or self.exit_status():
            return Stack()
        start, size = os.fstat(self._stderr.fileno()).st_size, -1
        self.signal(STACK_SIGNAL)
        deadline_s = time.monotonic() + _STACK_WALL_S
        while time.monotonic() < deadline_s:
            time.sleep(0.01)
            before, size = size, os.fstat(self._stderr.fileno()).st_size
            if size == before > start:
                break
        return Stack(self._stderr_text(start))

    def log_traceback(self) -> None:
        """Write to the log the traceback that the child has written to its stderr since the last call."""
        text = self._stderr_text(self._logged)
        self._logged += len(text.encode())
        if "Traceback" in text or _FATAL in text:
            log.error("%s:\n%s", self.name, text.strip())

    def _stderr_text(self, start: int) -> str:
        if self._stderr.closed:
            return ""
        start = max(0, start, os.fstat(self._stderr.fileno()).st_size - _STACK_BYTES)
        return os.pread(self._stderr.fileno(), _STACK_BYTES, start).decode(errors="replace")

    def wait_end(self, timeout_s: float) -> bool:
        """Wait for the child to end, ``timeout_s`` of wall time at most; return whether it has."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def ask_to_end(self) -> None:
        """Close the child's stdin and return at once. To end several, ask all before closing each."""
        self._stdin.close()

    def kill(self) -> None:
        """End the child by SIGKILL, like a loss of power; ``close`` then only cleans up."""
        self._process.kill()

    def close(self, exit_wall_s: float = _EXIT_WALL_S) -> None:
        """End the child: close its stdin, wait ``exit_wall_s``, then send SIGTERM and at last SIGKILL. Idempotent."""
        self.ask_to_end()
        if not self.wait_end(exit_wall_s):
            self._process.terminate()
            if not self.wait_end(_TERMINATE_WALL_S):
                self._process.kill()
                self.wait_end(_KILL_WALL_S)
        self._stdout.close()
        self._stderr.close()

    def last_stderr(self) -> str:
        """Return a colon and the last lines of the child's stderr, or ""."""
        if self._stderr.closed:
            return ""
        # pread: the child continues to write at the file position that both share
        text = self._stderr_text(os.fstat(self._stderr.fileno()).st_size - _STDERR_BYTES).strip()
        return f":\n{text}" if text else ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Parent:
    """The child's connection to its parent. Make it first in ``main``: it reads the configuration.

    when_orphaned: signal that the kernel sends this process when its parent dies; None: the child outlives its parent.
    on_interrupt: handler of SIGINT, which a terminal sends to parent and children; by default it is ignored, because
    the parent stops the bench before it ends its children. What the child prints goes to its stderr.
    """

    def __init__(
        self, when_orphaned: signal.Signals | None = signal.SIGKILL, on_interrupt: Any = signal.SIG_IGN
    ) -> None:
        signal.signal(signal.SIGINT, on_interrupt)
        for number in (signal.SIGHUP, signal.SIGQUIT):  # of a terminal that closes: the parent ends its children
            signal.signal(number, signal.SIG_IGN)
        if when_orphaned is not None:
            die_with_parent(when_orphaned)
        faulthandler.enable()
        faulthandler.register(STACK_SIGNAL)
        self._up = os.dup(sys.stdout.fileno())
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        cast(TextIOWrapper, sys.stdout).reconfigure(line_buffering=True)  # for the report of a child that is killed
        self._lines = _LineReader(sys.stdin.fileno())
        try:
            self.configuration = self.receive(None)
        except EOFError:
            raise SystemExit("the parent has ended") from None

    def send(self, **message: Any) -> None:
        """Send one message. Raises BrokenPipeError if the parent has ended."""
        rest = memoryview(json.dumps(message).encode() + b"\n")
        while rest:
            rest = rest[os.write(self._up, rest) :]

    def receive(self, timeout_s: float | None) -> Message:
        """Return the next message. Raises TimeoutError, and EOFError when the parent asks this process to end."""
        line = self._lines.read(timeout_s)
        if not line.endswith(b"\n"):
            raise EOFError
        message: Message = json.loads(line)
        return message

    def wait_end(self, timeout_s: float) -> bool:
        """Wait ``timeout_s``; return whether the parent has asked this process to end. For a child without requests."""
        try:
            self.receive(timeout_s)
        except TimeoutError:
            return False
        except EOFError:
            return True
        return False


class _LineReader:
    """Lines that arrive at a descriptor, with time limits."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._received = b""

    def read(self, timeout_s: float | None) -> bytes:
        """Return the next line; at the end of the file what has come of it. Raises TimeoutError."""
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while b"\n" not in self._received:
            left_s = None if deadline_s is None else max(0.0, deadline_s - time.monotonic())
            if not select.select([self._descriptor], [], [], left_s)[0]:
                raise TimeoutError
            part = os.read(self._descriptor, 1 << 16)
            if not part:
                return self._received
            self._received += part
        line, _, self._received = self._received.partition(b"\n")
        return line + b"\n"


def die_with_parent(number: int = signal.SIGKILL) -> None:
    """Let the kernel send this process the signal ``number`` when its parent dies."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


class Service(Protocol):
    """A server that a child process runs until its parent asks it to end."""

    def start(self) -> dict[str, str]:
        """Open what it serves; return name -> address."""

    def run(self, stop: threading.Event) -> None:
        """Serve until ``stop`` is set."""

    def close(self) -> None:
        """Release everything."""


def serve(make: Callable[[Message], Service], when_orphaned: signal.Signals = signal.SIGKILL) -> None:
    """Run, as the child, the service that ``make`` returns for the configuration, until stdin ends or SIGTERM.

    The ready message is ``{"addresses": {name: address}}``. when_orphaned: SIGTERM instead of SIGKILL lets the child
    stop what it drives. An error of the service, or of a thread that it has not caught, ends the process: the parent
    receives what was raised, and the traceback goes to stderr.
    """
    parent = Parent(when_orphaned)
    service: Service | None = None
    ended, end = os.pipe()
    signal.signal(signal.SIGTERM, lambda *_: os.write(end, b"t"))
    failures: list[BaseException] = []

    def fail(error: BaseException) -> None:
        failures.append(error)
        os.write(end, b"r")

    def fail_thread(given: threading.ExceptHookArgs) -> None:
        error = given.exc_value or given.exc_type()
        if not getattr(service, "report_thread", lambda _: False)(error):
            fail(error)

    def fail_kernel(given: Any) -> None:
        if (error := kernel_error(given)) is None:
            sys.__unraisablehook__(given)
        elif not failures:
            fail(error)

    threading.excepthook, sys.unraisablehook = fail_thread, fail_kernel
    exits = without_exit()
    exits.__enter__()  # as long as the process lives
    try:
        service = make(parent.configuration)
        addresses = service.start()
        # what was imported stays: a collection that walks through all of it lasts longer than a drive's watchdog
        gc.collect()
        gc.freeze()
        parent.send(addresses=addresses)
        _run_until(service, ended, end, fail)
        if failures:
            raise failures[0]
    except (Exception, SystemExit) as error:
        if host_limit(error):
            raise
        with contextlib.suppress(BrokenPipeError):
            parent.send(raised=_named(sys.argv[1], error))
        raise SystemExit(1) from error
    finally:
        if service is not None:
            service.close()


def _named(process: str, error: BaseException) -> list[str]:
    """Return the device of an error, or the process, and what was raised; its traceback goes to stderr."""
    if isinstance(error, HilError) and not isinstance(error, DeviceError):
        return [process, one_line(str(error))]
    named = plug_in_error(process, error)
    return [named.device, named.what]


def _run_until(service: Service, ended: int, end: int, fail: Callable[[BaseException], None]) -> None:
    """Run the service in a thread until a byte comes out of ``ended`` or stdin ends; ``fail`` gets what it raises."""
    stop = threading.Event()

    def run() -> None:
        try:
            service.run(stop)
            os.write(end, b"r")
        except BaseException as error:
            fail(error)

    worker = threading.Thread(target=run, name="service", daemon=True)
    worker.start()
    stdin = sys.stdin.fileno()
    while True:
        ready, _, _ = select.select([ended, stdin], [], [])
        if ended in ready or not os.read(stdin, 4096):
            break
    stop.set()
    worker.join(_SERVICE_EXIT_WALL_S)  # one that hangs on its wire ends with the process
