"""``hil run``: one closed-loop run with its verdict."""

from __future__ import annotations

import faulthandler
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from hil.cli.options import Group, OptionalInteger, Output, RunOptions, refuse
from hil.cli.output import check_json_path, write_json
from hil.cli.progress import ProgressBar
from hil.errors import Problem

if TYPE_CHECKING:
    from hil.core.modes import Mode
    from hil.core.operator_commands import Operator
    from hil.loop.runner import Runner
    from hil.setup.assembly import Job

_PASSED, _FAILED, _SAFE_STOPPED = 0, 1, 3
_DEFAULTS = RunOptions()


def run(
    scenario: str,
    /,
    *,
    rig: str = "mock",
    options: Group[RunOptions] = _DEFAULTS,
    case: OptionalInteger = None,
    record: str | None = None,
    json: Output = None,
) -> int:
    """Run one closed loop and print its verdict.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file.
    rig
        mock, emulated, or the path of a rig file.
    case
        Number of a case of the campaign of this scenario and seed, to be run in full detail.
    record
        Folder for the recording and its catalogue; see hil recordings list.
    json
        File for the numbers of the run, - for standard output.
    """
    problems = options.problems() + check_json_path("--json", json)
    if case is not None and case < 0:
        problems.append(Problem("--case", "", f"{case}: must not be negative"))
    refuse(problems)

    from hil.cli.warm_up import compile_kernels_with_notice
    from hil.config.load import load_rig, load_scenario
    from hil.session import build

    loaded = load_scenario(scenario, options.settings)
    if loaded.value.gnc.library is not None and sys.__stderr__ is not None:
        faulthandler.enable(sys.__stderr__)  # a library that crashes takes this process with it: print where
    length_s = loaded.value.duration_s if options.duration is None else options.duration
    job = build.Job(loaded, load_rig(rig, options.settings), options.seed, length_s, options.speed)
    if case is not None:
        job = _dispersed(job, case)
    console = Console(stderr=True)
    with console.status("checking that the rig can follow the scenario"):
        build.check(job)
    compile_kernels_with_notice(job, console)
    more = {} if case is None else {"campaign_seed": options.seed, "case": case}
    return run_job(RunRequest(job, rig, console, json, record, more))


@dataclass(frozen=True)
class RunRequest:
    """A checked job and what to do with its results.

    more: added to the summary, and the result of ``link_stats`` after the run. attach: receives the runner before it
    starts.
    """

    job: Job
    rig_name: str
    console: Console
    json: str | None
    record: str | None
    more: dict[str, Any] = field(default_factory=dict)
    operator: Operator | None = None
    attach: Callable[[Runner], None] = lambda _: None
    link_stats: Callable[[], dict[str, Any]] = dict


def run_job(request: RunRequest) -> int:
    """Run a checked job and print its verdict; return the exit code."""
    from hil.report.summary import summarise
    from hil.report.table import render
    from hil.session import with_docking_monitor

    job, console = request.job, request.console
    scenario, rig = job.scenario.value, job.rig.value

    def announce(text: str) -> None:
        console.print(text, style="dim", highlight=False, soft_wrap=True)

    with ExitStack() as stack:
        recorder = None
        if request.record is not None:
            from hil.recording.session import recording  # slow imports, for recorded runs only

            recorder = stack.enter_context(recording(job, request.rig_name, Path(request.record), announce))
        sinks = recorder.sinks if recorder else None
        with (
            ProgressBar(console, "opening the devices") as bar,
            with_docking_monitor.runner(job, _mode_shown_on(bar), announce, sinks, request.operator) as (runner, look),
        ):
            request.attach(runner)
            outcome = runner.run()
            watched = look(outcome)
        summary, verdict = summarise(outcome, scenario, rig, request.rig_name, job.seed, 1.0 / scenario.step_s)
        summary |= request.more | request.link_stats()
        if watched is not None:
            from hil.report.docking_monitor import judge_monitor, monitor_lines

            summary["monitor"] = judge_monitor(watched, outcome.history, scenario, rig)
        if recorder:
            kept = recorder.finish(summary)
            summary["recording"] = {"file": str(recorder.path), "dropped": kept.dropped, "problem": kept.problem}
            if kept.problem:
                text = f"recording: {kept.problem}"
                console.print(text, style="yellow", highlight=False, soft_wrap=True, markup=False)
    if request.json is not None:
        write_json(summary, request.json)
    if request.json != "-":
        render(summary, verdict, scenario.requirements, Console())
        if watched is not None:
            print("\n".join(monitor_lines(summary["monitor"])))  # noqa: T201
    if outcome.faults:
        print(f"safe stop: {outcome.stop}", file=sys.stderr)  # noqa: T201
        return _SAFE_STOPPED
    return _PASSED if summary["passed"] else _FAILED


def _dispersed(job: Job, case: int) -> Job:
    """Return the job of a campaign's case: its true scenario, that of the GNC, and its own seed."""
    from hil.monte_carlo.dispersions import Design, case_seed

    design = Design(job.scenario, job.seed)
    truth, known = design.apply(design.values(case))
    return replace(job, scenario=replace(job.scenario, value=known), seed=case_seed(job.seed, case), dispersed=truth)


def _mode_shown_on(bar: ProgressBar) -> Callable[[Mode, float], None]:
    """Return a callback of the runner that shows mode and progress."""
    from hil.core.modes import Mode

    titles = {
        Mode.PLACING: "moving to the start pose",
        Mode.PARKING: "moving to the parking position",
        Mode.ARMED: "waiting for poses",
        Mode.RUNNING: "closed loop",
    }
    return lambda mode, fraction: bar.show(titles.get(mode, mode.value), fraction)
