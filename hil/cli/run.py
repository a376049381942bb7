"""``hil run``: one closed-loop run with its verdict."""

from __future__ import annotations

import faulthandler
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from hil.cli.options import File, Flag, Group, OptionalCase, RunOptions, refuse, refuse_wires_in_use
from hil.cli.output import notices, say, write_json
from hil.cli.progress import ProgressBar
from hil.core.part import provided
from hil.errors import BadInput, Problem

if TYPE_CHECKING:
    from hil.api.runs import RunRequest
    from hil.core.modes import Mode

_PASSED, _FAILED, _SAFE_STOPPED = 0, 1, 3
_DEFAULTS = RunOptions()


UNFINISHED = "the process ended before the run was over"
"""``stop`` in the JSON of a run that was killed."""


@dataclass(frozen=True)
class StoredCaseOptions:
    """Options of a campaign's case."""

    case: OptionalCase = None
    """Number of a case of the campaign of this scenario and seed, to be run in full detail."""
    dispersions: str | None = None
    """Dispersion set of that campaign, instead of the scenario's: shipped, stress, or the path of a file."""
    campaign: str | None = None
    """Results folder of that campaign, which gives seed and duration; needed for a rare-event campaign."""

    def problems(self, options: RunOptions) -> list[Problem]:
        """Return a problem for each option that cannot be used."""
        problems = []
        if self.campaign is not None and self.case is None:
            problems.append(Problem("--campaign", "", "needs --case"))
        if self.campaign is not None and (options.duration is not None or options.seed != 0):
            problems.append(Problem("--campaign", "", "gives seed and duration: omit --seed and --duration"))
        return problems


@dataclass(frozen=True)
class OutputOptions:
    """What a run prints and leaves."""

    record: str | None = None
    """Folder for the recording and its catalogue; see hil recordings list."""
    explain: Flag = False
    """Print what each line of the verdict means."""
    json: File = None
    """File for the numbers of the run, - for standard output."""


_NO_CASE, _NOT_KEPT = StoredCaseOptions(), OutputOptions()


def run(
    scenario: str,
    /,
    *,
    rig: str = "mock",
    lock_step: Flag = False,
    options: Group[RunOptions] = _DEFAULTS,
    until_stopped: Flag = False,
    of_case: Group[StoredCaseOptions] = _NO_CASE,
    output: Group[OutputOptions] = _NOT_KEPT,
) -> int:
    """Run one closed loop and print its verdict.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file.
    rig
        mock, emulated, or the path of a rig file.
    lock_step
        Let the time of an emulated rig advance when all processes have done their part: the same seed gives the same
        run, whatever the load of the computer.
    until_stopped
        Run until Ctrl-C, which ends the run normally; memory does not grow.
    """
    problems = of_case.problems(options)
    if until_stopped and options.duration is not None:
        problems.append(Problem("--until-stopped", "", "does not go together with --duration"))
    refuse(problems)
    refuse_wires_in_use(rig, options.settings)

    from hil.api.jobs import IN_LOCK_STEP, loaded_rig, loaded_scenario, make_job
    from hil.api.runs import RunRequest
    from hil.cli.warm_up import finish_with_notice
    from hil.session import build
    from hil.session.warm_up import Compilation

    chosen = () if of_case.dispersions is None else (f"dispersions={of_case.dispersions}",)
    loaded = loaded_scenario(scenario, (*chosen, *options.settings))
    bench = loaded_rig(rig, (*options.settings, *(IN_LOCK_STEP if lock_step else ())))
    if loaded.value.gnc.binary is not None and sys.__stderr__ is not None:
        faulthandler.enable(sys.__stderr__)  # a library that crashes takes this process with it: print where
    console = notices()
    job = make_job(loaded, bench, options.seed, options.duration, options.speed)
    job = replace(job, until_stopped=until_stopped)
    more = {}
    if (case := of_case.case) is not None:
        job, more, note = provided("case", "--case")(job, case, of_case.campaign)
        if note:
            say(note, console, "yellow")
    with Compilation(job) as compilation:
        with console.status("checking that the rig can follow the scenario"):
            build.check(job)
        finish_with_notice(compilation, console)
    return run_and_print(RunRequest(job, rig, output.record, more), console, output.json, output.explain)


def run_and_print(request: RunRequest, console: Console, json: str | None, explain: bool = False) -> int:
    """Run a checked job and print its verdict; return the exit code.

    json: file for its numbers, - for stdout. explain: with what each line means.
    """
    from hil.api.runs import run_job

    announce = partial(say, console=console, style="dim")
    if json is not None and json != "-" and (Path(json).is_file() or not Path(json).exists()):
        job = request.job  # what stays if this process is killed
        begun = {"scenario": job.scenario.value.name, "rig": request.rig_name, "seed": job.seed}
        with suppress(BadInput):  # a full disk is reported with the numbers
            write_json({**begun, "passed": False, "accepted": False, "stop": UNFINISHED, "faults": [UNFINISHED]}, json)
    with ProgressBar(console, "opening the devices") as bar:
        completed = run_job(replace(request, announce=announce, on_progress=_mode_shown_on(bar)))
    summary = completed.summary
    if problem := summary.get("recording", {}).get("problem"):
        say(f"recording: {problem}", console, "yellow")
    if json != "-":
        completed.show(explain)
    if summary["faults"]:
        print(f"safe stop: {completed.stop}", file=sys.stderr)  # noqa: T201
    if json is not None:
        try:
            write_json(summary, json)
        except BadInput as error:
            if not summary["faults"]:
                raise
            print(error, file=sys.stderr)  # noqa: T201
    if summary["faults"]:
        return _SAFE_STOPPED
    return _PASSED if completed.accepted else _FAILED


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
