"""Compiles every kernel before anything moves, and says so when it takes a while."""

from __future__ import annotations

import time

from rich.console import Console

from hil.build import Job, warm_up
from hil.maths.jit import kernels_are_cached, mark_kernels_cached


def warm_up_with_a_word(job: Job, console: Console) -> None:
    """Call every kernel of the loop once; the first time after a change of the sources that compiles them."""
    if kernels_are_cached():
        warm_up(job)
        return
    started = time.perf_counter()
    with console.status("first start: compiling the kernels for this computer, once, about 20 s ..."):
        if not console.is_terminal:
            console.print("first start: compiling the kernels for this computer, once, about 20 s ...")
        warm_up(job)
    mark_kernels_cached()
    console.print(f"kernels compiled in {time.perf_counter() - started:.1f} s")
