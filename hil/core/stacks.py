"""Stacks of other processes, as faulthandler writes them, and the place of a plug-in in them."""

from __future__ import annotations

import re
import signal
from typing import Final

from hil.core.plug_ins import is_debugged, is_programs, is_users, location

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
