"""Accuracy of calibration and drift check: errors relative to reported sigmas over many simulated sets.

    python -m sims.calibration_study [SETS [LEDs] [board]]

Every set has other cameras, mounting, target and noise. Exit code 1 if an error is inconsistent with its sigma, or a
drift is missed or reported wrongly.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import Rotation

from hil.config.load import load_rig
from hil.core.messages import Array
from hil.vmu.calibration.board import Board
from hil.vmu.calibration.drift import check
from hil.vmu.calibration.files import Label, StoredCalibration
from hil.vmu.calibration.model import PARTS, Setup, TurntableModel
from hil.vmu.calibration.refine import RefinementFit, RefinementProblem, layout_basis, weak_prior
from hil.vmu.calibration.solve import robust_fit
from hil.vmu.geometry import geometry_of_rig
from hil.vmu.kernels.chain import COMMON, SCALE
from tests.support.calibration_views import observe, plan, shifted

AXIS_SIGMA = np.array([5e-5] * 3 + [np.radians(0.005)] * 3)
PIXEL_SIGMA = 0.05
BOARD = Board(11, 8, 0.03)
DRIFTS: dict[str, dict[str, object]] = {
    "none": {},
    "baseline 0.1 mm": {"BASELINE": [1e-4, 0.0, 0.0]},
    "right camera turned 0.02 deg": {"ROTATION": [0.0, np.radians(0.02), 0.0]},
    "mounting 0.05 deg about x": {"CAMERA_ROTATION": [np.radians(0.05), 0.0, 0.0]},
    "mounting 0.05 deg about y": {"CAMERA_ROTATION": [0.0, np.radians(0.05), 0.0]},
    "mounting 0.05 deg about z": {"CAMERA_ROTATION": [0.0, 0.0, np.radians(0.05)]},
    "left lens 1 px": {"LEFT": [0.0, 0.0, 1.0]},
    "right focal length 0.1 %": {"RIGHT": [1.2, 1.2]},
    "ring 1 mm": {"TARGET_POSITION": [0.0, 1e-3, 0.0]},
}
MUST_FIND = ("baseline", "mounting")


@dataclass(frozen=True)
class Kind:
    """Kind of calibration: number of views, ranges, and number of views for the check."""

    name: str
    on_leds: bool
    views: int
    range_m: tuple[float, float]
    views_of_check: int
    range_of_check_m: tuple[float, float]


KINDS = (
    Kind("LEDs", True, 40, (0.6, 5.0), 8, (0.6, 2.0)),
    Kind("board", False, 20, (0.7, 1.5), 8, (0.7, 1.5)),
)


def main(words: list[str]) -> int:
    sets = int(words[0]) if words else 50
    kinds = [kind for kind in KINDS if kind.name in words[1:] or not words[1:]]
    console = Console()
    good = True
    for kind in kinds:
        errors, found = [], {name: [] for name in DRIFTS}
        for seed in track(range(sets), kind.name, console=Console(stderr=True), transient=True):
            one, checks = one_set(kind, seed)
            errors.append(one)
            for name, result in checks.items():
                found[name].append(result)
        good &= print_errors(kind, np.array(errors), console)
        good &= print_drifts(kind, found, console)
    return 0 if good else 1


def one_set(kind: Kind, seed: int) -> tuple[Array, dict[str, tuple[bool, str, float]]]:
    """Return errors over sigmas, and for each drift: detected or not, the part that moved, and the shift in pixels."""
    rig = load_rig("mock").value
    turntable = TurntableModel.of(rig.bench)
    rng = np.random.default_rng(seed)
    paper = Setup.of(geometry_of_rig(rig), rig.bench, None if kind.on_leds else BOARD.points())
    truth = made(paper, kind, rng)
    axes = plan(truth, turntable, kind.views, kind.range_m, 20.0, rng, 0.25)
    seen = observe(truth, turntable, axes, AXIS_SIGMA, PIXEL_SIGMA, rng)
    held = weak_prior(paper, (), AXIS_SIGMA, 1e-3 if kind.on_leds else 0.0, 0.0 if kind.on_leds else 1e-3)
    fit = RefinementProblem(seen, turntable, held, paper.points).solve(robust_fit(seen, paper, turntable, held))
    label = Label("study", "", "leds" if kind.on_leds else "board")
    known = StoredCalibration(label, fit.setup, turntable, fit.covariance, fit.noise, AXIS_SIGMA)
    checks = {name: checked(known, truth, kind, change, rng) for name, change in DRIFTS.items()}
    return in_sigmas(fit, truth, kind), checks


def made(paper: Setup, kind: Kind, rng: np.random.Generator) -> Setup:
    """Return cameras, mounting, target and layout with random workshop tolerances."""
    spread = np.zeros(COMMON)
    for part in ("left", "right"):
        spread[PARTS[part]] = (10.0, 10.0, 10.0, 10.0, 0.05, 0.02, 5e-4, 5e-4, 0.01)
    spread[PARTS["stereo"]] = (5e-3, 5e-3, 5e-3, 2e-3, 2e-3, 2e-3)
    spread[PARTS["mounting"]] = 0.01
    spread[PARTS["target"]] = 0.01
    basis = layout_basis(paper.points)
    layout = (basis @ (basis.T @ rng.normal(0.0, 5e-4, paper.points.size))).reshape(-1, 3) if kind.on_leds else None
    return paper.moved(spread * rng.standard_normal(COMMON), layout)


def in_sigmas(fit: RefinementFit, truth: Setup, kind: Kind) -> Array:
    """Return the errors of all estimated parameters over their sigmas."""
    error = fit.setup.theta - truth.theta
    for part, mine, other in (
        ("mounting", fit.setup.camera_axes, truth.camera_axes),
        ("target", fit.setup.target_axes, truth.target_axes),
    ):
        error[PARTS[part].start : PARTS[part].start + 3] = Rotation.from_matrix(mine @ other.T).as_rotvec()
    if kind.on_leds:
        error = np.concatenate([error, (fit.setup.points - truth.points).ravel()])
    return np.where(fit.sigma > 0.0, error / np.where(fit.sigma > 0.0, fit.sigma, 1.0), np.nan)


def checked(
    known: StoredCalibration, truth: Setup, kind: Kind, change: dict[str, object], rng: np.random.Generator
) -> tuple[bool, str, float]:
    today = shifted(truth, **{name: np.array(values) for name, values in change.items()})
    axes = plan(truth, known.turntable, kind.views_of_check, kind.range_of_check_m, 15.0, rng, 0.25)
    seen = observe(today, known.turntable, axes, AXIS_SIGMA, PIXEL_SIGMA, rng)
    setup = known.setup
    if not kind.on_leds:
        keep = ("left", "right", "stereo", "mounting")
        setup = robust_fit(seen, setup, known.turntable, weak_prior(setup, keep, AXIS_SIGMA, 0.0, 0.0))
    found = check(known, seen, setup, not kind.on_leds)
    return found.chance < 1e-3, found.explanations[0].part, found.explanations[0].shift_px


def print_errors(kind: Kind, errors: Array, console: Console) -> bool:
    table = Table(title=f"{kind.name}: errors over reported sigmas, {len(errors)} sets", title_justify="left")
    for name in ("part", "RMS", "within 2 sigma, %"):
        table.add_column(name, justify="left" if name == "part" else "right")
    places = {**PARTS, "scale": slice(SCALE, COMMON), "layout of LEDs": slice(COMMON, None), "all": slice(None)}
    good = True
    for name, place in places.items():
        part = errors[:, place]
        part = part[np.isfinite(part)]
        if part.size:
            ratio, inside = float(np.sqrt(np.mean(part**2))), 100.0 * float(np.mean(np.abs(part) < 2.0))
            table.add_row(name, f"{ratio:.3f}", f"{inside:.1f}")
            good = good and (name != "all" or (0.93 < ratio < 1.07 and 93.0 < inside < 97.5))
    console.print(table)
    return good


def print_drifts(kind: Kind, found: dict[str, list[tuple[bool, str, float]]], console: Console) -> bool:
    table = Table(title=f"{kind.name}: check of {kind.views_of_check} views on a later day", title_justify="left")
    for name in ("drift", "found, %", "part named first", "shift, px"):
        table.add_column(name, justify="right" if name in ("found, %", "shift, px") else "left")
    good = True
    for name, results in found.items():
        share = float(np.mean([hit for hit, _, _ in results]))
        named = Counter(part for hit, part, _ in results if hit).most_common(2)
        shift = float(np.mean([px for _, _, px in results]))
        table.add_row(name, f"{100 * share:.0f}", ", ".join(f"{part} {count}" for part, count in named), f"{shift:.3f}")
        if name == "none":
            good = good and share <= 0.02
        elif name.startswith(MUST_FIND):
            good = good and share >= 0.95
    console.print(table)
    return good


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
