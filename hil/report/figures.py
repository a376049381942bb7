"""Figures of a recorded run, as SVG: figures 5 to 8 of the bench paper, NIS, lateness, bench error."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.gnc.estimation.filter_monitor import WINDOWS, nis_band
from hil.gnc.estimation.integrity import LEVEL_TERMS
from hil.gnc.integrity_verdict import stanford
from hil.loop.overrun_monitor import lateness_histogram
from hil.params import integrity as integrity_params
from hil.params.ready import tolerances
from hil.report.bench_error import pose_errors
from hil.report.limits import TERMS
from hil.report.verdict import Verdict, deviations
from hil.report.verdict_parts import attitude_error

COLOURS = ("#0072b2", "#d55e00", "#009e73")  # distinguishable for the colour-blind
POINTS = 1500  # per line: more are not visible
_WIDTH_IN = 11.0
_TAIL = 0.005  # probability that the mean NIS is beyond either side of its band
ROWS = (
    ("position_m", "distance, m", ("x - {0.axial_distance_m:g} m", "y", "z")),
    ("velocity_mps", "rate, m/s", ("x", "y", "z")),
    ("attitude_deg", "angle, deg", ("theta1", "theta2", "theta3")),
    ("rate_degps", "angular rate, deg/s", ("omega1", "omega2", "omega3")),
)


class RunFigure(Figure):
    """Figure that a notebook displays without pyplot and its choice of a window system."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png")
        return file.getvalue()


def thin(t_s: Array, values: Array) -> tuple[Array, Array]:
    """Return a line of at most ``POINTS`` points that keeps the extremes of each stretch."""
    n = len(values)
    if n <= POINTS:
        return t_s, values
    length = -(-n // (POINTS // 2))
    stretches = np.nan_to_num(np.pad(values, (0, -n % length), "edge")).reshape(-1, length)
    begin = length * np.arange(len(stretches))
    chosen = np.unique([begin + stretches.argmin(axis=1), begin + stretches.argmax(axis=1)])
    return t_s[chosen], values[chosen]


def figures(history: np.ndarray, scenario: Scenario, rig: Rig, verdict: Verdict) -> Iterator[tuple[str, str]]:
    """Yield title and image (a ``data:`` address) of each figure for which the run has data."""
    yield "Truth against the ready state (bench paper figures 6 and 7)", svg_address(motion(history, scenario, verdict))
    valid = history[history["navigation"]["valid"] == 1]
    if len(valid):
        yield "Estimation error and 3 sigma (bench paper figure 5)", svg_address(_estimate(valid))
    updates = valid[np.isfinite(valid["navigation"]["nis_position"])]
    if len(updates) > WINDOWS[0]:
        yield "Normalised innovations squared and the band of their mean", svg_address(_nis(updates))
    if np.isfinite(valid["navigation"]["protection_level_m"]).any():
        yield "Integrity: error against protection level (Stanford diagram)", svg_address(_stanford(valid, scenario))
        yield "Integrity: protection levels over their alert limits, and the largest term", svg_address(_levels(valid))
    yield "Thruster firings (bench paper figure 8)", svg_address(firings(history, scenario))
    yield "Security: margins of the estimate", svg_address(_security(history))
    rows, distance, angle = pose_errors(history, scenario, rig)
    if len(rows):
        yield "Bench: camera against the truth, by the encoders", svg_address(_bench(rows["t_s"], distance, angle))
    yield "Lateness of the cycles", svg_address(_lateness(history["lateness_s"]))


def svg_address(figure: Figure) -> str:
    """Return ``figure`` as a ``data:`` address; the same run gives the same bytes."""
    file = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "hil"}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(file.getvalue()).decode()}"


def axes_of(rows: int, columns: int, height_in: float, **keywords: Any) -> tuple[Figure, Any]:
    """Return a figure of ``rows`` x ``columns`` axes, and these as an array."""
    figure = RunFigure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **keywords)


def line(plot: Any, t_s: Array, values: Array, **keywords: Any) -> None:
    """Draw a line that keeps the extremes of ``values`` (n,)."""
    plot.plot(*thin(t_s, values), linewidth=0.9, **keywords)


def motion(history: np.ndarray, scenario: Scenario, verdict: Verdict) -> Figure:
    """Return the truth against the ready state (bench paper figures 6 and 7) of ``history``, (n,) of CYCLE, n > 0."""
    requirements = scenario.requirements
    deviation, allowed = deviations(history, requirements), tolerances(requirements)
    figure, axes = axes_of(4, 2, 9.5, width_ratios=(2, 1))
    last_s = float(deviation.t_s[-1])
    for row, (key, label, names) in enumerate(ROWS):
        whole, close = axes[row]
        for plot in (whole, close):
            for i, name in enumerate(each.format(requirements) for each in names):
                line(plot, deviation.t_s, getattr(deviation, key)[:, i], color=COLOURS[i], label=name)
            if verdict.ready_time_s is not None:
                plot.axvline(verdict.ready_time_s, color="0.4", linestyle=":", linewidth=1)
        whole.set_ylabel(label)
        whole.legend(loc="upper right", ncols=3, fontsize=8)
        least = allowed[key].min()
        close.axhspan(-least, least, color="0.93", zorder=0)
        for i in np.flatnonzero(allowed[key] > least).tolist():
            close.hlines((-allowed[key][i], allowed[key][i]), 0.0, last_s, COLOURS[i], linestyles="--", linewidth=0.8)
        close.set_ylim(-1.3 * allowed[key].max(), 1.3 * allowed[key].max())
        begin_s = max(0.0, (verdict.ready_time_s if verdict.ready_time_s is not None else last_s - 60.0) - 20.0)
        close.set_xlim(begin_s, max(last_s, begin_s + scenario.step_s))
    axes[0, 0].set_title("whole run; dotted: ready", loc="left", fontsize=10)
    axes[0, 1].set_title("at the end; grey, dashed: Table III", loc="left", fontsize=10)
    for plot in axes[3]:
        plot.set_xlabel("time, s")
    return figure


def _estimate(rows: np.ndarray) -> Any:
    figure, axes = axes_of(3, 3, 6.5, sharex=True)
    truth, estimate = rows["truth"], rows["navigation"]
    for column, (title, unit, error, sigma) in enumerate(
        (
            ("position", "mm", 1e3 * (truth["r_CT_H"] - estimate["r_CT_H"]), 1e3 * estimate["sigma_r_m"]),
            ("velocity", "mm/s", 1e3 * (truth["v_CT_H"] - estimate["v_CT_H"]), 1e3 * estimate["sigma_v_mps"]),
            ("attitude", "deg", np.degrees(attitude_error(rows)), np.degrees(estimate["sigma_attitude_rad"])),
        )
    ):
        for i in range(3):
            plot = axes[i, column]
            band(plot, rows["t_s"], 3.0 * sigma[:, i])
            line(plot, rows["t_s"], error[:, i], color=COLOURS[i])
            late = len(rows) // 20
            extent = np.abs(np.concatenate([error[late:, i], np.nan_to_num(3.0 * sigma[late:, i])])).max()
            if extent > 0.0 and np.isfinite(extent):
                plot.set_ylim(-1.2 * extent, 1.2 * extent)
            plot.set_ylabel(f"{'xyz'[i]}, {unit}")
        axes[0, column].set_title(f"{title}, grey: 3 sigma", loc="left", fontsize=10)
        axes[2, column].set_xlabel("time, s")
    return figure


def band(plot: Any, t_s: Array, half: Array) -> None:
    """Draw a grey band of ``half`` (n,) to either side of zero."""
    if np.isfinite(half).any():
        t_s, half = thin(t_s, half)
        plot.fill_between(t_s, -half, half, color="0.88", linewidth=0)


def _nis(updates: np.ndarray) -> Any:
    figure, axes = axes_of(2, 1, 4.5, sharex=True)
    window = WINDOWS[0]
    low, high = nis_band(window, _TAIL)
    for plot, key, name in zip(axes[:, 0], ("nis_position", "nis_attitude"), ("position", "attitude"), strict=True):
        nis, t_s = updates["navigation"][key], updates["t_s"]
        plot.plot(t_s, nis, ".", markersize=1.5, color="0.6", rasterized=len(nis) > POINTS)
        mean = np.convolve(np.nan_to_num(nis), np.ones(window) / window, "valid")
        plot.axhspan(low, high, color="0.9", zorder=0)
        line(plot, t_s[window - 1 :], mean, color=COLOURS[0], label=f"mean of {window}")
        plot.set_ylim(0.0, 16.0)
        plot.set_ylabel(f"NIS {name}")
        plot.legend(loc="upper right", fontsize=8)
    axes[1, 0].set_xlabel("time, s")
    return figure


def _stanford(rows: np.ndarray, scenario: Scenario) -> Any:
    errors, levels, limits = np.empty((3, len(rows), 3))
    stanford(integrity_params.integrity(scenario), rows.view(np.ndarray), errors, levels, limits)
    figure, axes = axes_of(1, 3, 4.0)
    for i, (plot, name) in enumerate(zip(axes[0], ("along the docking axis", "across it", "attitude"), strict=True)):
        with np.errstate(divide="ignore", invalid="ignore"):
            draw_stanford(plot, errors[:, i] / limits[:, i], levels[:, i] / limits[:, i])
        plot.set_title(name, loc="left", fontsize=10)
    return figure


def draw_stanford(plot: Any, error: Array, level: Array) -> None:
    """Draw protection levels over errors (n,), both relative to the alert limit; red: hazardously misleading."""
    least, most = 1e-3, 1e1
    every = max(1, len(error) // POINTS)
    x, y = (np.clip(values[::every], least, most) for values in (error, level))
    plot.loglog(x, y, ".", markersize=2, color=COLOURS[0], rasterized=len(x) > POINTS // 2)
    plot.fill_between([1.0, most], least, 1.0, color=COLOURS[1], alpha=0.25, linewidth=0)
    plot.fill_between([least, most], 1.0, most, color="0.9", linewidth=0, zorder=0)
    plot.plot([least, most], [least, most], color="0.4", linewidth=0.8)
    plot.set_xlim(least, most)
    plot.set_ylim(least, most)
    plot.set_xlabel("error / alert limit")
    plot.set_ylabel("protection level / alert limit")


def _levels(rows: np.ndarray) -> Figure:
    """Draw level over limit of each alert limit, and the largest term of the one that is nearest, over time."""
    figure, axes = axes_of(2, 1, 5.0, sharex=True, height_ratios=(2, 1))
    share, term = axes[:, 0]
    supervision, t_s = rows["supervision"], rows["t_s"]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = supervision["level"] / supervision["alert_limit"]
    for i, name in enumerate(("along", "across", "attitude")):
        values = np.where(np.isfinite(shares[:, i]), shares[:, i], np.nan)
        line(share, t_s, values, color=COLOURS[i], label=name)
    share.axhline(1.0, color="0.4", linestyle="--", linewidth=0.9)
    share.set_yscale("log")
    share.set_ylabel("level / alert limit")
    share.legend(loc="upper right", fontsize=8)
    term.step(t_s, supervision["level_term"], where="post", color=COLOURS[0], linewidth=0.9)
    term.set_yticks(range(LEVEL_TERMS + 1), ("unknown", *TERMS[1 : LEVEL_TERMS + 1]))
    term.set_ylabel("largest term")
    term.set_xlabel("time, s")
    return figure


def firings(history: np.ndarray, scenario: Scenario) -> Figure:
    """Return the openings of each thruster, numbered from 1, and the time with demands."""
    n = len(scenario.chaser.thrusters.position_m)
    figure, axes = axes_of(2, 1, 6.0, sharex=True, height_ratios=(2, 1))
    raster, sums = axes[:, 0]
    t_s, step_s = history["t_s"], scenario.step_s
    for number in range(1, n + 1):
        on = np.concatenate([[0], history["command"]["on"][:, number - 1], [0]])
        begins, ends = np.flatnonzero(np.diff(on) == 1), np.flatnonzero(np.diff(on) == -1)
        spans = [(t_s[a], max(step_s, t_s[b - 1] - t_s[a] + step_s)) for a, b in zip(begins, ends, strict=True)]
        raster.broken_barh(spans, (number - 0.4, 0.8), color=COLOURS[0], linewidth=0.5)
    raster.set_ylim(0.3, n + 0.7)
    raster.set_yticks(range(1, n + 1))
    raster.tick_params(axis="y", labelsize=8)
    raster.set_ylabel("thruster")
    for i, kind in enumerate(("force", "torque")):
        spent = step_s * np.cumsum(np.abs(history["command"][kind]).sum(axis=1))
        line(sums, t_s, spent, color=COLOURS[i], label=f"{kind} demand, all axes")
    sums.set_ylabel("time on, s")
    sums.legend(loc="upper left", fontsize=8)
    sums.set_xlabel("time, s")
    return figure


def _security(history: np.ndarray) -> Any:
    figure, axes = axes_of(1, 2, 2.6)
    for plot, key, label in zip(
        axes[0], ("corridor_margin_m", "closing_margin_mps"), ("corridor, m", "closing rate, m/s"), strict=True
    ):
        line(plot, history["t_s"], history["supervision"][key], color=COLOURS[0])
        plot.axhline(0.0, color=COLOURS[1], linewidth=1)
        plot.set_ylabel(label)
        plot.set_xlabel("time, s")
    return figure


def _bench(t_s: Array, distance: Array, angle: Array) -> Any:
    figure, axes = axes_of(1, 2, 2.6)
    for plot, values, label in zip(axes[0], (1e3 * distance, np.degrees(angle)), ("mm", "deg"), strict=True):
        line(plot, t_s, values, color=COLOURS[0])
        plot.set_ylabel(f"camera error, {label}")
        plot.set_xlabel("time, s")
    return figure


def _lateness(lateness_s: Array) -> Any:
    figure, axes = axes_of(1, 1, 2.6)
    bins = lateness_histogram(lateness_s)
    labels = [f"< {b['below_us']}" if b["below_us"] is not None else "more" for b in bins]
    axes[0, 0].bar(range(len(bins)), [b["cycles"] for b in bins], color=COLOURS[0])
    axes[0, 0].set_xticks(range(len(bins)), labels, fontsize=7)
    axes[0, 0].set_yscale("symlog")
    axes[0, 0].set_xlabel("lateness, us")
    axes[0, 0].set_ylabel("cycles")
    return figure
