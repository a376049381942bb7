"""Closed-loop runs: ``hil.run``, and the run of a checked job with recording and verdict that it shares with the
command line."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Unpack

from hil.api.jobs import (
    BackendArguments,
    Faults,
    Overrides,
    job_of,
    named_as_argument,
    rig_name,
)
from hil.api.results import Run, run_of
from hil.checks.before_run import before_run
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.operator_commands import Operator
from hil.core.part import provided
from hil.core.public import public
from hil.errors import BadInput
from hil.gnc_backends.backend import PARTS
from hil.gnc_backends.base import GncBackend
from hil.gnc_backends.python_backend import PythonGnc, class_name
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.outcome import Outcome
from hil.loop.runner import STOPPED_BY_OPERATOR, Runner
from hil.loop.session_parts import PartResult, SessionParts
from hil.report.long_run import accumulate
from hil.report.summary import summarise
from hil.report.tally import Tallied
from hil.session import build
from hil.session.assembly import Job
from hil.session.warm_up import Compilation

log = logging.getLogger("hil")
"""Logger of the API: start of processes (INFO), compilation (WARNING)."""


class RunArguments(BackendArguments, total=False):
    """Further arguments of ``hil.run``."""

    case: int | None
    campaign: str | Path | None
    dispersions: str | Path | None


@public
def run(
    scenario: str | Path | Scenario,
    rig: str | Path | Rig = "mock",
    seed: int = 0,
    duration_s: float | None = None,
    overrides: Overrides | None = None,
    faults: Faults | None = None,
    gnc: PythonGnc | None = None,
    record: str | Path | None = None,
    **options: Unpack[RunArguments],
) -> Run:
    """Run one closed loop to its end and return its results.

    Parameters
    ----------
    scenario
        ``scheme-1``, ``scheme-2``, ``scheme-3``, the path of a TOML file, or a Scenario.
    rig
        ``mock`` (in memory, faster than real time), ``emulated`` (devices in other processes, real time), the path of
        a rig file, or a Rig.
    seed
        Seed of all random numbers: the same seed gives the same run on the mock rig.
    duration_s
        Time of the run, s; None for the scenario's.
    overrides
        Dotted keys or nested tables to values: ``{"gnc.control.deadband_m": 0.004, "rig.vmu.timeout_s": 0.5}``.
    faults
        Faults to inject, tables with the keys of ``[[faults]]``, in addition to the scenario's faults:
        ``[{"device": "vmu", "kind": "no_pose", "at_s": 60.0}]``.
    gnc
        Object with ``step(input)`` that replaces the GNC of the scenario, see ``hil.gnc_backends.python_backend``.
    record
        Folder for a recording of the run and its catalogue.
    options
        ``case=``: number of a case of the campaign of this scenario and seed, or of that in the folder ``campaign=``;
        ``dispersions=``: a set or a file for it. ``navigation=``, ``control=``: backends in place of the scenario's: a
        class or an object with ``step(inp)``, a kernel (``hil.kernel_backend``), or a name as in
        ``gnc.control.backend``: ``package:name``, ``file.py:name``, the path of a shared library.

    Raises
    ------
    BadInput
        Invalid arguments, with one line per error.
    DeviceError
        A device of the rig does not start. A fault during the run does not raise: the bench stops, ``passed`` is False
        and ``stop`` is the fault.
    KeyboardInterrupt
        Ctrl-C, after the bench has stopped.
    Exception
        On the mock rig: what an object given as ``gnc``, ``navigation`` or ``control`` has raised.
    """
    with named_as_argument():
        case, folder, dispersions = options.get("case"), options.get("campaign"), options.get("dispersions")
        if dispersions is not None:
            overrides = {"dispersions": str(dispersions), **(overrides or {})}
        backends = {part: options[part] for part in PARTS if part in options}
        job = job_of(scenario, rig, overrides, seed, duration_s, gnc=gnc, faults=faults, **backends)
        job, of_case = _job_of_case(job, case, folder)
    with Compilation(job) as compilation:
        with named_as_argument():
            build.check(job)
        compilation.finish(log.warning)
    with named_as_argument():
        completed = run_or_raise(RunRequest(job, rig_name(rig), record, gnc_summary(gnc) | of_case, announce=log.info))
    if STOPPED_BY_OPERATOR in completed.summary["faults"]:
        raise KeyboardInterrupt(STOPPED_BY_OPERATOR)
    return completed


def _job_of_case(job: Job, case: int | None, folder: str | Path | None) -> tuple[Job, dict[str, Any]]:
    """Return the job of ``case`` and what the summary has of it; the job itself without one. Raises BadInput."""
    if case is None:
        if folder is not None:
            raise BadInput.single("campaign", "", "needs case")
        return job, {}
    chosen, more, note = provided("case")(job, int(case), folder)
    if note:
        log.warning(note)
    return chosen, more


def run_or_raise(request: RunRequest) -> Run:
    """Return the results of ``run_job``; in simulated time raise what an object of the user has raised."""
    runners: list[Runner] = []
    completed = run_job(replace(request, prepare=lambda parts: parts.on_built.append(runners.append)))
    if request.job.rig.value.kind == "mock" and not request.job.paced:
        for runner in runners:
            raise_user_error(runner.loop.gnc)
    return completed


def raise_user_error(gnc: GncBackend) -> None:
    """Raise what an object of the user has raised in the step of ``gnc``, with its own traceback."""
    error = gnc.user_error
    if error is not None:
        error.__suppress_context__ = True
        raise error


def gnc_summary(gnc: PythonGnc | None) -> dict[str, Any]:
    """Return the part of the summary that names a Python GNC; empty without one."""
    return {} if gnc is None else {"gnc": {"library": None, "sha256": None, "python": class_name(gnc)}}


@dataclass(frozen=True)
class RunRequest:
    """A checked job and its connections.

    record: folder of the recording. more: added to the summary, as is the result of ``link_stats`` after the run.
    prepare: receives the parts of the session before its loop is built.
    """

    job: Job
    rig_name: str
    record: str | Path | None = None
    more: dict[str, Any] = field(default_factory=dict)
    announce: Callable[[str], None] = lambda _: None
    on_progress: ProgressCallback = lambda *_: None
    operator: Operator | None = None
    prepare: Callable[[SessionParts], None] = lambda _: None
    link_stats: Callable[[], dict[str, Any]] = dict


def run_job(request: RunRequest) -> Run:
    """Run a checked job and return its results. Raises DeviceError if a device does not start."""
    job = request.job
    before = before_run(job.scenario.value, job.rig.value, job.duration_s, job.seed)
    for line in before.lines:
        request.announce(line)
    with ExitStack() as stack:
        recorder = None
        if request.record is not None:
            from hil.recording.session import recording  # slow imports, for recorded runs only

            recorder = stack.enter_context(recording(job, request.rig_name, Path(request.record), request.announce))
        parts = SessionParts(request.operator, request.on_progress, request.announce)
        numbers = accumulate(parts, job)
        request.prepare(parts)
        with build.opened(job, parts, recorder.sinks if recorder else None) as runner:
            outcome = runner.run()
            results = parts.results_of(outcome)
        judged = judged_run(job, request.rig_name, outcome, results, numbers(outcome), before.ephemeris)
        judged.summary.update(request.more | request.link_stats())
        if recorder:
            kept = recorder.finish(judged.summary)
            judged.summary["recording"] = {"file": str(recorder.path), "dropped": kept.dropped, "problem": kept.problem}
    return judged


def judged_run(
    job: Job,
    rig: str,
    outcome: Outcome,
    results: Sequence[PartResult] = (),
    numbers: Tallied | None = None,
    ephemeris: list[str] | None = None,
) -> Run:
    """Return the results of ``outcome``. results: of parts. numbers: of a long run. ephemeris: see ``summarise``."""
    scenario = job.scenario.value
    rate_hz = 1.0 / scenario.step_s
    summary, verdict = summarise(outcome, scenario, job.rig.value, rig, job.seed, rate_hz, numbers, ephemeris)
    summary |= {result.table: result.numbers for result in results}
    if reasons := [result.withheld for result in results if result.withheld]:
        summary |= {"accepted": False, "withheld": "; ".join(reasons)}
    rows = {name: rows for result in results for name, rows in result.rows.items()}
    judged = run_of(job, rig, outcome, summary, rows)
    judged.verdict = verdict
    return judged
