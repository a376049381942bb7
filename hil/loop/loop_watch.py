"""Watch over code of plug-ins in the loop's process: errors that nothing catches, and a step that does not return."""

from __future__ import annotations

import ctypes
import logging
import signal
import sys
import threading
import time
from collections.abc import Callable
from itertools import takewhile
from types import FrameType
from typing import Any, Final, Self

from hil.core.plug_ins import (
    is_debugged,
    is_users,
    kernel_error,
    place_in,
    plug_in_error,
    stack_of_thread,
    without_exit,
)
from hil.errors import BenchError, DeviceError

log = logging.getLogger("hil")
_INTERRUPT: Final = signal.SIGRTMIN + 5
_PERIOD_S: Final = 0.25
_RUNNER: Final = "runner.py"


class StepTimeout(BenchError):
    """Code of a plug-in has not returned in time; raised where it stands."""

    def __init__(self, text: str = "has not returned in time") -> None:
        super().__init__(text)


class LoopWatch:
    """Watch over the process of the loop, which enters it in its own thread.

    progress: returns another value after each cycle or tick. timeout_s: returns the time, s by the wall clock, after
    which code of a plug-in that the loop calls is interrupted; a debugger in it prevents that. Errors of threads and of
    sensors' kernels, which no caller catches, are raised by ``check``.
    """

    def __init__(self, progress: Callable[[], object], timeout_s: Callable[[], float]) -> None:
        self._progress, self._timeout_s = progress, timeout_s
        self._errors: list[DeviceError] = []
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        self._ident = threading.get_ident()
        self._is_main = threading.current_thread() is threading.main_thread()
        self._hooks: tuple[Any, Any] = threading.excepthook, sys.unraisablehook
        threading.excepthook, sys.unraisablehook = self._on_thread_error, self._on_unraisable
        if self._is_main:
            signal.signal(_INTERRUPT, self._interrupted)
        self._exit = without_exit()
        self._exit.__enter__()
        self._ended.clear()
        threading.Thread(target=self._watch, name="loop watch", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._exit.__exit__(None, None, None)
        threading.excepthook, sys.unraisablehook = self._hooks
        if self._is_main:
            signal.signal(_INTERRUPT, signal.SIG_IGN)  # one that comes late

    def check(self) -> None:
        """Raise PlugInError for what a thread or a kernel has raised since the watch began."""
        if self._errors:
            raise self._errors[0]

    def _on_thread_error(self, given: threading.ExceptHookArgs) -> None:
        error = given.exc_value or given.exc_type()
        self._errors.append(plug_in_error(f"thread {given.thread.name if given.thread else 'unknown'}", error))

    def _on_unraisable(self, given: Any) -> None:
        if (error := kernel_error(given)) is None:
            self._hooks[1](given)
        elif not self._errors:  # a kernel may be called once per cycle
            self._errors.append(plug_in_error("sensor", error))

    def _watch(self) -> None:
        progress, moved_s = self._progress(), time.monotonic()
        while not self._ended.wait(_PERIOD_S):
            now_s, before, progress = time.monotonic(), progress, self._progress()
            if progress != before:
                moved_s = now_s
            elif now_s - moved_s > self._timeout_s() and (where := self._place()):
                moved_s = now_s
                self._interrupt(f"has not returned within {self._timeout_s():g} s: it stands {where}")

    def _place(self) -> str:
        """Return where code of a plug-in stands that the loop has called; "" for none, and with a debugger in it."""
        stack = stack_of_thread(self._ident)
        if is_debugged(file for file, _, _ in stack):
            return ""
        return place_in([list(takewhile(lambda frame: is_users(frame[0]) or not frame[0].endswith(_RUNNER), stack))])

    def _interrupt(self, text: str) -> None:
        log.error("loop: %s", text)
        if self._is_main:
            signal.pthread_kill(self._ident, _INTERRUPT)
        else:
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._ident), ctypes.py_object(StepTimeout))

    def _interrupted(self, _number: int, _frame: FrameType | None) -> None:
        raise StepTimeout(f"has not returned within {self._timeout_s():g} s")
