"""Engines that run the batches: processes of this computer, or the workers of a Dask cluster.

An engine takes batches and yields their rows in the order of completion; it restarts the work of a killed worker. It
submits only as many batches as keep the workers busy, so memory does not grow with the number of cases.
"""

from __future__ import annotations

import logging
import math
import os
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Generator, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import cache
from itertools import islice
from multiprocessing import parent_process
from multiprocessing.context import ForkServerContext, ForkServerProcess
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from pathlib import Path
from queue import Empty, SimpleQueue
from types import ModuleType
from typing import Any, Final, Protocol, Self

from hil.core import program_digest
from hil.core.child_process import die_with_parent
from hil.core.surroundings import leave_process, prepare_worker_processes, remove_temporary_folders
from hil.errors import BadInput, CampaignStopped, one_line
from hil.parts.campaigns.batch import Batch, Case, Rows, Spec, run_batch, worker_count
from hil.parts.campaigns.dispersions import case_seed
from hil.parts.campaigns.outcome import failed_row

log = logging.getLogger("hil")

_AHEAD: Final = 2  # batches per worker, or parts of them, that are queued or running
_PART: Final = 10  # cases that are submitted to a worker of this computer at once
_TRIES: Final = 3  # tries of a batch whose worker dies
_REASON: Final = 200  # characters of a worker's error in a line
_DEAD_MAX: Final = 3  # cases in a row whose workers died: it is not the cases
_DEAD: Final = (BrokenProcessPool, EOFError, ConnectionError)
"""Raised when a worker, or the process that starts them, has ended."""
_CONNECT_S: Final = 10.0
_ASK_EVERY_S: Final = 1.0  # a scheduler whose computer has lost power does not close the connection
_SILENT_S: Final = 20.0
_PROBE_S: Final = 10.0
_IDLE_FIRST_S, _IDLE_EACH_S, _IDLE_LAST_S = 10.0, 60.0, 600.0  # without a worker: until the first line, each, the end


class Engine(Protocol):
    """Runs batches."""

    @property
    def workers(self) -> int:
        """Number of workers."""

    def run(self, spec: Spec, batches: Iterable[Batch]) -> Generator[tuple[int, Rows], None, None]:
        """Yield first case and rows of each of the ``batches``; closing it ends the work. Raises CampaignStopped."""

    def close(self) -> None:
        """Release the workers."""


class LocalEngine:
    """Worker processes of this computer, which stay until ``close``; a single one is this process.

    workers: their number; 0: one per core that this process may use.
    """

    def __init__(self, workers: int) -> None:
        self.workers = worker_count(workers)
        self._pool: ProcessPoolExecutor | None = None

    def run(self, spec: Spec, batches: Iterable[Batch]) -> Generator[tuple[int, Rows], None, None]:
        """Yield first case and rows of each batch."""
        if self.workers == 1:
            for first, count in batches:
                yield first, run_batch(spec, first, count)
            return
        remaining = deque(batches)
        while remaining:
            suspects = yield from self._until_worker_death(spec, remaining)
            with _Isolated(spec) as isolated:
                for batch in suspects:
                    yield batch[0], isolated.run(*batch)

    def _until_worker_death(self, spec: Spec, queue: deque[Batch]) -> Generator[tuple[int, Rows], None, list[Batch]]:
        """Run batches of ``queue`` until it is empty; after the death of a worker return those under way."""
        under_way: dict[Batch, _Parts] = {}
        waiting: dict[Future[Rows], tuple[Batch, int]] = {}
        parts: deque[tuple[Batch, int]] = deque()
        pool = self._pool = self._pool or _pool(self.workers)
        completed = False
        try:
            while queue or parts or waiting:
                while (queue or parts) and len(waiting) < _AHEAD * self.workers:
                    if not parts:
                        batch = queue.popleft()
                        under_way[batch] = _Parts(batch)
                        parts.extend((batch, first) for first in under_way[batch].borders)
                    batch, first = parts[0]
                    future = pool.submit(run_batch, spec, first, min(_PART, sum(batch) - first))
                    waiting[future] = parts.popleft()
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    rows = future.result()
                    batch, first = waiting.pop(future)
                    if (whole := under_way[batch].put(first, rows)) is not None:
                        del under_way[batch]
                        yield batch[0], whole
            completed = True
        except _DEAD:
            return sorted(under_way)
        finally:
            if not completed:  # also if the caller closes it early; work under way is not waited for
                self._pool = None
                pool.shutdown(wait=False, cancel_futures=True)
        return []

    def close(self) -> None:
        """End the worker processes, which are idle."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None


class _Parts:
    """A batch that is run in parts, so that all workers stay busy to the end of a campaign."""

    def __init__(self, batch: Batch) -> None:
        self.borders = range(batch[0], sum(batch), _PART)
        self._rows: dict[int, Rows] = {}

    def put(self, first: int, rows: Rows) -> Rows | None:
        """Add the rows of the part that begins with case ``first``; return the batch's rows when it is complete."""
        self._rows[first] = rows
        if len(self._rows) < len(self.borders):
            return None
        return [row for border in self.borders for row in self._rows[border]]


class _Isolated:
    """Runs the batches that were under way when a worker died one by one, to identify the case that kills it."""

    def __init__(self, spec: Spec) -> None:
        self._spec = spec
        self._pool: ProcessPoolExecutor | None = None
        self._dead = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)

    def run(self, first: int, count: int) -> Rows:
        """Return the rows of a batch; a case that kills its worker each time has that as its reason.

        Raises CampaignStopped after ``_DEAD_MAX`` of them in a row.
        """
        for _ in range(_TRIES if count == 1 else 1):
            if self._pool is None:
                self._pool = _pool(1)
            try:
                rows = self._pool.submit(run_batch, self._spec, first, count).result()
                self._dead = 0
                return rows
            except _DEAD:
                self._pool.shutdown()
                self._pool = None
        if count > 1:
            return [row for case in range(first, first + count) for row in self.run(case, 1)]
        self._dead += 1
        if self._dead >= _DEAD_MAX:
            text = f"the worker processes of {_DEAD_MAX} cases in a row, the last of them {first}, ended {_TRIES} times"
            raise CampaignStopped(f"{text}: completed cases are kept")
        return [died_row(self._spec, first)]


def _pool(workers: int) -> ProcessPoolExecutor:
    """Return worker processes, forked from one that has imported what they need and loaded the kernels."""
    for library in ("OPENBLAS", "OMP", "MKL"):  # one core per worker; libraries already loaded are not affected
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    prepare_worker_processes()
    context = _WorkerContext()
    context.set_forkserver_preload(["hil.parts.campaigns.engines", "hil.parts.campaigns.worker_kernels"])
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_init_worker)


class _Worker(ForkServerProcess):
    """Process that does not import the caller's script: one without a main guard would start more campaigns."""

    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            return ForkServerProcess._Popen(process_obj)
        finally:
            sys.modules["__main__"] = script


class _WorkerContext(ForkServerContext):
    """Context of the workers."""

    Process = _Worker


def _init_worker() -> None:
    """Ignore Ctrl-C, which the campaign's process handles, and end with that process.

    It is not the parent of this one, which a fork server has started.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with_parent()
    Finalize(None, remove_temporary_folders, exitpriority=0)
    if (campaign := parent_process()) is not None:
        threading.Thread(target=_end_with, args=(campaign,), name="campaign", daemon=True).start()


def _end_with(campaign: BaseProcess) -> None:
    campaign.join()
    leave_process(0)


def died_row(spec: Spec, case: int) -> dict[str, Any]:
    """Return the row of a case whose worker ended each time."""
    drawn = Case(spec).drawn(case)
    reason = f"not flown: its worker process ended, {_TRIES} times"
    return {"case": case, "seed": case_seed(spec.seed, case), **drawn, **failed_row(reason)}


def run_batch_of(
    program: dict[str, str], scenario_digest: str, spec: Spec, first: int, count: int
) -> tuple[dict[str, str], str, Rows]:
    """Return program, digest of the scenario, and the rows of a batch. Raises ValueError if these are others here."""
    here = _program()
    if (here, spec.scenario_digest) != (program, scenario_digest):
        raise ValueError(_difference(here, program) or "another scenario")
    return here, scenario_digest, run_batch(spec, first, count)


_program = cache(program_digest.program)


def _difference(program: Mapping[str, str], expected: Mapping[str, str]) -> str:
    """Return in what a worker's ``program`` differs from the campaign's, "" if in nothing."""
    if program["digest"] == "none":
        return "the package hil-bench is not installed there"
    other = [f"{key} {program[key]} (here {expected[key]})" for key in expected if program[key] != expected[key]]
    return f"its hil {program['hil']} is another program: {', '.join(other)}" if other else ""


class DaskEngine:
    """The workers of the Dask scheduler at ``address``; raises BadInput if there is none."""

    def __init__(self, address: str) -> None:
        from distributed import Client  # slow import

        self._address = address
        self._program = program_digest.program()
        self._known: set[str] = set()
        self._idle_since_s = math.inf
        for name in (
            "distributed",
            *logging.root.manager.loggerDict,
        ):  # their relevant errors are reported by this class
            if name.split(".")[0] in ("distributed", "tornado", "asyncio"):
                logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of versions, which are compared here
                self._client = Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise BadInput.single("--scheduler", "", f"{address}: cannot be reached: {reason}") from error
        try:
            self._check_workers()  # at once: what the caller prepares takes its time
        except BaseException as error:
            self.close()
            if isinstance(error, OSError):
                raise self._lost(error) from error
            raise

    @property
    def workers(self) -> int:
        """Threads of all present workers, at least one."""
        return max(1, int(sum(self._client.nthreads().values())))

    def run(self, spec: Spec, batches: Iterable[Batch]) -> Generator[tuple[int, Rows], None, None]:
        """Yield first case and rows of each batch; the scheduler reassigns the batches of a lost worker."""
        from distributed import CancelledError, KilledWorker
        from distributed.comm.core import CommClosedError

        remaining = iter(batches)
        tries: dict[Batch, int] = {}
        of: dict[Any, Batch] = {}
        done: SimpleQueue[Any] = SimpleQueue()
        digest = spec.scenario_digest

        def submit(batch: Batch) -> None:
            future = self._client.submit(run_batch_of, self._program, digest, spec, *batch, pure=False)
            of[future] = batch
            future.add_done_callback(done.put)

        try:
            while True:
                for batch in islice(remaining, max(0, _AHEAD * self.workers - len(of))):
                    submit(batch)
                if not of:
                    return
                future = self._next(done)
                batch = of.pop(future)
                if future.status == "finished":
                    program, its_digest, rows = future.result()
                    if (program, its_digest) != (self._program, digest):
                        raise CampaignStopped(f"scheduler {self._address}: cases {batch[0]}.. are of another program")
                    yield batch[0], rows
                elif future.status in ("cancelled", "lost") or self._client.status != "running":
                    raise CommClosedError
                else:
                    error = future.exception()
                    if not isinstance(error, KilledWorker):
                        self._known.clear()
                        self._check_workers()
                    tries[batch] = tries.get(batch, 0) + 1
                    if tries[batch] < _TRIES:
                        submit(batch)
                    elif isinstance(error, KilledWorker):
                        yield batch[0], [died_row(spec, case) for case in range(batch[0], sum(batch))]
                    else:
                        text = f"{type(error).__name__}: {one_line(str(error), _REASON)}"
                        raise CampaignStopped(f"scheduler {self._address}: its workers cannot run cases: {text}")
        except (CommClosedError, CancelledError, OSError) as error:
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> CampaignStopped:
        lost = f"no answer for {_SILENT_S:g} s" if isinstance(error, TimeoutError) else "connection lost"
        text = f"scheduler {self._address}: {lost}: completed cases are kept, start it and run the command again"
        return CampaignStopped(text)

    def _next(self, done: SimpleQueue[Any]) -> Any:
        """Return the next future of ``done``; raise OSError if the scheduler does not answer meanwhile.

        Raises CampaignStopped if a worker has another program, or there has been none for _IDLE_LAST_S.
        """
        said_s = -math.inf
        while self._client.scheduler is not None:
            with suppress(Empty):
                return done.get(timeout=_ASK_EVERY_S)
            self._check_workers()
            now_s = time.monotonic()
            idle_s = now_s - self._idle_since_s
            if idle_s >= _IDLE_LAST_S:
                text = f"no worker for {_IDLE_LAST_S:g} s: completed cases are kept, start workers and run it again"
                raise CampaignStopped(f"scheduler {self._address}: {text}")
            if idle_s >= _IDLE_FIRST_S and now_s - said_s >= _IDLE_EACH_S:
                said_s = now_s
                log.warning("scheduler %s: no worker: the campaign waits, %g s at most", self._address, _IDLE_LAST_S)
        raise ConnectionError

    def _check_workers(self) -> None:
        """Raise CampaignStopped if a worker that is new has another program; note since when there is none.

        Raises OSError if the scheduler does not answer.
        """
        scheduler = self._client.scheduler
        if scheduler is None:
            raise ConnectionError
        present = set(self._client.sync(scheduler.identity, n_workers=-1, callback_timeout=_SILENT_S)["workers"])
        self._known &= present
        self._idle_since_s = math.inf if present else min(self._idle_since_s, time.monotonic())
        if new := sorted(present - self._known):
            call = ("(exec(source), program())[1]", {"source": Path(program_digest.__file__).read_text("utf-8")})
            try:
                answers = self._client.sync(
                    self._client._run, eval, *call, workers=new, on_error="ignore", callback_timeout=_PROBE_S
                )
            except TimeoutError:
                return  # busy ones: each batch is checked as well
            for worker, program in answers.items():
                if problem := _difference(program, self._program):
                    raise CampaignStopped(f"worker {worker} is refused: {problem}: completed cases are kept")
            self._known |= set(answers)

    def close(self) -> None:
        """Disconnect from the scheduler."""
        self._client.close(timeout=2)
