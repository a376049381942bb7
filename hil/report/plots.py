"""Plots of a run by name, as a thesis has them: trajectory, NEES, thrusters, attitude, and the ready phase."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.gnc.approach_monitor import corridor_radius
from hil.params import gnc as gnc_params
from hil.report import figures
from hil.report.consistency import NO_NEES, Nees, nees_of
from hil.report.figures import COLOURS, axes_of, band, line
from hil.report.verdict import Verdict, deviations
from hil.report.verdict_parts import attitude_error

_ANGLES: Final = ("theta1, roll", "theta2, pitch", "theta3, yaw")


def trajectory(history: np.ndarray, scenario: Scenario, _verdict: Verdict) -> Figure:
    """Return the path in H with its corridor, from above and from the side, and position and velocity over time.

    The corridor is about the lines of the phases, its radius that at the range of the reference.
    """
    figure, axes = axes_of(2, 2, 7.5)
    truth, reference, estimate = (history[name]["r_CT_H"] for name in ("truth", "reference", "navigation"))
    valid = history["navigation"]["valid"] == 1
    corridor = gnc_params.approach_monitor(scenario)
    distances = np.sqrt((reference * reference).sum(axis=1))
    radius = np.array([corridor_radius(corridor, distance) for distance in distances])
    for plot, axis in zip(axes[0], (1, 2), strict=True):
        for side in (-1.0, 1.0):
            label = "corridor" if side > 0.0 else None
            plot.plot(reference[:, 0], reference[:, axis] + side * radius, color="0.75", linewidth=0.9, label=label)
        plot.plot(reference[:, 0], reference[:, axis], color="0.5", linestyle="--", linewidth=0.9, label="reference")
        plot.plot(truth[:, 0], truth[:, axis], color=COLOURS[0], linewidth=1.1, label="truth")
        plot.plot(estimate[valid, 0], estimate[valid, axis], color=COLOURS[1], linewidth=0.6, label="estimate")
        plot.plot(*truth[0, [0, axis]], "o", color=COLOURS[0], markersize=5, label="start")
        plot.plot(*truth[-1, [0, axis]], "s", color=COLOURS[0], markersize=5, label="end")
        plot.set_xlabel("x in H, m")
        plot.set_ylabel(f"{'xyz'[axis]} in H, m")
        plot.grid(visible=True, linewidth=0.3)
    axes[0, 0].legend(loc="best", fontsize=8)
    for plot, key, label in zip(axes[1], ("r_CT_H", "v_CT_H"), ("position, m", "velocity, m/s"), strict=True):
        _over_time(plot, history, history["truth"][key], history["reference"][key], "xyz", label)
    return figure


def attitude(history: np.ndarray, scenario: Scenario, _verdict: Verdict) -> Figure:
    """Return angles and reference over time, and the error of the estimate with 3 sigma."""
    figure, axes = axes_of(3, 2, 7.5, sharex=True)
    truth, reference = (_angles_deg(history, name, scenario) for name in ("truth", "reference"))
    rows = history[history["navigation"]["valid"] == 1]
    error, sigma = np.degrees(attitude_error(rows)), np.degrees(rows["navigation"]["sigma_attitude_rad"])
    for i, name in enumerate(_ANGLES):
        whole, estimate = axes[i]
        line(whole, history["t_s"], reference[:, i], color="0.5", linestyle="--", label="reference")
        line(whole, history["t_s"], truth[:, i], color=COLOURS[i], label="truth")
        whole.set_ylabel(f"{name}, deg")
        whole.legend(loc="best", fontsize=8)
        if len(rows):
            band(estimate, rows["t_s"], 3.0 * sigma[:, i])
            line(estimate, rows["t_s"], error[:, i], color=COLOURS[i])
        estimate.set_ylabel("deg")
    axes[0, 0].set_title("angles of the chaser against H", loc="left", fontsize=10)
    axes[0, 1].set_title("error of the estimate about x, y, z of c, grey: 3 sigma", loc="left", fontsize=10)
    for plot in axes[2]:
        plot.set_xlabel("time, s")
    return figure


def errors(history: np.ndarray, _scenario: Scenario, _verdict: Verdict) -> Figure:
    """Return the errors of the estimate of position and velocity in H, with 3 sigma as the navigation states them."""
    figure, axes = axes_of(3, 2, 7.5, sharex=True)
    rows = history[history["navigation"]["valid"] == 1]
    truth, estimate = rows["truth"], rows["navigation"]
    names = (("r_CT_H", "sigma_r_m", "m"), ("v_CT_H", "sigma_v_mps", "m/s"))
    for column, (name, sigma, unit) in enumerate(names):
        for i in range(3):
            if len(rows):
                band(axes[i, column], rows["t_s"], 3.0 * estimate[sigma][:, i])
                line(axes[i, column], rows["t_s"], estimate[name][:, i] - truth[name][:, i], color=COLOURS[i])
            axes[i, column].set_ylabel(f"{'xyz'[i]}, {unit}")
        axes[2, column].set_xlabel("time, s")
    axes[0, 0].set_title("error of the estimate of position in H, grey: 3 sigma", loc="left", fontsize=10)
    axes[0, 1].set_title("of velocity", loc="left", fontsize=10)
    return figure


def nees(history: np.ndarray, scenario: Scenario, _verdict: Verdict) -> Figure:
    """Return the NEES of both filters at each pose, with the bounds of a single value and the expected mean."""
    figure, axes = axes_of(2, 1, 5.5, sharex=True)
    of_poses = nees_of(history, scenario.chaser.planar)
    for plot, name, states in zip(axes[:, 0], ("position", "attitude"), of_poses.states, strict=True):
        values, (low, high) = getattr(of_poses, name), getattr(of_poses, f"{name}_bounds")
        plot.axhspan(low, high, color="0.9", zorder=0, label=f"{100.0 * of_poses.probability:g} % of one value")
        plot.axhline(states, color="0.4", linestyle="--", linewidth=0.9, label=f"expected mean, {states}")
        plot.plot(of_poses.t_s, values, ".", markersize=2, color=COLOURS[0], rasterized=len(values) > figures.POINTS)
        plot.set_ylabel(f"NEES {name}, {states} states")
        plot.set_title(_inside(of_poses, name), loc="left", fontsize=10)
        shown = values[np.isfinite(values)]
        plot.set_ylim(0.0, max(1.6 * high, float(np.quantile(shown, 0.99)) * 1.1 if len(shown) else 0.0))
        plot.legend(loc="upper right", fontsize=8)
    axes[1, 0].set_xlabel("time, s")
    return figure


def _inside(of_poses: Nees, name: str) -> str:
    values = getattr(of_poses, name)
    known = values[np.isfinite(values)]
    if not len(known):
        return f"no NEES: {NO_NEES}"
    share = 100.0 * of_poses.inside(name)
    return f"mean of all poses {known.mean():.2f}, {share:.1f} % of {len(known)} values in the bounds"


def _angles_deg(history: np.ndarray, name: str, scenario: Scenario) -> Array:
    """Return the angles of the attitude ``name`` against the ready state's, (n, 3), deg."""
    rows = history.copy()
    rows["truth"]["q_CH"] = history[name]["q_CH"]
    return deviations(rows, scenario.requirements).attitude_deg


def _over_time(plot: Any, history: np.ndarray, truth: Array, reference: Array, names: str, label: str) -> None:
    for i, name in enumerate(names):
        line(plot, history["t_s"], reference[:, i], color="0.5", linestyle="--")
        line(plot, history["t_s"], truth[:, i], color=COLOURS[i], label=name)
    plot.set_ylabel(f"{label}, dashed: reference")
    plot.set_xlabel("time, s")
    plot.legend(loc="best", ncols=3, fontsize=8)


def difference(first: np.ndarray, second: np.ndarray, scenario: Scenario) -> Figure:
    """Return position and attitude of two truths, histories (n,) and (m,) of CYCLE, and the second minus the first."""
    n = min(len(first), len(second))
    a, b = (deviations(history[:n], scenario.requirements) for history in (first, second))
    figure, axes = axes_of(2, 2, 6.5, sharex=True)
    for row, (key, label, names) in zip(axes, figures.ROWS[:4:2], strict=True):
        for i, name in enumerate(names):
            of_a, of_b = getattr(a, key)[:, i], getattr(b, key)[:, i]
            line(row[0], a.t_s, of_a, color=COLOURS[i], label=name.format(scenario.requirements))
            line(row[0], a.t_s, of_b, color=COLOURS[i], linestyle="--")
            line(row[1], a.t_s, of_b - of_a, color=COLOURS[i])
        row[0].set_ylabel(label)
        row[1].set_ylabel(f"difference of {label}")
        row[0].legend(loc="upper right", fontsize=8)
    axes[0, 0].set_title("truth against the ready state; dashed: second", loc="left", fontsize=10)
    axes[0, 1].set_title("second minus first", loc="left", fontsize=10)
    for plot in axes[1]:
        plot.set_xlabel("time, s")
    return figure


def thrusters(history: np.ndarray, scenario: Scenario, _verdict: Verdict) -> Figure:
    """Return the openings of each thruster, and the time with demands."""
    return figures.firings(history, scenario)


PLOTS: Final[dict[str, Callable[[np.ndarray, Scenario, Verdict], Figure]]] = {
    "ready": figures.motion,
    "trajectory": trajectory,
    "errors": errors,
    "attitude": attitude,
    "nees": nees,
    "thrusters": thrusters,
}
"""Name -> function of the records (n,) of CYCLE, n > 0, of the scenario and of the verdict."""
