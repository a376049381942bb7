"""``hil warm-up``, and the compilation of the kernels that other commands start with."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from rich.console import Console

from hil.cli.options import refuse
from hil.core.part import without_opencv
from hil.core.surroundings import leave_process
from hil.errors import Problem

if TYPE_CHECKING:
    from hil.session.build import Job
    from hil.session.warm_up import Compilation

_PASSED, _SAFE_STOPPED = 0, 3
_GROUP_WALL_S: Final = 1800.0
_WIDTH: Final = 12  # width of the column of names
_OPENCV: Final = "needs OpenCV: pip install 'hil-bench[vision]'"


def warm_up(*groups: str) -> int:
    """Compile all kernels for this computer, and print the time that each group of them takes.

    Other commands compile the kernels that they need and that are not in the kernel cache.

    Parameters
    ----------
    groups
        Compile only these: gnc, stages, loop, verdict; of parts: vmu, fusion, monitor.
    """
    from hil.cli.precompile import groups as all_groups
    from hil.core.kernel_folder import kernel_folder, kernel_folder_notice
    from hil.session.compiled import mark_kernels_cached

    offered = all_groups()
    allowed = ", ".join(offered)
    refuse(
        [Problem("warm-up", "", f"{name}: unknown group, allowed {allowed}") for name in groups if name not in offered]
    )
    left_out = without_opencv() if importlib.util.find_spec("cv2") is None else []
    refuse([Problem("warm-up", "", f"{name}: {_OPENCV}") for name in groups if name in left_out])
    notice = kernel_folder_notice()
    refuse([Problem("warm-up", "", notice)] if kernel_folder() is None else [])
    if notice:
        print(notice)  # noqa: T201
    started_s = time.perf_counter()
    with exit_on_ctrl_c():
        _compile_groups(groups or tuple(name for name in offered if name not in left_out))
        if not groups or {"gnc", "stages"} <= set(groups):
            mark_kernels_cached("cycle")
    for name in left_out:
        print(f"{name:{_WIDTH}} left out: {_OPENCV}")  # noqa: T201
    print(f"{'total':{_WIDTH}}{time.perf_counter() - started_s:7.1f} s")  # noqa: T201
    return _PASSED


def _compile_groups(groups: Sequence[str]) -> None:
    """Compile ``groups``, one process per processor; print how long each took when it ends."""
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        running = {pool.submit(_compile_group, group): group for group in groups}
        for done in as_completed(running):
            print(f"{running[done]:{_WIDTH}}{done.result():7.1f} s", flush=True)  # noqa: T201


def _compile_group(group: str) -> float:
    """Compile a group of kernels in a child process; return the time that it took, s. Raises LinkLost if it fails."""
    from hil.core.child_process import ChildProcess

    with ChildProcess(f"precompile process, {group}", "hil.cli.precompile", {"group": group}) as child:
        return float(child.wait_ready(_GROUP_WALL_S)["seconds"])


def compile_kernels_with_notice(job: Job, console: Console) -> None:
    """Compile every kernel of a checked ``job`` that is not in the cache, with a notice on the terminal."""
    from hil.session.warm_up import Compilation

    with Compilation(job) as compilation:
        finish_with_notice(compilation, console)


def finish_with_notice(compilation: Compilation, console: Console) -> None:
    """Compile what is left, with a notice on the terminal."""
    with exit_on_ctrl_c(), console.status("compiling"):
        compilation.finish(lambda text: console.print(text, soft_wrap=True, highlight=False))


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
        leave_process(_SAFE_STOPPED)

    handlers = {number: signal.signal(number, leave) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
