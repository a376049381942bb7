"""Figures of a campaign: distributions of the outcomes, and outcomes along a sweep."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hil.config.scenario import Scenario
from hil.params.ready import ROW_NAMES, tolerances
from hil.parts.campaigns.statistics import wilson
from hil.parts.campaigns.store import Store, atomic_write
from hil.report.figures import RunFigure, draw_stanford
from hil.report.limits import LIMITS
from hil.report.verdict import TABLE_V

_MOST_POINTS = 2000  # points of a curve
_PANELS = (
    ("ready_time_s", "ready at, s"),
    ("propellant_kg", "propellant, kg"),
    ("firings", "firings"),
    ("control_margin", "least margin to Table III"),
    ("closing_margin_mps", "closing-rate margin, m/s"),
)


Column = Callable[[str], Any]
"""Returns a column of the cases by its name, (n,)."""


def draw_percentiles(store: Store, scenario: Scenario, path: Path) -> None:
    """Draw ``percentiles_figure`` of the cases in ``store`` into ``path``."""
    with atomic_write(path) as partial:
        percentiles_figure(store.column, scenario).savefig(partial, dpi=110, format="png")


def percentiles_figure(column: Column, scenario: Scenario) -> Figure:
    """Return the distributions over the cases of ``scenario``.

    The percentage of cases below each value, with the 5th, 50th and 95th percentile; and the deviations of the ready
    phase relative to Table III, with the worst of the paper's Table V if it has the scenario.
    """
    figure = RunFigure(figsize=(11.0, 6.5), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for plot, (name, label) in zip(axes, _PANELS, strict=False):
        _curve(plot, _finite(column, name), label)
    _deviations(axes[5], column, scenario)
    figure.suptitle(f"{scenario.name}, {len(column('case'))} cases")
    return figure


def draw_integrity(store: Store, path: Path) -> None:
    """Draw ``stanford_figure`` of the cases in ``store`` into ``path``, if their GNC reports protection levels."""
    if np.isfinite(np.asarray(store.column("protection_level_m"), dtype=float)).any():
        with atomic_write(path) as partial:
            stanford_figure(store.column).savefig(partial, dpi=110, format="png")


def stanford_figure(column: Column) -> Figure:
    """Return the Stanford diagram of the cases: each at its largest position error relative to the alert limit."""
    error, limit, level = (
        np.asarray(column(name), dtype=float) for name in ("worst_error_m", "alert_limit_m", "protection_level_m")
    )
    finite = np.isfinite(level) & (limit > 0.0)
    figure = RunFigure(figsize=(5.5, 5.0), layout="constrained")
    plot = figure.subplots()
    draw_stanford(plot, error[finite] / limit[finite], level[finite] / limit[finite])
    plot.set_title(f"{np.count_nonzero(finite)} cases, each at its largest error", loc="left", fontsize=10)
    return figure


def _finite(column: Column, name: str) -> Any:
    values = np.asarray(column(name), dtype=float)
    return values[np.isfinite(values)]


def _deviations(plot: Any, column: Column, scenario: Scenario) -> None:
    """Draw worst and median deviation of each cell of Table III, in percent of its tolerance."""
    cells = [(row, i) for row in ROW_NAMES for i in range(3)]
    allowed = tolerances(scenario.requirements)
    paper = TABLE_V.get(scenario.name)
    y = np.arange(len(cells))
    worst, median, published = np.full((3, len(cells)), np.nan)
    for k, (row, i) in enumerate(cells):
        unit = 100.0 / allowed[row][i]
        values = _finite(column, f"{row}_{'xyz'[i]}")
        if len(values):
            worst[k], median[k] = unit * values.max(), unit * float(np.median(values))
        if paper is not None:
            published[k] = unit * getattr(paper, row)[i]
    plot.barh(y, np.nan_to_num(worst), label="worst", color="#a6c8e4")
    plot.barh(y, np.nan_to_num(median), label="median", color="C0", height=0.35)
    if paper is not None:
        plot.plot(published, y, "D", color="C1", markersize=4, label="Table V")
    plot.set_yticks(y, [f"{row.split('_')[0]} {'xyz'[i]}" for row, i in cells], fontsize=7)
    plot.invert_yaxis()
    plot.set_xlim(left=0.0)
    plot.set_xlabel("deviation, % of Table III")
    plot.legend(fontsize=7, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)


def _curve(plot: Any, values: Any, label: str) -> None:
    plot.set_xlabel(label)
    plot.set_ylabel("percentage of cases")
    if not len(values):
        plot.text(0.5, 0.5, "none", ha="center", transform=plot.transAxes)
        return
    plot.locator_params(axis="x", nbins=4)
    plot.xaxis.set_major_formatter("{x:.5g}")
    percent = np.linspace(0.0, 100.0, min(len(values), _MOST_POINTS))
    plot.plot(np.percentile(values, percent), percent)
    for mark in (5.0, 50.0, 95.0):
        plot.axvline(float(np.percentile(values, mark)), color="0.7", linewidth=0.8)


def draw_sweep(sweep: dict[str, Any], path: Path) -> None:
    """Draw ``sweep_figure`` into ``path``."""
    with atomic_write(path) as partial:
        sweep_figure(sweep).savefig(partial, dpi=110, format="png")


def sweep_figure(sweep: Mapping[str, Any]) -> Figure:
    """Return rate of accepted cases and propellant along the sweep, with their intervals."""
    figure = Figure(figsize=(8.0, 5.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    points = sweep["points"]
    x = [point["value"] for point in points]
    rate = np.array([[point["accepted_rate"][k] for k in ("low", "rate", "high")] for point in points]) * 100.0
    above.fill_between(x, rate[:, 0], rate[:, 2], alpha=0.3)
    above.plot(x, rate[:, 1], marker="o")
    above.set_ylabel("accepted, %")
    spent = np.array([[point["propellant_kg"][k] for k in ("low", "mean", "high")] for point in points], dtype=float)
    below.fill_between(x, spent[:, 0], spent[:, 2], alpha=0.3)
    below.plot(x, spent[:, 1], marker="o")
    below.set_ylabel("propellant, kg")
    below.set_xlabel(sweep["key"])
    return figure


def margins_figure(column: Column) -> Figure:
    """Return the least margins of the cases relative to their limits: least, 5 to 95 %, median."""
    rows = []
    for name in LIMITS:
        margin, limit = (np.asarray(column(f"margin_{name}{part}"), dtype=float) for part in ("", "_limit"))
        finite = np.isfinite(margin) & (np.abs(limit) > 0.0)
        if finite.any():
            share = margin[finite] / np.abs(limit[finite])
            rows.append((name, float(share.min()), *np.percentile(share, (5.0, 50.0, 95.0))))
    rows.sort(key=lambda row: row[2])
    figure = RunFigure(figsize=(8.0, 1.0 + 0.24 * len(rows)), layout="constrained")
    plot = figure.subplots()
    for y, (_, least, low, median, high) in enumerate(rows):
        colour = "C3" if low < 0.0 else "C0"
        plot.plot([max(-1.0, low), high], [y, y], color=colour, linewidth=5, alpha=0.4, solid_capstyle="butt")
        plot.plot([median], [y], "|", color=colour, markersize=9)
        plot.plot([max(-1.0, least)], [y], "x", color=colour, markersize=4)
    plot.axvline(0.0, color="0.3", linewidth=0.8)
    plot.set_xlim(-1.05, 1.55)
    plot.set_yticks(range(len(rows)), [row[0] for row in rows], fontsize=8)
    plot.invert_yaxis()
    plot.set_xlabel("margin / limit: 5 to 95 % of the cases, median |, least x (not below -1)")
    return figure


_BINS = 12


def dependence_figure(name: str, values: Any, accepted: Any) -> Figure:
    """Return the fraction of ``accepted`` cases (n,) in bins of ``values`` (n,) of equal number, with intervals."""
    finite = np.isfinite(values)
    order = np.argsort(values[finite], kind="stable")
    x, good = values[finite][order], accepted[finite][order]
    figure = RunFigure(figsize=(6.0, 3.0), layout="constrained")
    plot = figure.subplots()
    parts = [part for part in np.array_split(np.arange(len(x)), _BINS) if len(part)]
    centre = [float(np.median(x[part])) for part in parts]
    rates = [wilson(int(good[part].sum()), len(part)) for part in parts]
    low, rate, high = (100.0 * np.array([each[key] for each in rates]) for key in ("low", "rate", "high"))
    plot.fill_between(centre, low, high, alpha=0.3)
    plot.plot(centre, rate, marker="o")
    plot.set_xlabel(name)
    plot.set_ylabel("accepted, %")
    plot.set_ylim(-3.0, 103.0)
    return figure


def draw_indices(summary: dict[str, Any], path: Path) -> None:
    """Draw the ten largest total Sobol' indices of each outcome, with the first-order ones, into ``path``."""
    outcomes = summary["sobol"]
    figure = Figure(figsize=(11.0, 2.4 * len(outcomes)), layout="constrained")
    for plot, (outcome, rows) in zip(np.atleast_1d(figure.subplots(len(outcomes), 1)), outcomes.items(), strict=True):
        shown = [row for row in rows if row["total"]["index"] is not None][:10]
        y = np.arange(len(shown))
        for kind, height, colour in (("total", 0.8, "#a6c8e4"), ("first", 0.35, "C0")):
            index = np.array([row[kind]["index"] for row in shown], dtype=float)
            ends = np.array([[row[kind]["low"], row[kind]["high"]] for row in shown], dtype=float).reshape(-1, 2)
            error = np.maximum(0.0, np.abs(ends - index[:, None]).T)
            label = "first order" if kind == "first" else kind
            plot.barh(y, index, height=height, xerr=error, color=colour, error_kw={"elinewidth": 0.8}, label=label)
        plot.set_yticks(y, [row["dispersion"] for row in shown], fontsize=7)
        plot.invert_yaxis()
        plot.set_title(outcome, loc="left", fontsize=10)
        plot.legend(fontsize=7)
    with atomic_write(path) as partial:
        figure.savefig(partial, dpi=110, format="png")
