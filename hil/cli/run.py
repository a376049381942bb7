"""``hil run``: one closed-loop run, watched while it runs, judged at the end."""

from __future__ import annotations

import faulthandler
import math
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from hil.cli.output import check_json_path, write_json
from hil.cli.progress import Bar
from hil.cli.warm_up import compile_kernels_with_notice
from hil.config.load import load_rig, load_scenario
from hil.core.modes import Mode
from hil.core.operator_commands import Operator
from hil.errors import BadInput, Problem
from hil.loop.runner import Runner
from hil.setup.assembly import Job

_PASSED, _FAILED, _SAFE_STOPPED = 0, 1, 3


def run_command(
    scenario_name: str,
    rig_name: str,
    seed: int,
    case: int | None,
    duration_s: float | None,
    settings: Sequence[str],
    speed: float,
    json_path: str | None,
    record: str | None = None,
) -> int:
    """Do ``hil run``; return its exit code. Raises BadInput before anything is started."""
    check_options(seed, duration_s, speed, json_path, case)
    scenario = load_scenario(scenario_name, settings)
    if scenario.value.gnc.library is not None and sys.__stderr__ is not None:
        faulthandler.enable(sys.__stderr__)  # a library that crashes takes this process with it: say where
    rig = load_rig(rig_name, settings)
    console = Console(stderr=True)

    from hil.session import build

    job = build.Job(scenario, rig, seed, scenario.value.duration_s if duration_s is None else duration_s, speed)
    if case is not None:
        job = _dispersed(job, case)
    with console.status("checking that the rig can follow the scenario"):
        build.check(job)
    compile_kernels_with_notice(job, console)
    return fly(job, rig_name, console, json_path, record, {} if case is None else {"campaign_seed": seed, "case": case})


def fly(
    job: Job,
    rig_name: str,
    console: Console,
    json_path: str | None,
    record: str | None,
    more: dict[str, Any],
    operator: Operator | None = None,
    attach: Callable[[Runner], None] = lambda _: None,
    account: Callable[[], dict[str, Any]] = dict,
) -> int:
    """Run ``job``, which has been checked, and say how it went; return the exit code.

    more: goes into the numbers of the run; ``account`` gives what is to go there after it. attach: given the runner
    before it begins.
    """
    from hil.report.docking_monitor import judge_monitor, monitor_lines
    from hil.report.summary import summarise
    from hil.report.table import render
    from hil.session import with_docking_monitor

    scenario, rig = job.scenario, job.rig

    def announce(text: str) -> None:
        console.print(text, style="dim", highlight=False, soft_wrap=True)

    with ExitStack() as stack:
        taken = None
        if record is not None:
            from hil.recording.session import recording  # what it needs is not loaded in vain

            taken = stack.enter_context(recording(job, rig_name, Path(record), announce))
        taps = taken.taps if taken else None
        with (
            _Watch(console, "opening the devices") as bar,
            with_docking_monitor.runner(job, bar.watch, announce, taps, operator) as (runner, look),
        ):
            attach(runner)
            outcome = runner.run()
            watched = look(outcome)
        summary, verdict = summarise(
            outcome,
            job.scenario.value,
            rig.value,
            rig_name,
            job.seed,
            1.0 / scenario.value.step_s,
        )
        summary |= more | account()
        if watched is not None:
            summary["monitor"] = judge_monitor(watched, outcome.history, scenario.value, rig.value)
        if taken:
            kept = taken.finish(summary)
            summary["recording"] = {"file": str(taken.path), "dropped": kept.dropped, "problem": kept.problem}
            if kept.problem:
                text = f"recording: {kept.problem}"
                console.print(text, style="yellow", highlight=False, soft_wrap=True, markup=False)
    if json_path is not None:
        write_json(summary, json_path)
    if json_path != "-":
        render(summary, verdict, scenario.value.requirements, Console())
        if watched is not None:
            print("\n".join(monitor_lines(summary["monitor"])))  # noqa: T201
    if outcome.faults:
        print(f"safe stop: {outcome.stop}", file=sys.stderr)  # noqa: T201
        return _SAFE_STOPPED
    return _PASSED if summary["passed"] else _FAILED


def _dispersed(job: Job, case: int) -> Job:
    """Return the job of a campaign's case: what is true, what the GNC is told, and the case's own seed."""
    from hil.campaign.dispersions import Design, case_seed

    design = Design(job.scenario, job.seed)
    truth, told = design.apply(design.values(case))
    return replace(job, scenario=replace(job.scenario, value=told), seed=case_seed(job.seed, case), dispersed=truth)


def check_options(
    seed: int, duration_s: float | None, speed: float, json_path: str | None, case: int | None = None
) -> None:
    """Raise BadInput with every option that cannot be used."""
    problems = []
    if case is not None and case < 0:
        problems.append(Problem("--case", "", f"{case}: must not be negative"))
    if seed < 0:
        problems.append(Problem("--seed", "", f"{seed}: must not be negative"))
    if duration_s is not None and not (math.isfinite(duration_s) and duration_s > 0.0):
        problems.append(Problem("--duration", "", f"{duration_s:g}: must be a time above 0 s"))
    if not (math.isfinite(speed) and speed > 0.0):
        problems.append(Problem("--speed", "", f"{speed:g}: must be above 0"))
    problems += check_json_path("--json", json_path)
    if problems:
        raise BadInput(problems)


class _Watch(Bar):
    """The bar of a run, told by the runner."""

    _TITLES = {  # noqa: RUF012
        Mode.PLACING: "moving to the start pose",
        Mode.PARKING: "moving to the parking place",
        Mode.ARMED: "waiting for poses",
        Mode.RUNNING: "closed loop",
    }

    def watch(self, mode: Mode, share: float) -> None:
        self.tell(self._TITLES.get(mode, mode.value), share)
