"""Page of one day of a test campaign: tests, runs, twins, alarms, requirements, set-up and digests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hil.parts.campaigns.pytest_plugin.results import CampaignRun, CampaignTest
from hil.parts.campaigns.requirements_page import EvidenceRow, requirements_table, requirements_verdict, steps_text
from hil.report import html

if TYPE_CHECKING:
    from hil.api.recordings import Recording

_RUN_NUMBERS: Final = ("ready, s", "least margin to Table III", "position rmse x y z, mm", "propellant, kg")
_TWIN_HEAD: Final = (
    "test", "rigs", "position apart, mm", "attitude apart, deg", "in sigmas", "of Table III", "propellant, kg",
)  # fmt: skip


def day_page(
    folder: Path, setups: Mapping[str, Mapping[str, str]], tests: Sequence[CampaignTest], rows: Sequence[EvidenceRow]
) -> str:
    """Return the page of a day. rows: evidence for the requirements."""
    failed = [test for test in tests if test.outcome == "failed"]
    verdict = "fail" if failed or not tests else "pass"
    title = f"Test campaign {folder.name}"
    passed = sum(test.outcome == "passed" for test in tests)
    body = [
        html.heading(1, title),
        html.paragraph(verdict.upper(), f"verdict {verdict}"),
        html.paragraph(f"{passed} of {len(tests)} tests passed on {len(setups)} rigs"),
        *_tests(list(setups), tests),
        *_requirements(rows),
        *_runs(tests),
        *_twins(folder, tests),
        *_alarms(tests),
        *_setups(setups),
    ]
    return html.page(title, body)


def _tests(rigs: Sequence[str], tests: Sequence[CampaignTest]) -> Iterator[str]:
    yield html.heading(2, "Tests")
    outcomes = {(test.test, test.rig): test for test in tests}
    rows = []
    for name in dict.fromkeys(test.test for test in tests):
        cells = [outcomes[name, rig].outcome if (name, rig) in outcomes else "-" for rig in rigs]
        rows.append((name, next(test.text for test in tests if test.test == name), *cells))
    yield html.table(("test", "", *rigs), rows, words=True)
    wrong = [(test.test, test.rig, test.outcome, test.message) for test in tests if test.outcome != "passed"]
    if wrong:
        yield html.table(("test", "rig", "", "reason"), wrong, "Failed and omitted", words=True)


def _requirements(rows: Sequence[EvidenceRow]) -> Iterator[str]:
    if rows:
        yield html.heading(2, "Requirements")
        yield html.paragraph(f"{requirements_verdict(rows).upper()}: {steps_text(rows)}")
        yield requirements_table(rows)


def _runs(tests: Sequence[CampaignTest]) -> Iterator[str]:
    yield html.heading(2, "Runs")
    rows = [
        (
            test.test,
            test.rig,
            f"{run.scenario}, seed {run.seed}",
            "accepted" if run.accepted else "not accepted",
            run.stop,
            *(run.numbers.get(name, "-") for name in _RUN_NUMBERS),
            run.recording or "-",
            run.scenario_digest,
        )
        for test in tests
        for run in test.runs
    ]
    head = ("test", "rig", "scenario", "verdict", "stop", *_RUN_NUMBERS, "recording", "scenario digest")
    yield html.table(head, rows, words=True)


def _twins(folder: Path, tests: Sequence[CampaignTest]) -> Iterator[str]:
    """Yield how far the truths of the same test are apart on each two rigs; of runs that tests share once."""
    rows: dict[tuple[str, ...], tuple[str, ...]] = {}
    for name in dict.fromkeys(test.test for test in tests):
        own = [test for test in tests if test.test == name and test.runs]
        for a, b in combinations(own, 2):
            for k, (first, second) in enumerate(zip(a.runs, b.runs, strict=False)):
                shared = (first.recording, second.recording)
                key = shared if all(shared) else (name, a.rig, b.rig, str(k))
                if key not in rows and first.scenario_digest == second.scenario_digest:
                    rows[key] = _twin(folder, name, f"{a.rig} / {b.rig}", first, second)
    if rows:
        yield html.heading(2, "Twins")
        caption = (
            "Largest difference of the truths over the time that both runs cover; sigma: of filters and dead bands"
        )
        yield html.table(_TWIN_HEAD, list(rows.values()), caption, words=True)


def _twin(folder: Path, name: str, rigs: str, first: CampaignRun, second: CampaignRun) -> tuple[str, ...]:
    from hil.report.comparison import divergences  # slow imports

    propellant = " / ".join(run.numbers.get("propellant, kg", "-") for run in (first, second))
    pair = [_recording(folder, run) for run in (first, second)]
    if pair[0] is None or pair[1] is None:
        return name, rigs, "-", "-", "-", "-", propellant
    apart = divergences(pair[0].history, pair[1].history, pair[0].scenario)
    largest = {
        quantity: max((each.largest for each in apart if each.name.startswith(quantity)), default=float("nan"))
        for quantity in ("position", "attitude")
    }
    sigmas = [each.sigmas for each in apart if each.sigmas is not None]
    beyond = 100.0 * max((each.of_tolerance for each in apart), default=float("nan"))
    in_sigmas = f"{max(sigmas):.1f}" if sigmas else "-"
    return (
        name,
        rigs,
        f"{largest['position']:.3g}",
        f"{largest['attitude']:.3g}",
        in_sigmas,
        f"{beyond:.0f} %",
        propellant,
    )


def _recording(folder: Path, run: CampaignRun) -> Recording | None:
    from hil.api.recordings import open_recording  # slow imports
    from hil.errors import BadInput

    if not run.recording:
        return None
    try:
        return open_recording(folder / run.recording)
    except BadInput:  # removed or damaged since
        return None


def _alarms(tests: Sequence[CampaignTest]) -> Iterator[str]:
    rows = [
        (test.test, test.rig, f"{alarm['t_s']:.2f}", alarm["priority"], alarm["text"])
        for test in tests
        for run in test.runs
        for alarm in run.alarms
    ]
    yield html.heading(2, "Alarms")
    if rows:
        yield html.table(("test", "rig", "bench time, s", "priority", "alarm"), rows, words=True)
    else:
        yield html.paragraph("No alarm.")


def _setups(setups: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    yield html.heading(2, "Set-up")
    names = list(dict.fromkeys(name for setup in setups.values() for name in setup))
    rows = [(name, *(setup.get(name, "-") for setup in setups.values())) for name in names]
    yield html.table(("", *setups), rows, words=True)
