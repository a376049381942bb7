"""``hil ci``: what a pipeline runs: campaign, run in lock-step, requirements, tests, comparison with the base."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hil.cli.options import File, Runs, Seed
from hil.cli.output import notices, write_json
from hil.core.files import write_text
from hil.errors import BadInput

if TYPE_CHECKING:
    from hil.api.results import Run
    from hil.parts.campaigns.api.campaign_results import Campaign

PASS, FAIL, STOPPED = "pass", "fail", "safe stop"
_CODES: Final = {PASS: 0, FAIL: 1, STOPPED: 3}
_NO_TESTS: Final = 5  # exit code of pytest


@dataclass(frozen=True)
class PipelineStep:
    """Result of one step of the pipeline. verdict: PASS, FAIL or STOPPED. text: its numbers."""

    name: str
    verdict: str
    text: str


def ci(
    scenario: str,
    /,
    *,
    out: str,
    runs: Runs = 200,
    seed: Seed = 0,
    base: str | None = None,
    tests: str | None = None,
    json: File = None,
) -> int:
    """Run a campaign on the mock rig and a run in lock-step, judge requirements and tests, compare with the base.

    The exit code is 1 if a part has failed, and 3 if the bench has stopped.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file.
    out
        Folder for the results, with summary.md and requirements.html.
    runs
        Number of cases of the campaign.
    seed
        Seed of campaign and run.
    base
        Folder with the campaign of the base branch, of the same seed: differences with confidence intervals.
    tests
        Folder of a test campaign, which pytest runs on the mock rig and in lock-step.
    json
        File for the results, - for standard output.
    """
    if tests is not None and not Path(tests).exists():
        raise BadInput.single("--tests", "", f"{tests}: does not exist")

    from hil.api.runs import run
    from hil.parts.campaigns.api.campaigns import campaign

    stored = None if base is None else _Base(Path(base), seed, runs)
    folder, console = Path(out), notices()
    folder.mkdir(parents=True, exist_ok=True)
    _remove_campaign(folder / "campaign")
    with console.status(f"campaign of {runs} cases"):
        cases = campaign(scenario, runs, folder / "campaign", seed)
    steps = [_campaign_step(cases)]
    with console.status("run in lock-step"):
        lock_step = {"rig.host.time": "lock_step"}
        wired = run(scenario, "emulated", seed, overrides=lock_step, record=folder / "recordings")
    steps.append(_run_step(wired))
    if cases.summary["requirements"]:
        steps.append(_requirements_step(wired, folder))
    for rig in () if tests is None else ("mock", "emulated"):
        with console.status(f"tests on {rig}"):
            steps.append(_tests_step(str(tests), rig, folder / "day"))
    compared = None if stored is None else stored.compare(cases)
    if compared is not None:
        steps.append(_comparison_step(compared))
    verdicts = [step.verdict for step in steps]
    verdict = STOPPED if STOPPED in verdicts else FAIL if FAIL in verdicts else PASS
    summary = "\n".join(_markdown(cases.summary["scenario"], verdict, steps, compared)) + "\n"
    write_text(summary, folder / "summary.md")
    if json != "-":
        print(summary, end="")  # noqa: T201
    if json is not None:
        content = [vars(step) for step in steps]
        write_json(
            {"scenario": cases.summary["scenario"], "verdict": verdict, "steps": content} | (compared or {}), json
        )
    return _CODES[verdict]


def _remove_campaign(folder: Path) -> None:
    """Remove the campaign of an earlier ``hil ci``: what has changed since must not be mixed with it."""
    from hil.parts.campaigns.store import MANIFEST

    if (folder / MANIFEST).is_file():
        shutil.rmtree(folder)


class _Base:
    """Campaign of the base branch in ``folder``, or of an earlier ``hil ci`` there. Raises BadInput."""

    def __init__(self, folder: Path, seed: int, runs: int) -> None:
        from hil.parts.campaigns.explain import Cases
        from hil.parts.campaigns.store import TABLE

        inner = folder / "campaign" if (folder / "campaign").is_dir() else folder
        if not (inner / TABLE).is_file():
            raise BadInput.single(
                "--base", "", f"{folder}: has no numbers, the campaign of a hil ci on the base branch"
            )
        self._cases = Cases(inner, "--base")
        for name, own, given in (("seed", self._cases.identity["seed"], seed), ("runs", len(self._cases.table), runs)):
            if own != given:
                text = f"{folder}: its campaign has {name} {own}, this one {given}: cases can only be paired if equal"
                raise BadInput.single("--base", "", text)

    def compare(self, cases: Campaign) -> dict[str, Any]:
        """Return the differences of ``cases`` from the base, by the keys of ``comparison.json``."""
        from hil.parts.campaigns.statistics import compare

        return compare(self._cases, cases, ("base", "here"))


def _campaign_step(cases: Campaign) -> PipelineStep:
    rate = cases.accepted_rate
    text = f"{rate['passed']} of {rate['runs']} accepted, 95 %: {rate['low']:.3f} to {rate['high']:.3f}"
    return PipelineStep("campaign on mock", PASS if rate["passed"] else FAIL, text)


def _run_step(run: Run) -> PipelineStep:
    verdict = PASS if run.accepted else STOPPED if run.summary["faults"] else FAIL
    return PipelineStep("run in lock-step", verdict, repr(run)[1:-1])


def _requirements_step(run: Run, folder: Path) -> PipelineStep:
    """Return the verdict of the requirements, open steps aside; write their page into ``folder``."""
    from hil.parts.campaigns.campaign import scenario_digest, write_evidence
    from hil.parts.campaigns.placement import RecordedRun, evidence_of_runs
    from hil.parts.campaigns.requirements_page import requirements_verdict, steps_text

    name = Path(run.summary["recording"]["file"]).name
    recorded = {name: RecordedRun(run.rig.kind, run.summary, scenario_digest(run.scenario))}
    scenario, sources, rows = evidence_of_runs(recorded, folder / "campaign")
    write_evidence(folder, scenario, sources, rows)
    return PipelineStep("requirements", FAIL if requirements_verdict(rows) == "fail" else PASS, steps_text(rows))


def _tests_step(tests: str, rig: str, results: Path) -> PipelineStep:
    command = [sys.executable, "-m", "pytest", tests, "--rig", rig, "--results", str(results.absolute())]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    lines = [line.strip("= ") for line in done.stdout.splitlines() if line.strip("= ")]
    print(done.stdout, end="", file=sys.stderr)  # noqa: T201
    verdict = PASS if done.returncode in (0, _NO_TESTS) else FAIL
    return PipelineStep(f"tests on {rig}", verdict, lines[-1] if lines else "no output")


def _comparison_step(comparison: dict[str, Any]) -> PipelineStep:
    """Return FAIL if significantly more cases have lost their acceptance than won it, by the exact test of signs."""
    from scipy.stats import binomtest  # slow import

    rates = comparison["accepted_rate"]
    lost, won = rates["first_alone"], rates["second_alone"]
    p = binomtest(lost, lost + won, alternative="greater").pvalue if lost + won else 1.0
    text = f"{lost} cases lost, {won} won, p = {p:.3g} for as many losses by chance"
    return PipelineStep("comparison with the base", FAIL if p < 1.0 - comparison["confidence"] else PASS, text)


def _markdown(scenario: str, verdict: str, steps: list[PipelineStep], compared: dict[str, Any] | None) -> Iterator[str]:
    yield f"## {verdict.upper()} {scenario}"
    yield ""
    yield "| | verdict | |"
    yield "|---|---|---|"
    for step in steps:
        yield f"| {step.name} | {step.verdict} | {step.text.replace('|', chr(92) + '|')} |"
    yield ""
    if compared is None:
        yield "No numbers of the base branch: nothing is compared."
        return
    yield f"Means of {compared['runs']} paired cases, and their difference with its 95 % interval:"
    yield ""
    yield "| | base | here | difference | |"
    yield "|---|--:|--:|--:|---|"
    for name, row in compared["difference"].items():
        if row["first_mean"] is None or row["low"] is None:
            continue
        changed = "changed" if row["low"] > 0.0 or row["high"] < 0.0 else ""
        yield (
            f"| {name} | {row['first_mean']:.4g} | {row['second_mean']:.4g} | "
            f"{row['mean']:+.3g} ({row['low']:+.3g} to {row['high']:+.3g}) | {changed} |"
        )
