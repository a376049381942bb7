"""FMU in a process of its own: one that hangs or crashes stops the bench, and nothing else.

Records travel through a socket, a datagram per direction and step.
"""

from __future__ import annotations

import ctypes
import socket
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.config.scenario import GncConfig
from hil.core.child_process import ChildProcess
from hil.core.fields import offset_of
from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, TEXT_BYTES, GncMode
from hil.core.own_code import require_trust
from hil.core.settings import Setting
from hil.core.surroundings import temporary_folder
from hil.errors import BadInput, DeviceError
from hil.gnc_backends.backend import C_STEP, NO_SETTINGS, WHOLE, Backend, BackendInstance, address_of
from hil.parts.fmi.backend import FmuBackend
from hil.parts.fmi.binary import LOG_BYTES

_MODULE: Final = "hil.parts.fmi.process"
_START_S: Final = 60.0
_OPEN_S: Final = 10.0
_MODE: Final = offset_of(GNC_INPUT, "mode")
_TEXT: Final = offset_of(GNC_OUTPUT, "text")
_CODE_BYTES: Final = 4  # datagram with the code of a failed step, followed by one with its text
_INTERRUPTED, _ENDED, _SILENT = 101, 102, 103  # returned by the step


class IsolatedFmu:
    """The FMU of ``gnc`` in a process of its own, a backend of a whole GNC. Raises BadInput, made by ``refuse``."""

    settings: tuple[Setting, ...] = ()

    def __init__(self, gnc: GncConfig, refuse: Callable[[str], BadInput]) -> None:
        assert gnc.fmu is not None
        require_trust(gnc.fmu, refuse)
        self.name = Path(gnc.fmu).name
        self._gnc, self._refuse = gnc, refuse
        self._child: _Child | None = None
        self._opened = False
        self.receives_measurements = self._start().receives_measurements

    def check(self, setup: np.record) -> None:
        """Open and close an instance. Raises BadInput if the FMU does not allow it."""
        self.open(setup).close()

    def open(self, setup: np.record, values: np.ndarray = NO_SETTINGS) -> BackendInstance:
        """Return an instance. Raises BadInput if the FMU does not allow it."""
        child = self._child
        if child is None or (self._opened and child.only_once):
            child = self._start()
        self._opened = True
        self._check(child.ask({"open": np.asarray(setup).tobytes().hex()}, _OPEN_S))
        return _IsolatedInstance(child, self._close)

    def _close(self, child: _Child) -> None:
        if child.failed:
            child.close()
            self._child = None
        else:
            child.ask({"close": True}, _OPEN_S)

    def _start(self) -> _Child:
        if self._child is not None:
            self._child.close()
        self._opened = False
        self._child = _Child(f"fmu {self.name}", self._gnc)
        self._check(self._child.ready)
        weakref.finalize(self, self._child.close)
        return self._child

    def _check(self, answer: dict[str, Any]) -> None:
        if problem := answer.get("problem"):
            raise self._refuse(problem)


class _IsolatedInstance(BackendInstance):
    def __init__(self, child: _Child, close: Callable[[_Child], None]) -> None:
        self._child = child
        self._callback = C_STEP(self._step)
        super().__init__(address_of(self._callback), 1, free=lambda _: close(child))

    @property
    def message(self) -> bytes:
        """Last message of the FMU."""
        return self._child.message

    def _step(self, _instance: int, given: int, output: int) -> int:
        try:
            return self._child.step(given, output)
        except BaseException as error:
            self.error, self._child.failed = error, True
            return _INTERRUPTED


def _write_text(output: int, text: bytes) -> None:
    """Write ``text`` to the GNC_OUTPUT at the address ``output``."""
    ctypes.memmove(output + _TEXT, text[: TEXT_BYTES - 1].ljust(TEXT_BYTES, b"\0"), TEXT_BYTES)


def open_fmu(gnc: GncConfig, refuse: Callable[[str], BadInput]) -> Backend:
    """Return the FMU of ``gnc``, in a process of its own if it asks for one. Raises BadInput, made by ``refuse``."""
    assert gnc.fmu is not None
    return IsolatedFmu(gnc, refuse) if gnc.fmu_process else FmuBackend(gnc.fmu, WHOLE, refuse, gnc)


class _Child:
    """The process and its socket."""

    def __init__(self, name: str, gnc: GncConfig) -> None:
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._folder = temporary_folder("fmu", executable=True)
            configuration = {
                "gnc": gnc.model_dump(mode="json"),
                "descriptor": theirs.fileno(),
                "folder": self._folder.name,
            }
            self._process = ChildProcess(name, _MODULE, configuration, (theirs.fileno(),))
        self._timeout_s = gnc.fmu_timeout_s
        self._ours.settimeout(self._timeout_s)
        self.message = b""
        """Last message of the FMU."""
        self.failed = False
        """Whether a step had no answer."""
        self.ready = self._answer(_START_S, "starts")
        self.only_once = bool(self.ready.get("only_once"))
        self.receives_measurements = bool(self.ready.get("receives_measurements"))

    def step(self, given: int, output: int) -> int:
        """Send the input at ``given``, and write the answer to ``output``; return 0, or the code of a failed step."""
        if ctypes.c_int32.from_address(given + _MODE).value != GncMode.RUNNING:
            return 0
        out = np.zeros(GNC_OUTPUT.itemsize, np.uint8)
        try:
            self._ours.send(ctypes.string_at(given, GNC_INPUT.itemsize))
            n = self._ours.recv_into(out.data)
            if n == _CODE_BYTES:
                self.message = self._ours.recv(LOG_BYTES)
                _write_text(output, self.message)
                return int(out[:_CODE_BYTES].view(np.int32)[0])
            if n:
                ctypes.memmove(output, out.ctypes.data, GNC_OUTPUT.itemsize)
                return 0
            code, text = _ENDED, "its process has ended"
        except TimeoutError:
            code, text = _SILENT, f"no answer within {self._timeout_s:g} s"
        except OSError:
            code, text = _ENDED, "its process has ended"
        self.failed = True
        _write_text(output, text.encode())
        return code

    def ask(self, request: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        """Return the answer to ``request``; of a process that gives none, the problem."""
        self._process.send(request)
        return self._answer(timeout_s, "is initialised")

    def _answer(self, timeout_s: float, when: str) -> dict[str, Any]:
        try:
            return self._process.receive(timeout_s)
        except DeviceError as error:
            self.close()
            return {"problem": f"{error}, while it {when}".split("\n")[0]}

    def close(self) -> None:
        """End the process; idempotent."""
        self._process.close()
        self._ours.close()
        self._folder.cleanup()
