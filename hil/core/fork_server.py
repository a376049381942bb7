"""Fork server: a process that has imported what children need, and forks them in a tenth of the time of a start.

It has one thread. Each child has the descriptors that its parent gives and nothing else of it. The server ends with the
process that uses it, and its children with the server.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import errno
import fcntl
import gc
import importlib
import json
import os
import resource
import select
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final, NoReturn

from hil.core.realtime import fair_share, take_fair_share
from hil.core.surroundings import host_limit, leave_process

_PR_SET_NAME: Final = 15  # linux/prctl.h
_REQUEST_BYTES: Final = 1 << 16
_DESCRIPTORS_MAX: Final = 64
_LOST: Final = -int(signal.SIGKILL)  # a child whose server has ended
_READY_WALL_S: Final = 120.0  # its first start may compile what it prepares
_PARENT_WALL_S: Final = 0.2  # between two looks whether the parent lives


class ForkServer:
    """Server that has imported ``modules``; starts with its first child. Raises OSError if it cannot.

    A function ``prepare`` of a module is called once, before the first child.
    """

    def __init__(self, *modules: str) -> None:
        self._modules = modules
        self._lock = threading.Lock()
        self._requests: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._environment: dict[str, str] = {}

    def start(self, module: str, name: str, stderr: int, pass_fds: Sequence[int] = ()) -> ForkedProcess:
        """Return a new process that calls ``main`` of ``module``, with ``pass_fds`` under the same numbers."""
        (stdin, write), (read, stdout), (ended, end) = os.pipe(), os.pipe(), os.pipe()
        try:
            given = [end, stdin, stdout, stderr, *pass_fds]
            with self._lock:
                pid = self._ask({"module": module, "name": name, "numbers": [0, 1, 2, *pass_fds]}, given)
        except BaseException:
            for descriptor in (write, read, ended):
                os.close(descriptor)
            raise
        finally:
            for descriptor in (stdin, stdout, end):
                os.close(descriptor)
        return ForkedProcess(pid, ended, os.fdopen(write, "wb", 0), os.fdopen(read, "rb", 0))

    def _ask(self, request: dict[str, Any], descriptors: list[int]) -> int:
        for _ in range(2):
            if self._requests is None or self._owner != os.getpid():
                self._requests, self._owner = self._started(), os.getpid()
            present = dict.fromkeys(self._environment) | os.environ
            changed = dict(present.items() - self._environment.items())
            message = json.dumps(request | {"environment": changed, "folder": str(Path.cwd()), "share": fair_share()})
            try:
                socket.send_fds(self._requests, [message.encode()], descriptors)
                if answer := self._requests.recv(_REQUEST_BYTES):
                    return int(answer)
            except ConnectionError:
                pass
            except BaseException:  # an answer that comes later would be taken for that of the next request
                self.close()
                raise
            self.close()  # it has ended: with a new one
        raise OSError("the fork server has ended")

    def close(self) -> None:
        """End the server and its children. Idempotent; the next child has a new server."""
        requests, process, self._requests, self._process = self._requests, self._process, None, None
        if requests is not None and process is not None and self._owner == os.getpid():
            requests.close()
            process.kill()
            process.wait()

    def _started(self) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.settimeout(_READY_WALL_S)
        atexit.register(self.close)
        self._environment = dict(os.environ)
        with theirs:
            command = [sys.executable, "-m", __name__, str(theirs.fileno()), *self._modules]
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()], start_new_session=True
            )
        return ours


class ForkedProcess:
    """A child of a fork server, with the methods of ``subprocess.Popen`` that ``ChildProcess`` uses."""

    def __init__(self, pid: int, ended: int, stdin: BinaryIO, stdout: BinaryIO) -> None:
        self.pid, self.stdin, self.stdout = pid, stdin, stdout
        self._ended: int | None = ended
        self._code: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, minus the number of the signal that ended the process; None while it runs."""
        return self._wait(0.0)

    def wait(self, timeout: float) -> int:
        """Return the exit code. Raises subprocess.TimeoutExpired."""
        code = self._wait(timeout)
        if code is None:
            raise subprocess.TimeoutExpired("forked process", timeout)
        return code

    def _wait(self, timeout_s: float) -> int | None:
        if self._ended is not None and select.select([self._ended], [], [], max(0.0, timeout_s))[0]:
            text = os.read(self._ended, 64)
            self._code = int(text) if text else _LOST
            os.close(self._ended)
            self._ended = None
        return self._code

    def send_signal(self, number: int) -> None:
        """Send a signal; without effect once the process has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


def _serve(requests: socket.socket, modules: Sequence[str]) -> None:
    """Fork a child per request until the parent has ended."""
    parent = os.getppid()
    for module in modules:
        prepare: Callable[[], None] = getattr(importlib.import_module(module), "prepare", lambda: None)
        prepare()
    gc.collect()
    gc.freeze()
    wake, woken = os.pipe()
    os.set_blocking(woken, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(woken)
    ends: dict[int, int] = {}
    while os.getppid() == parent:
        ready, _, _ = select.select([requests.fileno(), wake], [], [], _PARENT_WALL_S)
        if wake in ready:
            os.read(wake, 4096)
            _report(ends)
        if requests.fileno() not in ready:
            continue
        data, descriptors, _, _ = socket.recv_fds(requests, _REQUEST_BYTES, _DESCRIPTORS_MAX)
        if not data:
            return
        end, *given = descriptors
        pid = os.fork()
        if pid == 0:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            for descriptor in (requests.detach(), wake, woken, end, *ends.values()):
                os.close(descriptor)
            _run(json.loads(data), given)
        ends[pid] = end
        for descriptor in given:
            os.close(descriptor)
        requests.send(str(pid).encode())


def _report(ends: dict[int, int]) -> None:
    """Write the exit codes of the children that have ended to their parent."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            end = ends.pop(ended[0])
            with contextlib.suppress(BrokenPipeError):
                os.write(end, str(os.waitstatus_to_exitcode(ended[1])).encode())
            os.close(end)


def _run(request: dict[str, Any], given: Sequence[int]) -> NoReturn:
    """Call ``main`` of the child's module with the descriptors ``given`` under their numbers; end the process."""
    code = 1
    try:
        free = max(0, *given, *request["numbers"]) + 1  # above all of them
        if free + len(given) > resource.getrlimit(resource.RLIMIT_NOFILE)[0]:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        high = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, free) for descriptor in given]
        for descriptor in given:
            os.close(descriptor)
        for descriptor, number in zip(high, request["numbers"], strict=True):
            os.dup2(descriptor, number)
            os.close(descriptor)
        ctypes.CDLL(None).prctl(_PR_SET_NAME, request["name"].encode())
        _adopt(request["environment"], request["folder"])
        take_fair_share(*request["share"])
        sys.argv = [request["module"], request["name"]]
        importlib.import_module(request["module"]).main()
        code = 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else int(error.code is not None)
    except BaseException as error:
        if limit := host_limit(error):
            print(limit, file=sys.stderr)  # noqa: T201
        else:
            traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        leave_process(code)


def _adopt(environment: dict[str, str | None], folder: str) -> None:
    """Change to the parent's present environment and working directory."""
    for name, value in environment.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
    os.chdir(folder)
    places = os.environ.get("PYTHONPATH", "").split(os.pathsep) if "PYTHONPATH" in environment else []
    sys.path[:0] = [path for path in places if path and path not in sys.path]


if __name__ == "__main__":
    _serve(socket.socket(fileno=int(sys.argv[1])), sys.argv[2:])
