"""Figure of the authority: forces and torques that the thrusters can give together, as polygons in three planes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.maths import elementary
from hil.params.gnc import allocation, wrenches_of

_PLANES = ((0, 1), (0, 2), (1, 2))


def polygon(vectors: Array) -> Array:
    """Return the corners, (m, 2), in order, of all sums of parts from 0 to 1 of ``vectors`` (n, 2): a zonogon."""
    upper = np.where((vectors[:, 1] > 0.0) | ((vectors[:, 1] == 0.0) & (vectors[:, 0] > 0.0)), 1.0, -1.0)[:, None]
    edges = vectors * upper  # each from the lower side to the upper one
    edges = edges[np.argsort([elementary.atan2(y, x) for x, y in edges])]
    lowest = vectors[upper[:, 0] < 0.0].sum(axis=0)
    corners: Array = lowest + np.concatenate(
        [np.zeros((1, 2)), np.cumsum(edges, axis=0), edges.sum(axis=0) - np.cumsum(edges, axis=0)]
    )
    return corners


def authority_figure(scenario: Scenario) -> Figure:
    """Return the figure: forces, then torques, with what the demands of single axes give as dots."""
    wrenches, (sets, _) = wrenches_of(scenario.chaser.thrusters), allocation(scenario.chaser)
    demands = np.array(
        [wrenches[sets[axis, sign, : len(wrenches)] != 0].sum(axis=0) for axis in range(6) for sign in (0, 1)]
    )
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    for row, (first, unit) in enumerate(((0, "N"), (3, "N m"))):
        for column, (a, b) in enumerate(_PLANES):
            plot = figure.add_subplot(2, 3, 3 * row + column + 1)
            corners = polygon(wrenches[:, [first + a, first + b]])
            plot.fill(corners[:, 0], corners[:, 1], color="#0072b2", alpha=0.2)
            plot.plot(corners[:, 0], corners[:, 1], color="#0072b2", linewidth=0.9)
            plot.plot(demands[:, first + a], demands[:, first + b], "o", color="#d55e00", markersize=4)
            plot.set_xlabel(f"{'force' if row == 0 else 'torque'} {'xyz'[a]}, {unit}")
            plot.set_ylabel(f"{'xyz'[b]}, {unit}")
            plot.set_aspect("equal", adjustable="datalim")
            plot.grid(visible=True, linewidth=0.3)
    return figure
