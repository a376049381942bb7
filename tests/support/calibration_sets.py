"""Simulated observations for the tests of the calibration."""

from __future__ import annotations

import numpy as np

from hil.config.rig import Rig
from hil.vmu.calibration.board import Board
from hil.vmu.calibration.model import PARTS, Observations, Setup, TurntableModel
from hil.vmu.calibration.refine import layout_basis
from hil.vmu.geometry import geometry_of_rig
from hil.vmu.kernels.chain import COMMON
from tests.support.calibration_views import observe, plan

AXIS_SIGMA = np.array([5e-5] * 3 + [np.radians(0.005)] * 3)
PIXEL_SIGMA = 0.05
BOARD = Board(9, 6, 0.04)


def on_paper(rig: Rig, on_leds: bool) -> Setup:
    """Return cameras, mounting and target as the rig file has them."""
    return Setup.of(geometry_of_rig(rig), rig.bench, None if on_leds else BOARD.points())


def as_made(paper: Setup, rng: np.random.Generator, on_leds: bool) -> Setup:
    """Return what a workshop made of it."""
    spread = np.zeros(COMMON)
    for part in ("left", "right"):
        spread[PARTS[part]] = (10.0, 10.0, 8.0, 8.0, 0.05, 0.02, 5e-4, 5e-4, 0.0)
    spread[PARTS["stereo"]] = (5e-3, 5e-3, 5e-3, 2e-3, 2e-3, 2e-3)
    spread[PARTS["mounting"]] = 0.01
    spread[PARTS["target"]] = 0.01 if on_leds else 0.2
    change = spread * rng.standard_normal(COMMON)
    if not on_leds:
        return paper.moved(change)
    basis = layout_basis(paper.points)
    return paper.moved(change, (basis @ (basis.T @ rng.normal(0.0, 5e-4, paper.points.size))).reshape(-1, 3))


def leds_seen(truth: Setup, turntable: TurntableModel, rng: np.random.Generator, views: int = 24) -> Observations:
    """Return observations of the LEDs from all over the bench."""
    axes = plan(truth, turntable, views, (0.6, 4.0), 20.0, rng, 0.25)
    return observe(truth, turntable, axes, AXIS_SIGMA, PIXEL_SIGMA, rng)


def board_seen(truth: Setup, turntable: TurntableModel, rng: np.random.Generator, views: int = 20) -> Observations:
    """Return observations of the board from near, those that show it whole."""
    axes = plan(truth, turntable, views, (0.9, 1.6), 20.0, rng, 0.15)
    seen = observe(truth, turntable, axes, AXIS_SIGMA, PIXEL_SIGMA, rng)
    return seen.only(np.flatnonzero(seen.visible.all(axis=(1, 2))))
