"""Pictures of a campaign: how outcomes spread, and how they move along a sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hil.campaign.store import Store, whole_or_not_at_all
from hil.report.verdict import ROW_NAMES

_MOST_POINTS = 2000  # of a curve
_PANELS = (
    ("ready_time_s", "ready at, s"),
    ("propellant_kg", "propellant, kg"),
    ("firings", "firings"),
    ("control_margin", "least margin to Table III"),
    ("closing_margin_mps", "closing-rate margin, m/s"),
)


def draw_percentiles(store: Store, title: str, path: Path) -> None:
    """Draw the share of cases below each value, with the 5th, 50th and 95th percentile, into ``path``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 6.5), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for place, (name, label) in zip(axes, _PANELS, strict=False):
        values = np.asarray(store.column(name), dtype=float)
        _curve(place, values[np.isfinite(values)], label)
    worst = np.array([_greatest(store, row, axis) for row in ROW_NAMES for axis in "xyz"])
    labels = [f"{row.split('_')[0]} {axis}" for row in ROW_NAMES for axis in "xyz"]
    axes[5].barh(np.arange(12), np.nan_to_num(worst))
    axes[5].set_yticks(np.arange(12), labels, fontsize=7)
    axes[5].invert_yaxis()
    if (worst > 0.0).any():
        axes[5].set_xscale("log")
    axes[5].set_xlabel("worst deviation, m, m/s, deg, deg/s")
    figure.suptitle(title)
    with whole_or_not_at_all(path) as partial:
        figure.savefig(partial, dpi=110, format="png")


def _greatest(store: Store, row: str, axis: str) -> float:
    values = store.column(f"{row}_{axis}")
    return float(np.nanmax(values)) if np.isfinite(values).any() else np.nan


def _curve(place: Any, values: Any, label: str) -> None:
    place.set_xlabel(label)
    place.set_ylabel("share of cases, %")
    if not len(values):
        place.text(0.5, 0.5, "none", ha="center")
        return
    shares = np.linspace(0.0, 100.0, min(len(values), _MOST_POINTS))
    place.plot(np.percentile(values, shares), shares)
    for share in (5.0, 50.0, 95.0):
        place.axvline(float(np.percentile(values, share)), color="0.7", linewidth=0.8)


def draw_sweep(found: dict[str, Any], path: Path) -> None:
    """Draw pass rate and propellant along the sweep, with their intervals, into ``path``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    points = found["points"]
    x = [point["value"] for point in points]
    rate = np.array([[point["pass_rate"][k] for k in ("low", "rate", "high")] for point in points]) * 100.0
    above.fill_between(x, rate[:, 0], rate[:, 2], alpha=0.3)
    above.plot(x, rate[:, 1], marker="o")
    above.set_ylabel("pass, %")
    spent = np.array([[point["propellant_kg"][k] for k in ("low", "mean", "high")] for point in points], dtype=float)
    below.fill_between(x, spent[:, 0], spent[:, 2], alpha=0.3)
    below.plot(x, spent[:, 1], marker="o")
    below.set_ylabel("propellant, kg")
    below.set_xlabel(found["key"])
    with whole_or_not_at_all(path) as partial:
        figure.savefig(partial, dpi=110, format="png")
