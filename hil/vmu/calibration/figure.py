"""Figure of a calibration: residuals over both images, the views, and accuracy over range."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np

from hil.core.messages import Array
from hil.vmu.calibration import quality
from hil.vmu.calibration.job import CalibrationOutcome
from hil.vmu.calibration.model import SIDES
from hil.vmu.calibration.report import led_differences

_BLUE, _ORANGE, _GREEN, _GREY = "#0072b2", "#d55e00", "#009e73", "0.6"  # distinguishable with colour blindness


def draw(outcome: CalibrationOutcome, path: str) -> None:
    """Draw ``outcome`` into ``path`` (PNG, PDF or SVG)."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    leds = led_differences(outcome)
    figure, axes = plt.subplots(2, 2, figsize=(11, 9), constrained_layout=True)
    for side in range(2):
        _residuals(outcome, side, axes[0, side])
    _views(outcome, axes[1, 0])
    if leds is None:
        _ranges(outcome, axes[1, 1])
    else:
        _ring(outcome.nominal.points, *leds, axes[1, 1])
    word = "PASS" if outcome.passed else "FAIL"
    figure.suptitle(f"{outcome.label.id}, {outcome.label.date}, from {outcome.label.target}: {word}", fontsize=11)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _residuals(outcome: CalibrationOutcome, side: int, plot: Any) -> None:
    observed, fit = outcome.solved.observations, outcome.solved.fit
    mask = observed.visible[:, side]
    at, off = observed.pixels[:, side][mask], fit.residuals[:, side][mask]
    width, height = fit.setup.sizes[side]
    stretch = 0.04 * width / max(float(np.hypot(*off.T).max(initial=0.0)), 1e-6)
    stretch = float(f"{stretch:.0e}")
    plot.quiver(*at.T, *(stretch * off.T), angles="xy", scale_units="xy", scale=1.0, width=0.002, color=_BLUE)
    plot.set_xlim(-0.5, width - 0.5)
    plot.set_ylim(height - 0.5, -0.5)
    plot.set_aspect("equal")
    share = 100.0 * outcome.shares[side]
    plot.set_title(f"{SIDES[side]}: residuals x {stretch:g}, image covered to {share:.0f} %", loc="left", fontsize=10)
    plot.set_xlabel("u, px")
    plot.set_ylabel("v, px")


def _views(outcome: CalibrationOutcome, plot: Any) -> None:
    fit, names = outcome.solved.fit, outcome.solved.observations.names
    rms = np.sqrt(np.nanmean(np.square(fit.residuals), axis=(1, 2, 3)))
    plot.bar(np.arange(len(names)), rms, color=_BLUE)
    plot.axhline(fit.rms_px, color=_ORANGE, linewidth=1.0)
    step = max(1, len(names) // 12)
    plot.set_xticks(np.arange(len(names))[::step], names[::step], rotation=90, fontsize=8)
    out = ", ".join(outcome.solved.left_out) or "none"
    out = out if len(out) < 60 else f"{len(outcome.solved.left_out)} views"
    plot.set_title(f"RMS of each view (line: of all); left out: {out}", loc="left", fontsize=10)
    plot.set_ylabel("px")


def _ring(nominal: Array, off_mm: Array, sigma_mm: Array, plot: Any) -> None:
    """Draw the LEDs as the cameras see them head-on, with numbers and enlarged differences from the nominal layout."""
    reach = 1e3 * float(np.ptp(nominal[:, :2], axis=0).max())
    stretch = float(f"{0.1 * reach / max(float(np.abs(off_mm).max()), 1e-3):.0e}")
    at_mm = 1e3 * nominal[:, :2]
    plot.plot(*at_mm.T, "o", color=_GREY)
    plot.quiver(*at_mm.T, *(stretch * off_mm[:, :2].T), angles="xy", scale_units="xy", scale=1.0, color=_ORANGE)
    for led, (at, off, sigma) in enumerate(zip(at_mm, off_mm, sigma_mm, strict=True)):
        text = f"  {led}: {np.linalg.norm(off):.2f} +- {np.linalg.norm(sigma):.2f}, z {off[2]:+.2f}"
        plot.annotate(text, at, fontsize=8)
    plot.set_xlim(at_mm[:, 0].min() - 0.2 * reach, at_mm[:, 0].max() + 0.6 * reach)
    plot.set_ylim(at_mm[:, 1].max() + 0.2 * reach, at_mm[:, 1].min() - 0.2 * reach)
    plot.set_aspect("equal")
    plot.set_title(f"LEDs by number: difference from the nominal layout, mm (x {stretch:g})", loc="left", fontsize=10)
    plot.set_xlabel("x of the ring, mm")
    plot.set_ylabel("y of the ring, mm")


def _ranges(outcome: CalibrationOutcome, plot: Any) -> None:
    setup, covariance = outcome.solved.fit.setup, outcome.solved.fit.covariance
    reach = np.geomspace(0.4, 12.0, 25)
    ranges = [f for r in reach if (f := quality.at_range(setup, covariance, outcome.sigma_px, float(r))) is not None]
    for name, label, colour, style in (
        ("noise_across_mm", "one measurement, across", _GREY, "--"),
        ("noise_depth_mm", "one measurement, depth", _GREY, "-"),
        ("calibration_across_mm", "calibration, across", _GREEN, "--"),
        ("calibration_depth_mm", "calibration, depth", _GREEN, "-"),
    ):
        plot.loglog([f.range_m for f in ranges], [getattr(f, name) for f in ranges], style, color=colour, label=label)
    plot.set_title("position of one point visible to both cameras, 1 sigma", loc="left", fontsize=10)
    plot.set_xlabel("range, m")
    plot.set_ylabel("mm")
    plot.grid(True, which="both", linewidth=0.3)
    plot.legend(fontsize=8)
