"""Printed results of ``hil calibrate``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from hil.cli.output import say
from hil.core.messages import Array
from hil.vmu.calibration.board import one_sided
from hil.vmu.calibration.job import CalibrationOutcome, DriftCheck, DriftLimits
from hil.vmu.calibration.model import Parameter, parameters
from hil.vmu.calibration.report import found_numbers, led_differences
from hil.vmu.calibration.single_camera import CameraFit
from hil.vmu.kernels.chain import COMMON


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    for k, column in enumerate(columns):
        table.add_column(column, justify="right" if k else "left", no_wrap=True)
    return table


def _shown(value: float, sigma: float) -> tuple[str, str]:
    """Return both, rounded according to the standard deviation."""
    digits = next((d for d in range(9) if sigma >= 2.0 * 10.0**-d), 8)
    return f"{value:.{digits}f}", f"{sigma:.{digits}f}"


def print_outcome(outcome: CalibrationOutcome, console: Console) -> None:
    """Print a calibration."""
    solved, fit = outcome.solved, outcome.solved.fit
    used = solved.observations
    numbers = _table("Estimates", "", "value", "sigma", "nominal", "unit")
    last = ""
    for parameter, value, sigma, paper in found_numbers(outcome):
        part = parameter.name.partition(".")[0]
        if last and part != last and not (part.startswith("led_") and last.startswith("led_")):
            numbers.add_section()
        last = part
        _add_number(numbers, parameter, value, sigma, paper)
    console.print(numbers)
    if (leds := led_differences(outcome)) is not None:
        console.print(_led_table(*leds))
    ranges = _table("Position of a point measured by both cameras, 1 sigma, mm", "range m", "noise: across", "depth")
    ranges.add_column("calibration: across", justify="right")
    ranges.add_column("depth", justify="right")
    for error in outcome.at_ranges:
        noise = (f"{error.noise_across_mm:.3f}", f"{error.noise_depth_mm:.3f}")
        ranges.add_row(
            f"{error.range_m:g}", *noise, f"{error.calibration_across_mm:.3f}", f"{error.calibration_depth_mm:.3f}"
        )
    console.print(ranges)

    def show(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True, markup=True)

    covered = ", ".join(f"{side} {100 * s:.0f} %" for side, s in zip(("left", "right"), outcome.shares, strict=True))
    show(
        f"{len(used.names)} views, {int(used.visible.sum())} points, residuals {fit.rms_px:.3f} px"
        f" RMS, noise {outcome.sigma_px:.3f} px; images covered: {covered}"
    )
    if outcome.halves is not None:
        half = outcome.halves
        show(
            f"two halves of the views differ by {half.across_mm:.2f} mm across and {half.depth_mm:.2f} mm in depth at "
            f"{half.range_m:g} m, expected {half.sigma_across_mm:.2f} and {half.sigma_depth_mm:.2f} mm"
        )
    if not outcome.is_hand_held:
        show(f"rail errors: {fit.axis_ratio[0]:.2f}, gimbal errors: {fit.axis_ratio[1]:.2f} of the assumed sigma")
    if solved.spots_left_out:
        show(f"{solved.spots_left_out} spots rejected: inconsistent with the rest of their view")
    for name, why in solved.left_out.items():
        show(f"rejected  {name}: {why}")
    if alone := one_sided(used):
        show(f"of one camera alone: {', '.join(f'{name} ({side})' for name, side in alone.items())}")
    for warning in outcome.warnings:
        show(f"warning   {warning}")
    for check in outcome.checks:
        word = "ok  " if check.passed else "FAIL"
        show(f"{word}      {check}")
    show(f"{'[bold green]PASS[/]' if outcome.passed else '[bold red]FAIL[/]'} {outcome.label.id}")


def _led_table(off_mm: Array, sigma_mm: Array) -> Table:
    table = _table("LEDs against the nominal layout, mm", "LED", "x", "y", "z", "distance", "sigma")
    for led, (off, sigma) in enumerate(zip(off_mm, sigma_mm, strict=True)):
        cells = (f"{value:+.3f}" for value in off)
        table.add_row(str(led), *cells, f"{np.linalg.norm(off):.3f}", f"{np.linalg.norm(sigma):.3f}")
    return table


def _add_number(table: Table, parameter: Parameter, value: float, sigma: float, paper: float) -> None:
    shown, spread = _shown(value, sigma)
    table.add_row(parameter.name, shown, spread, f"{paper:g}", parameter.unit)


def print_camera(fit: CameraFit, title: str, nominal: Sequence[float], console: Console) -> None:
    """Print the calibration of one camera. nominal: fx, fy, cx, cy, px."""
    table = _table(title, "number", "value", "sigma", "nominal", "unit")
    values = (*fit.focal_px, *fit.centre_px)
    for name, value, sigma, given in zip(("fx", "fy", "cx", "cy"), values, fit.sigma_px, nominal, strict=True):
        table.add_row(name, *_shown(float(value), float(sigma)), f"{given:g}", "px")
    console.print(table)
    for name, why in fit.left_out.items():
        say(f"rejected  {name}: {why}", console)
    say(
        f"{len(fit.used)} images, residuals {fit.rms_px:.3f} px RMS; pixels {fit.aspect:.5f} times as high as wide, "
        f"distortion at the corners up to {fit.corner_px:.2f} px",
        console,
    )


def print_check(checked: DriftCheck, limits: DriftLimits, console: Console) -> None:
    """Print a drift check."""
    drift, stored = checked.drift, checked.stored

    show = partial(say, console=console)
    table = _table(
        f"Against {stored.label.id} of {stored.label.date}", "part", "chi-square", "numbers", "chance", "shift px"
    )
    for e in drift.explanations:
        table.add_row(e.part, f"{e.square:.1f}", str(e.freedom), f"{e.chance:.1e}", f"{e.shift_px:.3f}")
    console.print(table)
    show(
        f"{drift.views} views, {drift.points} points: residuals {drift.rms_px:.3f} px RMS,"
        f" noise {drift.noise:.2f} times that of the calibration"
    )
    if checked.lost:
        show(f"not used  {', '.join(checked.lost)}: the target is not visible or not at its expected position")
    best = drift.explanations[0]
    significant = drift.chance < limits.alarm
    if significant:
        show(
            f"drift     {' or '.join(drift.alike)} moved (by chance: {drift.chance:.1e}, alarm below {limits.alarm:g})"
        )
        told = parameters(len(stored.setup.points) if len(best.change) > COMMON else 0)
        moved = sorted(
            (
                (abs(c / s), p, c * p.shown, s * p.shown)
                for p, c, s in zip(told, best.change, best.sigma, strict=True)
                if s
            ),
            key=lambda row: -row[0],
        )
        for _, p, change, sigma in moved[:3]:
            show(f"          {p.name} by {change:+.4g} +- {sigma:.2g} {p.unit}")
        show(
            f"          shifts the pixels by {best.shift_px:.3f} px RMS, allowed {limits.drift_px:g};"
            f" a point at {checked.range_m:g} m by {checked.across_mm:.3f} mm across,"
            f" {checked.depth_mm:.3f} mm in depth"
        )
    else:
        show(f"no drift  (by chance: {drift.chance:.2f}, alarm below {limits.alarm:g})")
    show(f"{'ok  ' if drift.rms_px <= limits.rms_px else 'FAIL'}      residuals, allowed {limits.rms_px:g} px")
    show(f"{'[bold red]FAIL[/]' if checked.refusal(limits)[0] else '[bold green]PASS[/]'} {stored.label.id}")
