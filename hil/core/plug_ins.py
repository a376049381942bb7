"""Calls of code that users plug in: drivers, emulators, estimators, backends.

What it raises or wrongly returns becomes a ``PlugInError``, one line with device, class, file and line; the traceback
goes to the log. A process can note the calls under way, so that its parent can name the one in which it has died or
hangs; stacks of other processes, as faulthandler writes them, show its place.
"""

from __future__ import annotations

import logging
import os
import re
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from types import CodeType
from typing import Any, Final, NoReturn, TypeVar

from hil.errors import BenchError, DeviceError, PlugInError, one_line

log = logging.getLogger("hil")
T = TypeVar("T")
_PACKAGES: Final = ("site-packages", "dist-packages")
_HIL: Final = str(Path(__file__).parents[1]) + os.sep
_LIBRARY: Final = os.path.dirname(os.__file__) + os.sep
_COMPILED: Final = "<numba."
_DEPTH: Final = 4  # a group, its parts, their drivers, their links
_DEBUGGERS: Final = ("bdb.py", "pdb.py", "pydevd.py", "debugpy")


class Calls:
    """Calls of plug-ins that are under way in this process. write: makes their text known to others, "" for none."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write, self._lock, self._texts = write, threading.Lock(), dict[int, str]()

    def note(self, text: str) -> None:
        """Note what this thread calls, "" at the end of the call."""
        with self._lock:
            self._texts[threading.get_ident()] = text
            self._write("; ".join(filter(None, self._texts.values())))


_calls: list[Calls] = []


def note_calls(write: Callable[[str], None]) -> None:
    """Let ``write`` receive the calls under way in this process, each as ``DEVICE CLASS.METHOD (FILE, line N)``."""
    _calls[:] = [Calls(write)]


def call(device: str, method: Callable[..., T], *arguments: Any) -> T:
    """Return what ``method`` returns. Raises PlugInError for what it raises other than a BenchError."""
    owner: Any = type(getattr(method, "__self__", None))
    calls = _calls if _calls and is_plug_in(owner) else ()
    for each in calls:
        each.note(f"{device} {method_text(method)}")
    try:
        return method(*arguments)
    except BenchError:
        raise
    except (Exception, SystemExit) as error:
        raise plug_in_error(device, error) from error
    finally:
        for each in calls:
            each.note("")


@contextmanager
def without_exit() -> Iterator[None]:
    """Let ``os._exit`` in this process raise SystemExit: a plug-in must not end the bench without a stop."""
    end, owner = os._exit, os.getpid()

    def leave(status: int) -> NoReturn:
        if os.getpid() != owner:  # of a process that the plug-in has forked
            end(status)
        raise SystemExit(f"os._exit({status})")

    os._exit = leave
    try:
        yield
    finally:
        os._exit = end


def plug_in_error(device: str, error: BaseException) -> DeviceError:
    """Return what code of ``device`` has raised as the device's error; its traceback goes to the log."""
    if isinstance(error, DeviceError):
        return error
    log.error("%s: %s", device, "".join(traceback.format_exception(error)).rstrip())
    return PlugInError(device, raised_text("", error))


def wrong_return(device: str, method: Callable[..., Any], problem: str) -> PlugInError:
    """Return the error of a ``method`` that returned what it may not. problem: what, and what is expected."""
    return PlugInError(device, f"{_name(method)} returned {problem}{begin_of(method)}")


def raised_text(method: str, error: BaseException) -> str:
    """Return what ``method`` has raised, with file and line, as one line. method: "": the innermost of the user's."""
    text, frames = " ".join(str(error).split()), list(traceback.walk_tb(error.__traceback__))
    places = [(frame.f_code, line) for frame, line in frames]
    name, where = method or "it", ""
    if at := [place for place in places if is_users(place[0].co_filename)] or places:
        code, line = at[-1]
        name, where = method or code.co_qualname.replace(".<locals>", ""), f" ({location(code.co_filename, line)})"
    return one_line(f"{name} raised {type(error).__name__}" + (f": {text}" if text else "") + where)


def location(file: str, line: int) -> str:
    """Return a line of a file for a message."""
    return f"{Path(file).name}, line {line}"


def method_text(method: Callable[..., Any]) -> str:
    """Return class and name of a method, with the file and line where it begins if it is Python's."""
    return _name(method) + begin_of(method)


def _name(method: Callable[..., Any]) -> str:
    owner, name = getattr(method, "__self__", None), getattr(method, "__name__", "it")
    return f"{type(owner).__name__}.{name}" if owner is not None else name


def begin_of(method: Callable[..., Any]) -> str:
    """Return where a method begins, as an addition to a message; "" if it is not Python's."""
    code: CodeType | None = getattr(method, "__code__", None)
    return f" ({location(code.co_filename, code.co_firstlineno)})" if code is not None else ""


def kernel_error(given: Any) -> BaseException | None:
    """Return what a kernel called by C has raised; None if what ``sys.unraisablehook`` was given is of others."""
    return given.exc_value if str(given.object).startswith(_COMPILED) else None


@contextmanager
def kernel_errors() -> Iterator[list[BaseException]]:
    """Give the list of what kernels called by C raise within ``with``, instead of printing it."""
    errors, hook = list[BaseException](), sys.unraisablehook

    def note(given: Any) -> None:
        if (error := kernel_error(given)) is None:
            hook(given)
        elif not errors:  # the first of what may be one per cycle
            errors.append(error)

    sys.unraisablehook = note
    try:
        yield errors
    finally:
        sys.unraisablehook = hook


def is_of(device: object, error: BaseException) -> bool:
    """Return whether ``error`` was raised in a method of ``device``, or of an object that it consists of."""
    raising = [frame.f_locals.get("self") for frame, _ in traceback.walk_tb(error.__traceback__)]
    return any(part is each for part in _parts_of(device, _DEPTH) for each in raising if each is not None)


def _parts_of(whole: object, depth: int) -> Iterator[object]:
    yield whole
    inner = whole if isinstance(whole, list | tuple) else getattr(whole, "__dict__", {}).values()
    for part in inner if depth else ():
        yield from _parts_of(part, depth - 1)


def is_plug_in(kind: type) -> bool:
    """Return whether a class is of another package."""
    return kind.__module__.partition(".")[0] not in ("hil", "builtins")


def is_programs(file: str) -> bool:
    """Return whether a file of code is of this program."""
    return os.path.abspath(file).startswith(_HIL)


@cache
def is_users(file: str) -> bool:
    """Return whether a file of code is a user's, or of a package that registers something with this program."""
    path = os.path.abspath(file)
    if file.startswith("<") or is_programs(file):
        return False
    parts = Path(path).parts
    if (folder := next((each for each in _PACKAGES if each in parts), None)) is not None:
        return parts[parts.index(folder) + 1].removesuffix(".py") in _packages_of_plug_ins()
    return not path.startswith((_LIBRARY, os.path.realpath(_LIBRARY) + os.sep))


@cache
def _packages_of_plug_ins() -> frozenset[str]:
    points = (
        point for group in entry_points().groups if group.startswith("hil.") for point in entry_points(group=group)
    )
    return frozenset(point.value.partition(":")[0].partition(".")[0] for point in points) - {"hil"}


def is_debugged(files: Iterable[str]) -> bool:
    """Return whether one of the ``files`` of a stack is a debugger's."""
    return any(name in file for file in files for name in _DEBUGGERS)


def stack_of_thread(ident: int) -> list[tuple[str, int, str]]:
    """Return file, line and function of each frame of a thread of this process, innermost first."""
    frame, stack = sys._current_frames().get(ident), []
    while frame is not None:
        stack.append((frame.f_code.co_filename, frame.f_lineno, frame.f_code.co_qualname))
        frame = frame.f_back
    return stack


STACK_SIGNAL: Final = signal.SIGRTMIN + 4
"""Lets a child process write the stacks of its threads to its stderr."""
_FRAME: Final = re.compile(r'  File "(.*)", line (\d+) in (.*)')

Frame = tuple[str, int, str]
"""File, line and function."""


class Stack(list[list[Frame]]):
    """Frames of each thread, innermost first. current: of the thread alone in which a fatal signal struck."""

    def __init__(self, text: str = "", current: bool = False) -> None:
        super().__init__()
        for part in re.split(r"^(?=(?:Current thread|Thread) 0x)", text, flags=re.MULTILINE)[1:]:
            if not current or part.startswith("Current"):
                self.append([(file, int(line), function) for file, line, function in _FRAME.findall(part)])

    @property
    def is_debugged(self) -> bool:
        """Whether a debugger stands in one of the threads."""
        return any(is_debugged(file for file, _, _ in frames) for frames in self)


def place_in(stack: list[list[Frame]], waits_count: bool = True) -> str:
    """Return where the code of a plug-in stands, as ``in FUNCTION (FILE, line N)``; "" if it stands nowhere.

    A thread that is in it comes before one that it has left. waits_count: also if it waits in this program.
    """
    for depth in (1, None):
        for frames in stack:
            for file, line, function in frames[:depth]:
                if is_users(file):
                    return f"in {function} ({location(file, line)})"
                if is_programs(file) and not waits_count:
                    break
    return ""
