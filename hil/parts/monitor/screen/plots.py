"""Plots over the portions so far: the values of the monitor paper's Fig. 5 and the sigmas of its Fig. 6.

As in the paper only the vertices are results; the lines between them are interrupted if a quantity
was not observable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.parts.monitor.results import QUANTITIES, Portion
from hil.parts.monitor.screen import drawing
from hil.parts.monitor.screen.drawing import Canvas

Floats = NDArray[np.float64]

_DEG: Final = 180.0 / math.pi
_LEFT, _RIGHT, _ABOVE, _BELOW = 62, 10, 24, 20  # margins of a plot, px
_COLOURS: Final = (drawing.ORANGE, drawing.SKY, drawing.YELLOW)
_CLOSEST_MARKS_PX: Final = 6.0


@dataclass(frozen=True)
class Curve:
    """A quantity in a plot: its column, the axis unit per SI unit, its name next to the mark."""

    quantity: str
    unit: float
    name: str


@dataclass(frozen=True)
class Plot:
    """A plot of values, or with ``sigmas`` of their standard deviations on a logarithmic axis."""

    title: str
    curves: tuple[Curve, ...]
    sigmas: bool = False


_RANGE = (Curve("range_m", 1.0, ""),)
_RATE = (Curve("range_rate_mps", 1.0, ""),)
_PASSIVE = (Curve("pitch_passive_rad", _DEG, "pitch"), Curve("yaw_passive_rad", _DEG, "yaw"))
_ACTIVE = (Curve("phi1_rad", _DEG, "pitch"), Curve("phi2_rad", _DEG, "yaw"), Curve("phi3_rad", _DEG, "roll"))

PLOTS: Final = (
    Plot("range, m", _RANGE),
    Plot("its sigma, m", _RANGE, sigmas=True),
    Plot("range rate, m/s", _RATE),
    Plot("its sigma, m/s", _RATE, sigmas=True),
    Plot("passive angles, deg", _PASSIVE),
    Plot("their sigmas, deg", _PASSIVE, sigmas=True),
    Plot("active angles, deg", _ACTIVE),
    Plot("their sigmas, deg", _ACTIVE, sigmas=True),
)


def ticks(low: float, high: float, at_most: int) -> Floats:
    """Return round numbers, 1, 2 or 5 times a power of ten apart, within low to high, at most ``at_most``."""
    raw = (high - low) / max(at_most, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0, 20.0) if factor * power >= raw * (1.0 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return np.arange(first, last + 1, dtype=float) * step


def _label(value: float) -> str:
    return f"{value:.6g}" if value else "0"


class History:
    """The portions so far, as columns."""

    def __init__(self) -> None:
        self._rows: list[Floats] = []

    def add(self, portion: Portion) -> None:
        """Append a portion."""
        self._rows.append(np.concatenate(([portion.t_s], portion.values, portion.sigmas)))

    def __len__(self) -> int:
        return len(self._rows)

    def columns(self, quantity: str) -> tuple[Floats, Floats, Floats]:
        """Return times, values and sigmas, (n,) each, SI."""
        rows = np.array(self._rows).reshape(len(self._rows), -1)
        column = 1 + QUANTITIES.index(quantity)
        return rows[:, 0], rows[:, column], rows[:, column + len(QUANTITIES)]


@dataclass(frozen=True)
class _Axes:
    """Ranges of a plot's axes and the size of its canvas."""

    t: tuple[float, float]
    y: tuple[float, float]
    width: int
    height: int

    def points(self, t: Floats, y: Floats) -> Floats:
        """Return u, v (n, 2), px."""
        across = (t - self.t[0]) / (self.t[1] - self.t[0])
        up = np.clip((y - self.y[0]) / (self.y[1] - self.y[0]), -1.0, 2.0)
        inner_width, inner_height = self.width - _LEFT - _RIGHT, self.height - _ABOVE - _BELOW
        pixels: Floats = np.column_stack((_LEFT + across * inner_width, _ABOVE + (1.0 - up) * inner_height))
        return pixels


def draw(canvas: Canvas, plot: Plot, history: History) -> None:
    """Draw ``plot`` of ``history`` over the entire ``canvas`` (h, w, 3)."""
    canvas[:] = drawing.PAPER
    drawing.text(canvas, plot.title, _LEFT, 16, drawing.WHITE, 0.42)
    series = [_series(plot, curve, history) for curve in plot.curves] if len(history) else []
    axes = _axes(plot, series, canvas.shape[1], canvas.shape[0])
    _draw_frame(canvas, plot, axes)
    for number, (curve, (t, y, sigma)) in enumerate(zip(plot.curves, series, strict=False)):
        colour = _COLOURS[number]
        if curve.name:
            u = canvas.shape[1] - _RIGHT - 62.0 * (len(plot.curves) - number) + 8.0
            drawing.mark(canvas, number, u, 12.0, colour)
            drawing.text(canvas, curve.name, u + 7.0, 16.0, colour, 0.4)
        for run in _runs(y):
            _draw_run(canvas, axes, t[run], y[run], None if plot.sigmas else sigma[run], number)


def _series(plot: Plot, curve: Curve, history: History) -> tuple[Floats, Floats, Floats]:
    t, value, sigma = history.columns(curve.quantity)
    if not plot.sigmas:
        return t, value * curve.unit, sigma * curve.unit
    spread = np.where(sigma > 0.0, sigma, np.nan) * curve.unit
    return t, np.log10(spread), spread


def _axes(plot: Plot, series: list[tuple[Floats, Floats, Floats]], width: int, height: int) -> _Axes:
    times = [t for t, _, _ in series if len(t)]
    last = max((float(t[-1]) for t in times), default=1.0)
    first = min((float(t[0]) for t in times), default=0.0)
    span = max(last - min(first, 0.0), 1.0)
    extents = [_extent(plot, y, sigma) for _, y, sigma in series]
    every = np.concatenate(extents) if extents else np.empty(0)
    if not len(every):
        return _Axes(
            (min(first, 0.0), min(first, 0.0) + span), (-3.0, 0.0) if plot.sigmas else (0.0, 1.0), width, height
        )
    low, high = float(every.min()), float(every.max())
    if plot.sigmas:
        low, high = math.floor(low - 0.05), math.ceil(high + 0.05)
    else:
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        half = max(1.12 * half, 1e-3 * abs(middle), 1e-4)
        low, high = middle - half, middle + half
    return _Axes((min(first, 0.0), min(first, 0.0) + span), (low, high), width, height)


def _extent(plot: Plot, y: Floats, sigma: Floats) -> Floats:
    """Return the values that the axis of ``y`` must cover: the bands, with unusually wide ones limited."""
    finite = np.isfinite(y) & np.isfinite(sigma)
    if plot.sigmas or not finite.any():
        return y[np.isfinite(y)]
    half = 2.0 * np.minimum(sigma[finite], 2.0 * np.median(sigma[finite]))
    return np.concatenate((y[finite] - half, y[finite] + half))


def _draw_frame(canvas: Canvas, plot: Plot, axes: _Axes) -> None:
    bottom, right = axes.height - _BELOW, axes.width - _RIGHT
    rows = ticks(*axes.y, 4)
    if plot.sigmas:
        rows = np.unique(np.rint(rows))
    for value in rows:
        _, v = axes.points(np.array([axes.t[0]]), np.array([value]))[0]
        drawing.line(canvas, np.array([[_LEFT, v], [right, v]]), drawing.DIM)
        drawing.text_right(canvas, _label(10.0**value if plot.sigmas else value), _LEFT - 4, v + 4, drawing.GREY, 0.36)
    for value in ticks(*axes.t, 6):
        u, _ = axes.points(np.array([value]), np.array([axes.y[0]]))[0]
        drawing.line(canvas, np.array([[u, _ABOVE], [u, bottom]]), drawing.DIM)
        drawing.text_right(canvas, _label(value) + " s", u + 12, bottom + 13, drawing.GREY, 0.36)
    drawing.line(canvas, np.array([[_LEFT, _ABOVE], [_LEFT, bottom], [right, bottom]], float), drawing.GREY)


def _runs(y: Floats) -> list[slice]:
    """Return the intervals without a gap."""
    finite = np.concatenate(([False], np.isfinite(y), [False]))
    edges = np.flatnonzero(finite[1:] != finite[:-1])
    return [slice(start, stop) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def _draw_run(canvas: Canvas, axes: _Axes, t: Floats, y: Floats, sigma: Floats | None, number: int) -> None:
    inside = canvas[_ABOVE : axes.height - _BELOW, _LEFT : axes.width - _RIGHT + 4]
    corner = np.array([_LEFT, _ABOVE])
    points = axes.points(t, y) - corner
    if sigma is not None and len(t) > 1 and np.isfinite(sigma).all():
        upper, lower = axes.points(t, y + 2.0 * sigma) - corner, axes.points(t, y - 2.0 * sigma) - corner
        drawing.band(inside, upper, lower, _COLOURS[number], 0.3)
    drawing.line(inside, points, _COLOURS[number])
    spacing = (points[-1, 0] - points[0, 0]) / max(len(points) - 1, 1)
    every = max(1, math.ceil(_CLOSEST_MARKS_PX / spacing)) if spacing > 0.0 else 1
    for u, v in points[::every]:
        drawing.mark(inside, number, u, v, _COLOURS[number])
