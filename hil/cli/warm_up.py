"""Compilation of the kernels with a notice on the terminal. ``python -m hil.cli.warm_up`` does nothing else."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console

from hil.config.load import load_rig, load_scenario
from hil.core.jit import kernels_are_cached
from hil.session.build import Job
from hil.session.warm_up import compile_kernels, warm_up

_SAFE_STOPPED = 3


def compile_kernels_with_notice(job: Job, console: Console) -> None:
    """Call every kernel of the loop once; the first time after a change of the sources that compiles them."""
    with exit_on_ctrl_c():
        if kernels_are_cached():
            warm_up(job)
            return
        with console.status("compiling"):
            compile_kernels(job, lambda text: console.print(text, soft_wrap=True, highlight=False))


@contextmanager
def exit_on_ctrl_c() -> Iterator[None]:
    """Let Ctrl-C end the process at once: nothing is powered yet, and the compiler would lose an exception.

    It calls back into Python from C, where a KeyboardInterrupt is swallowed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(*_: object) -> None:
        os.write(sys.stderr.fileno(), b"stopped by the operator\n")
        os._exit(_SAFE_STOPPED)

    before = {number: signal.signal(number, leave) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


if __name__ == "__main__":
    loaded = load_scenario("scheme-1")
    compile_kernels_with_notice(Job(loaded, load_rig("mock"), 0, 1.0, 1.0), Console(stderr=True))
