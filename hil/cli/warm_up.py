"""Compiles every kernel before anything moves, and says so when it takes a while.

``python -m hil.cli.warm_up`` does nothing else.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console

from hil.config.load import load_rig, load_scenario
from hil.core.jit import kernels_are_cached, mark_kernels_cached, prepare_kernel_cache
from hil.session.build import FIRST_START, Job, warm_up, warm_up_all_but_navigation

_NOTICE = f"{FIRST_START} ..."
_OTHER_HALF_S = 120.0
_SAFE_STOPPED = 3


def compile_kernels_with_notice(job: Job, console: Console) -> None:
    """Call every kernel of the loop once; the first time after a change of the sources that compiles them."""
    with left_at_once_on_ctrl_c():
        _warm_up(job, console)


def _warm_up(job: Job, console: Console) -> None:
    if kernels_are_cached():
        warm_up(job)
        return
    prepare_kernel_cache()
    started = time.perf_counter()
    with console.status(_NOTICE):
        if not console.is_terminal:
            console.print(_NOTICE, soft_wrap=True)
        _compile_on_two_cores(job)
        warm_up(job)
    mark_kernels_cached()
    console.print(f"kernels compiled in {time.perf_counter() - started:.1f} s")


@contextmanager
def left_at_once_on_ctrl_c() -> Iterator[None]:
    """End the process where it stands: nothing is powered yet, and an exception in mid-compilation would get lost.

    The compiler calls back into Python from C, where a KeyboardInterrupt is swallowed.
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


def _compile_on_two_cores(job: Job) -> None:
    """Let a child fill the cache with one half of the kernels; what it does not manage is compiled here later."""
    with subprocess.Popen([sys.executable, "-m", "hil.processes.precompile"], stderr=subprocess.DEVNULL) as child:
        try:
            warm_up_all_but_navigation(job)
            child.wait(_OTHER_HALF_S)
        except subprocess.TimeoutExpired:
            pass
        finally:
            child.kill()


if __name__ == "__main__":
    loaded = load_scenario("scheme-1")
    compile_kernels_with_notice(Job(loaded, load_rig("mock"), 0, 1.0, 1.0), Console(stderr=True))
