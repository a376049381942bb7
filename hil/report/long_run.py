"""Counting of a run that is too long for its rows to be kept: each part as it is complete, in bounded memory.

In real time a thread counts one part while the loop fills the next.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

import numpy as np

from hil.loop.outcome import Outcome
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.report.tally import Tallied, Tally
from hil.session import assembly
from hil.session.assembly import Job

_PAUSE_WALL_S: Final = 0.02  # between two blocks while the loop runs in real time


class _PartThread:
    """Adds each part to ``run`` in a thread, while the loop fills the other of two memories."""

    def __init__(self, run: Tally, history: np.ndarray) -> None:
        self._run = run
        self._free = np.zeros(len(history), history.dtype)
        self._thread: threading.Thread | None = None

    def take(self, rows: np.ndarray) -> np.ndarray:
        """Begin to add ``rows``; return the other memory. Waits for the part before, which takes seconds of minutes."""
        self.wait()
        self._thread = threading.Thread(target=self._run.add, args=(rows,), name="long-run", daemon=True)
        self._thread.start()
        free, self._free = self._free, rows
        return free

    def wait(self) -> None:
        """Wait until the last part is added."""
        if self._thread is not None:
            self._thread.join()


def _load_kernels(job: Job, row: np.ndarray) -> None:
    """Evaluate two rows like ``row`` (1,) of CYCLE: a kernel that is first loaded in the thread would stop the loop."""
    rows = np.repeat(row, 2)
    rows["t_s"] = 0.0, job.scenario.value.step_s
    rows["truth"]["q_CH"] = rows["navigation"]["q_CH"] = rows["reference"]["q_CH"] = 0.0, 0.0, 0.0, 1.0
    with np.errstate(all="ignore"):
        warm = Tally(job.scenario.value, job.rig.value)
        warm.add(rows)
        warm.end()


def accumulate(parts: SessionParts, job: Job) -> Callable[[Outcome], Tallied | None]:
    """Add to ``parts`` what receives the rows if the run of ``job`` is longer than its memory of rows.

    Return a function that returns the ``numbers`` of the run with an outcome; None if its rows give them.
    """
    if job.cycles <= assembly.ROWS_MAX:
        return lambda _: None
    run, taken = Tally(job.scenario.value, job.rig.value), []
    part_thread: _PartThread | None = None

    def begin(runner: Runner) -> None:
        nonlocal part_thread
        if runner.rate.paced:
            run.pause_s = _PAUSE_WALL_S
            _load_kernels(job, runner.loop.now.row)
            part_thread = _PartThread(run, runner.loop.history)

    def take(rows: np.ndarray) -> np.ndarray:
        taken.append(len(rows))
        if part_thread is not None:
            return part_thread.take(rows)
        run.add(rows)
        return rows

    def end(outcome: Outcome) -> Tallied | None:
        if not taken:
            return None
        if part_thread is not None:
            part_thread.wait()
        run.add(outcome.history)
        return run.numbers()

    parts.on_built.append(begin)
    parts.on_full = take
    return end
