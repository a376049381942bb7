"""Page of a benchmark: a table of all rows, and the comparison with another one."""

from __future__ import annotations

import json
from typing import Any, Final

from hil.report import html

HEAD: Final = (
    "row", "cases", "accepted", "95 % interval", "Table III", "all parts", "margin", "propellant, kg", "over least",
    "95th percentile", "over bound", "firings", "aborts", "decision errors", "misleading", "nearest, m",
)  # fmt: skip

MEANING: Final = (
    "Margin: to Table III, kept by 95 % of the cases. Propellant is the median; over least: divided by the impulsive "
    "least of the plan; over bound: by that of any impulses. Decision errors: docking a go with the truth outside the "
    "requirement. Misleading: cases with an error beyond the alert limit that was not announced in time."
)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def cells_of(row: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a row, in the order of ``HEAD``."""
    accepted = row["accepted"]
    return (
        row["row"],
        str(accepted["runs"]),
        f"{100 * accepted['rate']:.1f} %",
        f"{100 * accepted['low']:.1f} to {100 * accepted['high']:.1f}",
        f"{100 * row['passed']['rate']:.1f} %",
        f"{100 * row['passed_all_parts']['rate']:.1f} %",
        "-" if row["control_margin"]["p5"] is None else f"{100 * row['control_margin']['p5']:.0f} %",
        _number(row["propellant_kg"]["median"], 3),
        _number(row["propellant_over_least"]["median"], 2),
        _number(row["propellant_over_least"]["p95"], 2),
        _number(row["propellant_over_bound"]["median"], 2),
        _number(row["firings"]["median"], 0),
        str(row["aborts"]),
        str(row["decision_errors"]),
        str(row["misleading"]),
        _number(row["nearest_m"], 2),
    )


def above_table_v(row: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return deviations of the ready phase above Table V of the bench paper: name, largest of all cases, paper's."""
    return [
        (f"{name} {axis}", f"{cell['value']:.3g}", f"{cell['table_v']:.3g}")
        for name, cells in row["worst"].items()
        for axis, cell in zip("xyz", cells, strict=True)
        if cell["table_v"] is not None and cell["value"] is not None and cell["value"] > cell["table_v"]
    ]


def rows_and_ideals(content: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows, and after each what physics leaves of its misses, if that was flown."""
    return [each for row in content["rows"] for each in (row, *row.get("ideal", {}).values())]


def page_of(content: dict[str, Any]) -> str:
    """Return the page of the numbers of ``hil.parts.campaigns.api.benchmark.fly``."""
    gnc = ", ".join(f"{key} = {value}" for key, value in content["gnc"].items()) or "the GNC of each scenario"
    body = [
        html.heading(1, "Benchmark"),
        html.paragraph(f"{gnc}. {content['runs']} cases per row, seed {content['seed']}."),
        html.paragraph(MEANING),
        html.table(HEAD, [cells_of(row) for row in rows_and_ideals(content)], "Campaigns"),
        html.paragraph(f"{content['cycle_us']:.1f} us a cycle of scheme 1, with plant and mock devices, on one core."),
    ]
    deviations = [(row["row"], *cells) for row in rows_and_ideals(content) for cells in above_table_v(row)]
    if deviations:
        columns = ("row", "deviation in the ready phase", "largest of all cases", "Table V")
        body.append(html.table(columns, deviations, "Above Table V, m, m/s, deg, deg/s"))
    if "against" in content:
        rows = [
            (
                row["row"],
                str(row["cases"]),
                str(row["only_first"]),
                str(row["only_second"]),
                "-" if row["saved_kg"] is None else f"{1e3 * row['saved_kg']:+.1f}",
            )
            for row in content["against"]["rows"]
        ]
        head = ("row", "cases", "accepted here alone", "accepted there alone", "propellant saved, g, median")
        body.append(html.table(head, rows, f"Case by case against {content['against']['folder']}"))
    body.append(html.folded("Numbers", json.dumps(content, indent=1)))
    return html.page("Benchmark", body)
