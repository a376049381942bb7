"""Report of one or more recorded runs: a self-contained HTML page."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from hil.checks.waivers import Waiver
from hil.loop.compiled.run_stats import counted
from hil.recording.read import Recorded
from hil.report import html
from hil.report.comparison import LEFT_SIGMAS, divergences, key_numbers, same_flight
from hil.report.figures import figures
from hil.report.results import NavigationResults, RunResults
from hil.report.section import sections_of
from hil.report.summary import BROKE_OFF, summary_of
from hil.report.table import ready_rows, verdict_lines
from hil.report.verdict import TABLE_V, Verdict, verdict_of

_VERSIONS: Final = (
    "hil",
    "hil_commit",
    "schema_version",
    "python",
    "numpy",
    "numba",
    "scipy",
    "mcap",
    "system",
    "host",
)
_CALIBRATION: Final = ("calibration_motion", "calibration_sign_off", "scenario_file", "rig_file", "rig_kind")


@dataclass(frozen=True)
class Judged:
    """A recorded run with its numbers and verdict."""

    recorded: Recorded
    results: RunResults
    verdict: Verdict

    @property
    def name(self) -> str:
        run = self.recorded.run
        return f"{run['scenario']} on {run['rig']}, seed {run['seed']}"


def judged(recorded: Recorded) -> Judged:
    """Return the run's numbers as recorded; of a run that broke off, those of its cycles."""
    scenario, history = recorded.scenario, recorded.cycles
    verdict = verdict_of(counted(history, scenario).ready, scenario.requirements)
    return Judged(recorded, RunResults.of(summary_of(recorded)), verdict)


def report(runs: Sequence[Recorded]) -> str:
    """Return the page, HTML; runs: one, or several to compare. Each has at least one cycle."""
    all_judged = [judged(run) for run in runs]
    title = all_judged[0].name if len(runs) == 1 else f"{len(runs)} runs compared"
    body = [html.heading(1, title)]
    if len(runs) > 1:
        body += _comparison(all_judged)
    for run in all_judged:
        body += _one(run, alone=len(runs) == 1)
    return html.page(title, body)


def _one(run: Judged, alone: bool) -> Iterator[str]:
    recorded, results = run.recorded, run.results
    if not alone:
        yield html.heading(1, run.name)
    accepted = results.accepted
    failed = f"NO VERDICT: {results.withheld}" if results.withheld else "FAIL"
    text = f"PASS {results.not_required_text()}".rstrip() if accepted else failed
    yield html.paragraph(text, f"verdict {'pass' if accepted else 'fail'}")
    yield html.paragraph(
        f"{recorded.run['run']}, started {recorded.run['started_utc']}, {len(recorded.cycles)} cycles recorded, "
        f"ended: {results.stop}"
    )
    if not recorded.intact or recorded.summary is None:
        yield html.paragraph(f"{BROKE_OFF} or is damaged: the page shows its intact part.", "note")
    dropped = int((recorded.end or {}).get("dropped", "0"))
    if dropped:
        yield html.paragraph(f"{dropped} messages are missing in this recording.", "note")
    for waiver in results.waived:
        yield html.paragraph(str(Waiver(**waiver)), "waived")
    yield from _verdict(run)
    yield html.heading(2, "Figures")
    for title, address in figures(recorded.cycles, recorded.scenario, recorded.rig, run.verdict):
        yield html.image(title, address)
    yield from _numbers(results)
    for section in sections_of(recorded.summary or {}):
        yield from section.html()
    yield from _events(recorded, results)
    yield from _configuration(recorded)


def _verdict(run: Judged) -> Iterator[str]:
    results, scenario = run.results, run.recorded.scenario
    yield html.heading(2, "Verdict")
    rows = [("ok" if passed else "fail", name, text) for name, passed, text in verdict_lines(results)]
    yield html.table(("", "part", ""), rows, words=True)
    paper = TABLE_V.get(results.scenario)
    if run.verdict.worst is None:
        yield html.paragraph("The ready phase was not reached: there is no comparison with Table V.", "note")
        return
    ready = ready_rows(results.scenario, run.verdict, scenario.requirements)
    lines = [(f"{label} {axis}, {unit}", *cells) for label, axis, unit, *cells in ready]
    beside = f"{paper.ready_time_s:g}" if paper and paper.ready_time_s is not None else "-"
    lines.append(("ready, s", "", f"{results.ready_time_s:.2f}", "", beside, ""))
    head = ("", "Table III", "here", "margin", "Table V", "")
    yield html.table(head, lines, "Ready phase: largest deviations against Table III, and the paper's Table V")


def _numbers(results: RunResults) -> Iterator[str]:
    yield html.heading(2, "Key numbers")
    yield html.table(("", "here"), key_numbers(results))
    if errors := _errors_over_bound(results.navigation):
        caption = "Navigation: error against the bound of these sensors, which no filter can be below"
        yield html.table(("", "error, rms", "bound", "error over bound"), errors, caption)
    thrusters = results.thrusters
    rows = [
        (str(number), str(firings), f"{on_s:.2f}")
        for number, (firings, on_s) in enumerate(
            zip(thrusters.thruster_firings, thrusters.thruster_on_time_s, strict=True), start=1
        )
    ]
    yield html.table(("thruster", "firings", "open, s"), rows, "Thruster use")
    if control := results.control:
        keys = ("smallest_change", "noise", "coast", "dead_band", "lead_s", "period_s")
        rows = [(axis["axis"], axis["unit"], *(f"{axis[key]:.3g}" for key in keys)) for axis in control["axes"]]
        head = ("axis", "unit", "smallest change, unit/s", "noise", "coast", "dead band", "lead, s", "period, s")
        caption = f"Control at the end: dead bands and leads for firings of at least {control['shortest_firing_s']:g} s"
        yield html.table(head, rows, caption)
    timing = results.timing
    asked = [(p["name"], "granted" if p["granted"] else "refused", p["detail"]) for p in timing.privileges]
    if asked:
        yield html.table(("requested of the system", "", ""), asked, "Real time", words=True)
    latency = [
        (name.replace("_", " "), *("-" if value is None else f"{value:.2f}" for value in times.values()))
        for name, times in results.latency.as_json().items()
    ]
    yield html.table(("latency", "p50", "p99", "max"), latency)
    if results.vision:
        counted = [(name, str(count)) for name, count in results.vision.items()]
        yield html.table(("vision unit", "count"), counted)
    if truth := results.truth:
        yield html.table(("truth", ""), [(name.replace("_", " "), f"{value}") for name, value in truth.items()])
    if sensors := results.sensors:
        keys = ("accepted", "rejected", "excluded", "too_late", "suspected", "mean_nis")
        samples = [
            (name, *("-" if sensor[key] is None else f"{sensor[key]:.6g}" for key in keys))
            for name, sensor in sensors.items()
        ]
        yield html.table(("sensor", *(key.replace("_", " ") for key in keys)), samples)
    if drift := results.drift_check:
        parts = [(e["part"], f"{e['shift_px']:.3f}", f"{e['chance']:.1e}") for e in drift["explanations"]]
        title = f"Drift since calibration {drift['calibration']} of {drift['date']}"
        yield html.table(("part", "shift, px", "by chance"), parts, title)


def _errors_over_bound(navigation: NavigationResults) -> list[tuple[str, str, str, str]]:
    """Return error, bound and their ratio of each axis; none if a recording has no such bound."""
    lines = []
    for quantity, unit, scale, axes in (("position", "m", 1e3, "xyz"), ("attitude", "deg", 1.0, "123")):
        error, bound = (getattr(navigation, f"{quantity}_{name}_{unit}") for name in ("rmse", "bound"))
        if error is None or bound is None:
            continue
        for axis, here, least in zip(axes, error, bound, strict=True):
            shown = "mm" if unit == "m" else unit
            lines.append(
                (
                    f"{quantity} {axis}, {shown}",
                    f"{scale * here:.3g}",
                    f"{scale * least:.3g}",
                    f"{here / least:.2f}" if least else "-",
                )
            )
    return lines


def _events(recorded: Recorded, results: RunResults) -> Iterator[str]:
    yield html.heading(2, "Faults, alarms, events")
    if results.injected:
        rows = [
            (fault["device"], fault["kind"], " ".join(f"{value:g}" for value in fault["value"]), f"{fault['at_s']:g}",
             "" if fault["until_s"] is None else f"{fault['until_s']:g}")
            for fault in results.injected
        ]  # fmt: skip
        yield html.table(("injected in", "fault", "value", "from, s", "to, s"), rows, words=True)
    if results.faults:
        yield html.table(("fault",), [(text,) for text in results.faults], words=True)
    if results.alarms:
        alarms = [(f"{a['t_s']:.2f}", a["text"]) for a in results.alarms]
        yield html.table(("bench time, s", "alarm"), alarms, words=True)
    rows = [
        (*("" if n[key] is None else f"{n[key]:.2f}" for key in ("t_s", "bench_s")), n["kind"], n["name"], n["message"])
        for n in recorded.log
    ]
    yield html.table(("run, s", "bench, s", "kind", "source", ""), rows, words=True)


def _configuration(recorded: Recorded) -> Iterator[str]:
    yield html.heading(2, "Configuration and versions")
    named = sorted(name for name in recorded.run if name.startswith("calibration_") and name not in _CALIBRATION)
    rows = [(name.replace("_", " "), recorded.run.get(name, "")) for name in (*_VERSIONS, *_CALIBRATION, *named)]
    yield html.table(("", ""), [row for row in rows if row[1]], words=True)
    for title, model in (("scenario", recorded.scenario), ("rig", recorded.rig)):
        yield html.folded(title, json.dumps(model.model_dump(mode="json"), indent=1))


def _comparison(runs: Sequence[Judged]) -> Iterator[str]:
    numbers = [dict(key_numbers(run.results)) for run in runs]
    rows = [(label, *(column[label] for column in numbers)) for label in numbers[0]]
    yield html.table(("", *(run.name for run in runs)), rows, "Side by side")
    if not same_flight([run.recorded.run for run in runs]):
        yield html.paragraph("The runs have different scenarios: their trajectories are not compared.", "note")
        return
    first = runs[0]
    for other in runs[1:]:
        yield _divergences(first, other)


def _divergences(first: Judged, other: Judged) -> str:
    a, b = first.recorded, other.recorded
    rows = [
        (
            divergence.name,
            f"{divergence.largest:.4g} {divergence.unit}",
            f"{divergence.at_s:.2f}",
            "-" if divergence.sigmas is None else f"{divergence.sigmas:.1f}",
            "-" if divergence.beyond is None else f"{100.0 * divergence.beyond:.1f} %",
            "never" if divergence.left_s is None else f"{divergence.left_s:.2f}",
            f"{100.0 * divergence.of_tolerance:.0f} %",
        )
        for divergence in divergences(a.cycles, b.cycles, a.scenario)
    ]
    head = (
        "truth",
        "largest difference",
        "at, s",
        "in sigmas",
        f"of the time beyond {LEFT_SIGMAS:g} sigma",
        f"first beyond for 1 s or more, s (> {LEFT_SIGMAS:g} sigma)",
        "of Table III",
    )
    caption = f"Twin consistency: {other.name} against {first.name}; sigma: of both filters and dead bands"
    return html.table(head, rows, caption)
