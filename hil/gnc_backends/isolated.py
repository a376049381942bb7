"""FMU in a process of its own: one that hangs or crashes stops the bench, and nothing else.

Records travel through a socket, a datagram per direction and step. The step is a compiled function that calls the C
library, so that the compiled loop can call it as well.
"""

from __future__ import annotations

import ctypes
import socket
import weakref
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import carray, cfunc, types  # type: ignore[attr-defined]
from numba.extending import intrinsic

from hil.config.scenario import GncConfig
from hil.core.child_process import ChildProcess
from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, GncMode
from hil.core.surroundings import temporary_folder
from hil.errors import BadInput, DeviceError
from hil.fmi.step import offset_of
from hil.gnc_backends.fmu import FmuLibrary
from hil.gnc_backends.shared_library import Instance

_MODULE: Final = "hil.processes.isolated_fmu"
_START_S: Final = 60.0
_OPEN_S: Final = 10.0
_TEXT: Final = 64
_NO_SIGNAL: Final = 0x4000  # MSG_NOSIGNAL
_POLLIN: Final = 1
_RUNNING: Final = GncMode.RUNNING.value
_TEXT_OFFSET: Final = offset_of(GNC_OUTPUT, "text")
_INPUT_BYTES: Final = GNC_INPUT.itemsize
_OUTPUT_BYTES: Final = GNC_OUTPUT.itemsize
_ENDED, _SILENT = 102, 103  # returned by the step

_LINK = np.dtype(
    [
        ("descriptor", "i4"),  # begins a pollfd
        ("events", "i2"),
        ("revents", "i2"),
        ("send", "i8"),
        ("poll", "i8"),
        ("receive", "i8"),
        ("timeout_ms", "i8"),
        ("failed", "i8"),
        ("ended_text", "u1", _TEXT),
        ("silent_text", "u1", _TEXT),
    ],
    align=True,
)
_HEAD = np.dtype([("cycle", "i8"), ("t_s", "f8"), ("mode", "i4"), ("orders", "i4")], align=True)


_machine_code: Any = intrinsic  # under this name: these functions are compiled at each start, outside the cache


@_machine_code
def _call_libc(_typing, function, descriptor, pointer, size, flags):
    """Call ``send`` or ``recv``."""

    def generate(_context, builder, _signature, arguments):
        word, whole, pointer = ir.IntType(64), ir.IntType(32), ir.IntType(8).as_pointer()
        kind = ir.FunctionType(word, [whole, pointer, word, whole])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return types.int64(types.int64, types.int32, types.voidptr, types.int64, types.int32), generate


@_machine_code
def _poll(_typing, function, pointer, timeout_ms):
    """Call ``poll`` for one pollfd."""

    def generate(_context, builder, _signature, arguments):
        word, whole, pointer = ir.IntType(64), ir.IntType(32), ir.IntType(8).as_pointer()
        kind = ir.FunctionType(whole, [pointer, word, whole])
        callee = builder.inttoptr(arguments[0], kind.as_pointer())
        return builder.call(callee, [arguments[1], word(1), builder.trunc(arguments[2], whole)])

    return types.int32(types.int64, types.voidptr, types.int64), generate


def _step(instance, gnc_input, gnc_output):
    link = carray(instance, (1,), _LINK)[0]
    if carray(gnc_input, (1,), _HEAD)[0].mode != _RUNNING:
        return 0
    output = carray(gnc_output, (_OUTPUT_BYTES,), np.uint8)
    sent = _call_libc(link.send, link.descriptor, gnc_input, _INPUT_BYTES, np.int32(_NO_SIGNAL))
    ready = np.int32(1)
    received = 0
    if sent == _INPUT_BYTES:
        ready = _poll(link.poll, instance, link.timeout_ms)
        if ready > 0:
            received = _call_libc(link.receive, link.descriptor, gnc_output, _OUTPUT_BYTES, np.int32(0))
    if ready > 0 and received > 4:
        return 0
    if ready > 0 and received == 4:  # a failed step: its code, and its text in the next datagram
        code = carray(gnc_output, (1,), np.int32)[0]
        text = carray(gnc_output, (_OUTPUT_BYTES,), np.uint8)
        _call_libc(link.receive, link.descriptor, gnc_output, _OUTPUT_BYTES, np.int32(0))
        for i in range(_TEXT):
            output[_TEXT_OFFSET + i] = text[i]
        return code
    link.failed = 1
    for i in range(_TEXT):
        output[_TEXT_OFFSET + i] = link.silent_text[i] if ready == 0 else link.ended_text[i]
    return _SILENT if ready == 0 else _ENDED


@cache
def _step_function() -> Any:
    return cfunc(types.int32(types.voidptr, types.voidptr, types.voidptr))(_step)


class IsolatedFmu:
    """The FMU of ``gnc`` in a process of its own. Raises BadInput if it cannot be used. source: for messages."""

    def __init__(self, gnc: GncConfig, source: str = "--set") -> None:
        assert gnc.fmu is not None
        self.path = Path(gnc.fmu).absolute()
        self.name = self.path.name
        self._gnc, self._source = gnc, source
        self._child: _Child | None = None
        self._opened = False
        self._start()
        self.step_address: int = _step_function().address

    def open(self, setup: np.record) -> Instance:
        """Return a GNC set up with ``setup`` (GNC_SETUP). Raises BadInput if the FMU does not allow it."""
        if self._child is None or (self._opened and self._child.only_once):
            self._start()
        child = self._child
        assert child is not None
        self._opened = True
        self._check(child.ask({"open": np.asarray(setup).tobytes().hex()}, _OPEN_S))
        return Instance(lambda _: self._close(child), child.link.ctypes.data)

    def _close(self, child: _Child) -> None:
        if child.link["failed"][0]:
            child.close()
            self._child = None
        else:
            child.ask({"close": True}, _OPEN_S)

    def _start(self) -> None:
        if self._child is not None:
            self._child.close()
        self._opened = False
        self._child = _Child(f"fmu {self.name}", self._gnc, self._source)
        self._check(self._child.ready)
        weakref.finalize(self, self._child.close)

    def _check(self, answer: dict[str, Any]) -> None:
        if problem := answer.get("problem"):
            raise BadInput.single(self._source, "gnc.fmu", problem)


def open_fmu(gnc: GncConfig, source: str = "--set") -> FmuLibrary | IsolatedFmu:
    """Return the FMU of ``gnc``, in a process of its own if it asks for one. source: for messages. Raises BadInput."""
    return IsolatedFmu(gnc, source) if gnc.fmu_process else FmuLibrary(gnc, source)


class _Child:
    """The process, its socket and the record that the step reads."""

    def __init__(self, name: str, gnc: GncConfig, source: str) -> None:
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._folder = temporary_folder("fmu", executable=True)
            configuration = {
                "gnc": gnc.model_dump(mode="json"),
                "source": source,
                "descriptor": theirs.fileno(),
                "folder": self._folder.name,
            }
            self._process = ChildProcess(name, _MODULE, configuration, (theirs.fileno(),))
        libc = ctypes.CDLL(None)
        send, poll, receive = (ctypes.cast(f, ctypes.c_void_p).value for f in (libc.send, libc.poll, libc.recv))
        self.link = np.zeros(1, _LINK)
        self.link["descriptor"], self.link["events"] = self._ours.fileno(), _POLLIN
        self.link["send"], self.link["poll"], self.link["receive"] = send, poll, receive
        self.link["timeout_ms"] = max(1, round(1e3 * gnc.fmu_timeout_s))
        ended, silent = "its process has ended", f"no answer within {gnc.fmu_timeout_s:g} s"
        for field, text in (("ended_text", ended), ("silent_text", silent)):
            self.link[field][0, : len(text)] = np.frombuffer(text.encode(), np.uint8)
        self.ready = self._answer(_START_S, "starts")
        self.only_once = bool(self.ready.get("only_once"))

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
