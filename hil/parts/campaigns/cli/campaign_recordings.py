"""``hil recordings place``, and the evidence that ``hil recordings verify`` adds to a campaign's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from hil.cli.options import File
from hil.cli.output import print_columns, write_json


def place_recordings(
    recordings: Annotated[list[str], Parameter(negative=())],
    /,
    *,
    campaign: str,
    json: File = None,
) -> int:
    """Place recorded runs in the distribution of a campaign: which outcomes are outside all its cases, by how much.

    Exit code 1 if an outcome of a run is outside.

    Parameters
    ----------
    recordings
        Files of hil run --record.
    campaign
        Results folder of a campaign of the same scenario.
    json
        File for the numbers, - for standard output.
    """
    from hil.api.recordings import open_recording
    from hil.parts.campaigns.placement import place_run

    runs: list[dict[str, Any]] = [
        {"recording": name, "outcomes": place_run(open_recording(name).summary, Path(campaign))} for name in recordings
    ]
    if json != "-":
        for run in runs:
            _render_places(run)
    write_json({"campaign": campaign, "runs": runs}, json)
    return int(any(_is_outside(cell) for run in runs for cell in run["outcomes"].values()))


def _is_outside(cell: dict[str, Any]) -> bool:
    return cell["percentile"] is not None and cell["outside"] != 0.0


def _render_places(run: dict[str, Any]) -> None:
    head = ("outcome", "value", "percentile", "p", "outside")
    rows = []
    for name, cell in sorted(run["outcomes"].items(), key=lambda item: item[1]["p_value"] or 1.0):
        is_placed = cell["percentile"] is not None
        beyond = "-" if cell["outside"] is None else f"{cell['outside']:.2f}" if cell["outside"] else ""
        p = (f"{cell['percentile']:.1f}", f"{cell['p_value']:.3g}") if is_placed else ("-", "-")
        rows.append((name, f"{cell['value']:.5g}", *p, beyond))
    outside = sum(_is_outside(cell) for cell in run["outcomes"].values())
    cases = max((cell["cases"] for cell in run["outcomes"].values()), default=0)
    expected = 2.0 * len(run["outcomes"]) / (cases + 1)
    print_columns(head, rows)
    print(f"{run['recording']}: {outside} of {len(rows)} outcomes outside {cases} cases, {expected:.2g} expected")  # noqa: T201


def add_to_evidence(recordings: list[str], campaign: str, out: str | None, json: str | None) -> int:
    """Write the evidence of ``campaign`` and of ``recordings``; return the exit code."""
    from hil.api.recordings import open_recording
    from hil.parts.campaigns.campaign import scenario_digest, write_evidence
    from hil.parts.campaigns.placement import RecordedRun, evidence_of_runs
    from hil.parts.campaigns.requirements_page import evidence_json, requirements_verdict, steps_text, with_open_steps

    opened = {Path(name).name: open_recording(name) for name in recordings}
    runs = {name: RecordedRun(run.rig.kind, run.summary, scenario_digest(run.scenario)) for name, run in opened.items()}
    scenario, sources, rows = evidence_of_runs(runs, Path(campaign))
    folder = Path(campaign if out is None else out)
    folder.mkdir(parents=True, exist_ok=True)
    write_evidence(folder, scenario, sources, rows)
    verdict = requirements_verdict(rows)
    if json != "-":
        whole = with_open_steps(rows)
        cells = [(row.id, row.step, row.evidence, row.result, _margin(row.margin), row.status) for row in whole]
        print_columns(("id", "step", "evidence", "result", "margin", "status"), cells, left=(0, 1, 2, 3, 5))
        print(f"results in {folder / 'requirements.html'}")  # noqa: T201
        print(f"{verdict.upper()} requirements of {scenario}: {steps_text(rows)}")  # noqa: T201
    write_json(evidence_json(scenario, sources, rows), json)
    return int(verdict == "fail")


def _margin(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
