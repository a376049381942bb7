"""Report of a campaign, of a comparison of two, or of a sweep: a self-contained HTML page, ``report.html``."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.config.tables.verdict import PART_COLUMNS
from hil.core.files import MIB, parse_json, read_text, write_text
from hil.errors import BadInput, one_line
from hil.parts.campaigns.explain import Cases, command_of, dispersed_names, explain
from hil.parts.campaigns.figure import dependence_figure, margins_figure, sweep_figure
from hil.parts.campaigns.requirements_page import limit_text, result_text
from hil.parts.campaigns.store import GIVEN, MANIFEST, atomic_write, given_in
from hil.report import html
from hil.report.figures import svg_address
from hil.report.limits import LIMITS, shown, unit_of, words_of

PAGE: Final = "report.html"
COMPARISON, SWEEP = "comparison.json", "sweep.json"
_ROWS: Final = ("position_m", "velocity_mps", "attitude_deg", "rate_degps")
_FLAGS: Final = {"accepted": "accepted", "passed": "Table III", "passed_all_parts": "all parts"}


def write_page(folder: Path, out: str | None = None) -> Path:
    """Write the page of the campaign, comparison or sweep in ``folder`` there or to ``out``; return its path.

    Raises BadInput.
    """
    if out is not None:
        write_text(page_of(folder), out)
        return Path(out)
    path = folder / PAGE
    with atomic_write(path) as partial:
        partial.write_text(page_of(folder), encoding="utf-8")
    return path


def page_of(folder: Path) -> str:
    """Return the page of what ``folder`` holds. Raises BadInput."""
    if (folder / MANIFEST).is_file():
        cases = Cases(folder, "hil report")
        title = _title(cases)
        return html.page(title, [html.heading(1, title), *_campaign(cases)])
    for name, body in ((COMPARISON, _comparison), (SWEEP, _sweep)):
        if (folder / name).is_file():
            title, parts = body(folder, _read(folder / name))
            return html.page(title, [html.heading(1, title), *parts])
    raise BadInput.single("hil report", "", f"{folder}: holds no finished campaign")


def _read(path: Path) -> dict[str, Any]:
    try:
        summary: dict[str, Any] = parse_json(read_text(path, 64 * MIB))
    except (OSError, ValueError, BadInput) as error:
        raise BadInput.single("hil report", "", f"{path}: cannot be read: {one_line(str(error), 200)}") from error
    return summary


def _title(cases: Cases) -> str:
    dispersions = cases.summary.get("dispersions")
    beside = f", dispersions {dispersions}" if dispersions else ""
    return f"Campaign of {cases.identity['scenario']}{beside}: {len(cases.table)} cases"


def _campaign(cases: Cases) -> Iterator[str]:
    summary = cases.summary
    why = summary.get("why") or explain(cases.column, cases.names)
    yield _rate_line(why["accepted"], "accepted")
    yield html.heading(2, "Verdict by part")
    yield from _parts(summary)
    yield html.heading(2, "What failed and why")
    yield from _causes(cases, why)
    yield html.heading(2, "Margins")
    yield html.image("Least margin of each case, relative to its limit", svg_address(margins_figure(cases.column)))
    yield _margin_table(cases)
    if pictures := list(_pictures(cases.folder)):
        yield html.heading(2, "Distributions")
        yield from pictures
    yield html.heading(2, "Drivers")
    yield from _drivers(cases, why)
    yield html.heading(2, "Worst cases")
    yield from _worst(cases, summary)
    if summary.get("requirements"):
        yield html.heading(2, "Requirements")
        verdicts = [(r["id"], r["text"], limit_text(r), result_text(r), r["verdict"]) for r in summary["requirements"]]
        yield html.table(("id", "requirement", "limit", "result", "status"), verdicts, words=True)
    yield html.heading(2, "Set-up")
    identity = {**cases.identity, **given_in(cases.identity)}
    rows = [(key.replace("_", " "), str(value)) for key, value in identity.items() if key != GIVEN]
    yield html.table(("", ""), rows, "Identity of the campaign", words=True)
    yield html.folded("summary", json.dumps({k: v for k, v in summary.items() if k != "why"}, indent=1))


def _rate_line(rate: Mapping[str, Any], word: str) -> str:
    text = f"{rate['passed']} of {rate['runs']} {word}, {_percent(rate)}"
    return html.paragraph(text, f"verdict {'pass' if rate['passed'] == rate['runs'] else 'fail'}")


def _percent(rate: Mapping[str, Any]) -> str:
    return f"{100.0 * rate['rate']:.2f} % ({100.0 * rate['low']:.2f} .. {100.0 * rate['high']:.2f})"


def _parts(summary: Mapping[str, Any]) -> Iterator[str]:
    labels = {column: name.replace("_", " ") for name, column in PART_COLUMNS.items()} | _FLAGS
    required = summary.get("required_parts", ())
    rows = [
        (labels.get(name, name.replace("_", " ")), f"{rate['passed']} of {rate['runs']}", _percent(rate))
        for name, rate in summary.get("pass_rate", {}).items()
    ]
    yield html.table(("part", "cases", "rate, 95 % interval"), rows)
    beside = [name.replace("_", " ") for name in PART_COLUMNS if name not in required]
    if required and beside:
        yield html.paragraph(f"Not required: {', '.join(beside)}.")


def _causes(cases: Cases, why: Mapping[str, Any]) -> Iterator[str]:
    if not why["failed"]:
        yield html.paragraph("No case failed.")
        return
    for cause in why["causes"]:
        phase = f", in phase {cause['phase']}" if cause["phase"] else ""
        yield html.heading(3, f"{words_of(cause['limit']).capitalize()}{phase}")
        share = {"rate": cause["share"], "low": cause["low"], "high": cause["high"]}
        yield html.paragraph(f"{cause['text']}.")
        rows = [("fraction of the failures", _percent(share)), ("a typical case", _command(cases, cause["case"]))]
        if cause["nearest"] is not None:
            near = cause["nearest"]
            rows.append(("the nearest case that passes", _command(cases, near["case"])))
            rows += [
                (f"{each['name']}", f"{each['here']:.5g} in the one, {each['value']:.5g} in the other")
                for each in near["differences"]
            ]
        yield html.table(("", ""), rows, words=True)
    alarms = [(each["bit"], str(each["alarms"]), f"{each['per_1000']:.4g}") for each in why["false_alarms"]]
    yield html.table(("accused without a fault", "alarms", "per 1000 approaches"), alarms, "False alarms")


def _command(cases: Cases, case: int) -> str:
    return command_of(cases.identity, cases.folder.name, case)


def _margin_table(cases: Cases) -> str:
    rows, case = [], cases.column("case")
    for name in LIMITS:
        margin = np.asarray(cases.column(f"margin_{name}"), dtype=float)
        finite = np.isfinite(margin)
        if not finite.any():
            continue
        unit, at = unit_of(name), int(np.nanargmin(margin))
        low, median = np.percentile(margin[finite], (5.0, 50.0))
        numbers = (shown(float(value), unit) for value in (margin[at], low, median))
        rows.append((words_of(name), *numbers, str(int(case[at]))))
    return html.table(("limit", "least", "5 %", "median", "case of the least"), rows)


def _pictures(folder: Path) -> Iterator[str]:
    for name, title in (
        ("percentiles.png", "Distributions of the outcomes, and deviations against Table III"),
        ("stanford.png", "Stanford diagram: each case at its largest error"),
    ):
        path = folder / name
        if path.is_file():
            yield html.image(title, f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}")


def _drivers(cases: Cases, why: Mapping[str, Any]) -> Iterator[str]:
    if why["nothing_found"] or not (why["drivers"] or any(cause["driver"] for cause in why["causes"])):
        yield html.paragraph("Nothing found: no dispersed number predicts the failures better than chance.", "note")
        return
    if why["drivers"]:
        rows = [(each["name"], f"{each['importance']:.3f}") for each in why["drivers"]]
        caption = f"All failures: score {why['score']:.3f} (area under the ROC curve of cases not used; 0.5: chance)"
        yield html.table(("dispersed number", "loss of the score without it"), rows, caption)
    accepted = np.asarray(cases.column("accepted"), dtype=bool)
    drawn = {row["name"] for each in (why, *why["causes"]) for row in each["drivers"][:2]}
    for name in sorted(drawn & set(dispersed_names(cases.table.column_names))):
        values = np.asarray(cases.column(name), dtype=float)
        yield html.image(f"Accepted cases by {name}", svg_address(dependence_figure(name, values, accepted)))


def _worst(cases: Cases, summary: Mapping[str, Any]) -> Iterator[str]:
    rows = []
    for name, axes in summary.get("worst", {}).items():
        for axis, cell in zip("xyz", axes, strict=True):
            if cell["value"] is not None:
                table_v = "-" if cell["table_v"] is None else f"{cell['table_v']:.4g}"
                rows.append((f"{name} {axis}", f"{cell['value']:.4g}", table_v, _command(cases, cell["case"])))
    yield html.table(("largest", "value", "Table V", "case"), rows, words=True)
    least = [
        (str(row["case"]), "-" if row["control_margin"] is None else f"{row['control_margin']:.3f}",
         _command(cases, row["case"]))
        for row in summary.get("least_margin_cases", ())
    ]  # fmt: skip
    yield html.table(("case", "margin to Table III", "command"), least, "Least margins", words=True)


def _comparison(folder: Path, comparison: Mapping[str, Any]) -> tuple[str, list[str]]:
    body = []
    for word, rate in (("accepted", comparison["accepted_rate"]), ("Table III", comparison["pass_rate"])):
        rows = [(comparison[each], _percent(rate[each]), str(rate[f"{each}_alone"])) for each in ("first", "second")]
        body.append(html.table(("scenario", "rate, 95 % interval", "cases of it alone"), rows, word))
    rows = [
        (name, *(f"{cell[key]:.4g}" for key in ("first_mean", "second_mean")), f"{cell['mean']:+.3g}",
         f"{cell['low']:+.3g} .. {cell['high']:+.3g}")
        for name, cell in comparison["difference"].items()
        if cell["low"] is not None
    ]  # fmt: skip
    head = ("", comparison["first"], comparison["second"], "difference", f"{comparison['confidence']:.0%} interval")
    body.append(html.table(head, rows, "Paired differences: the same cases in both"))
    for each in ("first", "second"):
        body += [html.heading(1, f"{comparison[each]}"), *_part_of(folder / each)]
    return f"{comparison['second']} against {comparison['first']}, {comparison['runs']} cases", body


def _part_of(folder: Path) -> Sequence[str]:
    return list(_campaign(Cases(folder, "hil report"))) if (folder / MANIFEST).is_file() else []


def _sweep(folder: Path, sweep: Mapping[str, Any]) -> tuple[str, list[str]]:
    rows = []
    for i, point in enumerate(sweep["points"]):
        means = (point[name]["mean"] for name in ("propellant_kg", "firings", "ready_time_s"))
        cells = ("-" if mean is None else f"{mean:.4g}" for mean in means)
        rows.append((f"{point['value']:.6g}", _percent(point["accepted_rate"]), *cells, _cause_of(folder, i)))
    head = ("value", "accepted, 95 % interval", "propellant, kg", "firings", "ready, s", "first cause")
    picture = html.image(f"Accepted cases and propellant by {sweep['key']}", svg_address(sweep_figure(sweep)))
    return f"Sweep of {sweep['key']}", [picture, html.table(head, rows)]


def _cause_of(folder: Path, i: int) -> str:
    path = folder / f"sweep-{i:03d}" / "summary.json"
    causes = _read(path).get("why", {}).get("causes", ()) if path.is_file() else ()
    return words_of(causes[0]["limit"]) if causes else "-"
