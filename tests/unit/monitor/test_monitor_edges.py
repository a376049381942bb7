"""Measured edge positions, and consistency of their variances with the scatter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from hil.config.load import load_scene
from hil.config.scene import PixelNoise, Scene
from hil.models import docking_view
from hil.parts.monitor.features import ACROSS, DISC, UPRIGHT, target_features
from hil.parts.monitor.kernels import edge_samples, edges, pose
from hil.parts.monitor.kernels.edge_samples import EDGE_SAMPLE
from hil.parts.monitor.render import Conditions, TargetRenderer

Floats = np.ndarray


@pytest.fixture(scope="module")
def atv() -> Scene:
    """Return the shipped ATV-like scene."""
    return load_scene("atv").value


def fitted(
    scene: Scene, image: np.ndarray, at: Floats, blur: float, noise: Floats, wide_bar: float = 7.0
) -> np.ndarray:
    """Return the measured samples of ``image`` at the pose ``at`` (6,)."""
    of = target_features(scene.camera, scene.target)
    found, sums = np.zeros(1000, EDGE_SAMPLE), np.zeros(2)
    a = docking_view.attitude(at[3:])
    count = edge_samples.place_edge_samples(
        of.lens, a, at[:3].copy(), of.circles, of.lines, of.borders, blur, 8.0, 96, wide_bar * blur, 4.5, found
    )
    edges.fit_edge_samples(image, 0.0, 1.0, found, count, blur, noise, 2, sums)
    return found[:count][found["good"][:count] == 1]


@pytest.mark.parametrize("d3", [2.0, 6.0, 12.0])
def test_edges_are_found_where_the_geometry_has_them(atv: Scene, d3: float) -> None:
    """Blur and the pixels' own width move no edge: not a round one, not one of a thin bar.

    Rolled, so that the edges pass the pixels at all phases: the renderer blurs after the pixels' integration, which
    leaves 0.02 px of ripple on edges along the lines.
    """
    at = np.array([0.031 * d3, -0.024 * d3, d3, -0.02, -0.03, 0.3])
    renderer = TargetRenderer(atv, conditions=Conditions(blur_px=0.8, noise=PixelNoise(read=0.5)))
    rng = np.random.default_rng(3)
    total: dict[int, list[float]] = {}
    for _ in range(4):
        image = renderer.image(at[:3], at[3:], 0.0, rng)
        found = fitted(atv, image, at, np.hypot(0.8, np.sqrt(1.0 / 12.0)), np.array([0.34, 0.0]))
        for feature in np.unique(found["feature"]):
            total.setdefault(int(feature), []).extend(found["shift"][found["feature"] == feature])
    for feature in (DISC, ACROSS, UPRIGHT):
        assert abs(np.mean(total[feature])) < 3e-3, feature
    assert np.sqrt(np.mean(np.square(np.concatenate(list(total.values()))))) < 0.02


@pytest.mark.parametrize("read", [1.5, 6.0])
def test_variances_of_edges_are_those_of_their_scatter(atv: Scene, read: float) -> None:
    """The scatter of the shifts over many noisy images matches each one's variance."""
    at = np.array([0.2, -0.1, 7.0, -0.01, -0.01, 0.3])
    renderer = TargetRenderer(atv, conditions=Conditions(blur_px=0.8, noise=PixelNoise(read=read, k=0.05)))
    clean = renderer.draw(at[:3], at[3:])
    rng = np.random.default_rng(11)
    ratios = []
    for _ in range(12):
        image = renderer.expose(clean, at[:3], at[3:], 0.0, rng)
        found = fitted(atv, image, at, np.hypot(0.8, np.sqrt(1.0 / 12.0)), np.array([read**2 + 1.0 / 12.0, 0.05]))
        ratios.append(found["shift"] ** 2 / found["variance"])
    assert np.mean(np.concatenate(ratios)) == pytest.approx(1.0, abs=0.08)


def test_errors_of_neighbouring_cells_are_independent(atv: Scene) -> None:
    """No pixel belongs to two samples of an edge, so their errors do not go together."""
    at = np.array([0.2, -0.1, 4.0, -0.01, -0.01, 0.03])
    renderer = TargetRenderer(atv, conditions=Conditions(noise=PixelNoise(read=3.0)))
    clean = renderer.draw(at[:3], at[3:])
    rng = np.random.default_rng(12)
    rows = []
    for _ in range(40):
        image = renderer.expose(clean, at[:3], at[3:], 0.0, rng)
        found = fitted(atv, image, at, 0.85, np.array([9.1, 0.0]))
        disc = found[found["feature"] == DISC]
        rows.append(disc["shift"][:40] / np.sqrt(disc["variance"][:40]))
    scaled = np.array(rows) - np.mean(rows, axis=0)
    assert abs(np.mean(scaled[:, 1:] * scaled[:, :-1])) < 0.08


def test_a_shifted_pose_is_found_again(atv: Scene) -> None:
    """Gauss-Newton with the exact projection brings a pose some tenths of a pixel off back to the truth."""
    at = np.array([0.2, -0.3, 5.0, -0.08, -0.06, 0.1])
    renderer = TargetRenderer(atv, conditions=Conditions(noise=PixelNoise(read=1.0)))
    image = renderer.image(at[:3], at[3:], 0.0, np.random.default_rng(1))
    start = np.append(at + np.array((1e-3, -1e-3, 3e-3, 1e-4, -1e-4, 5e-4)), np.zeros(pose.UNKNOWNS - 6))
    of = target_features(atv.camera, atv.target)
    found = fitted(atv, image, start[:6], 0.85, np.array([1.1, 0.0]))
    normal = np.zeros((pose.UNKNOWNS, pose.UNKNOWNS))
    assert pose.fit_pose(
        of.lens, found, len(found), start, 0.0, np.array([0.1, 0.1] + [0.0] * (pose.PRIORS - 2)), 4, normal
    )
    sigmas = np.sqrt(np.diag(np.linalg.inv(normal[:7, :7])))[:6]
    assert np.all(np.abs(start[:6] - at) < 4.0 * sigmas + 1e-5)


def test_derivatives_of_the_projection_are_those_of_differences() -> None:
    """The row of an edge point is the slope of its place along the normal."""
    lens = np.array([1000.0, 380.0, 280.0, 768.0, 576.0])
    at = np.array([0.3, -0.2, 4.0, 0.05, -0.04, 0.2])
    slopes, row, dummy = np.empty((3, 3, 3)), np.empty(pose.UNKNOWNS), np.empty(pose.UNKNOWNS)
    a = docking_view.attitude(at[3:])
    pose.attitude_derivatives(at[3:], slopes)
    nu, nv = 0.6, -0.8
    pose.point_row(lens, a, slopes, at[:3], 0.2, 0.1, 0.3, nu, nv, row)
    for k in range(6):
        places = []
        for way in (1e-6, -1e-6):
            moved = at.copy()
            moved[k] += way
            b = docking_view.attitude(moved[3:])
            u, v = pose.point_row(lens, b, slopes, moved[:3], 0.2, 0.1, 0.3, nu, nv, dummy)
            places.append(nu * u + nv * v)
        assert row[k] == pytest.approx((places[0] - places[1]) / 2e-6, rel=1e-5, abs=1e-4)


def test_noise_that_is_cut_off_at_black_moves_no_edge(rng: np.random.Generator) -> None:
    """A dark sky of 6 grey values in noise of 8 would move the border of a grey hull inwards by 0.03 px."""
    shifts, weights = [], []
    rows, columns = np.mgrid[:41, :41]
    for _ in range(2500):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        normal, at = np.array([np.cos(angle), np.sin(angle)]), 20.0 + rng.uniform(-0.5, 0.5, 2)
        away = (columns - at[0]) * normal[0] + (rows - at[1]) * normal[1]
        light = 6.0 + 59.0 * ndtr(-away / 0.85) + 8.0 * rng.standard_normal(away.shape)
        sample, sums = np.zeros(1, EDGE_SAMPLE), np.zeros(2)
        for name, value in zip(("u", "v", "nu", "nv", "length"), (*at, *normal, 8.0), strict=True):
            sample[name] = value
        sample["inside"] = sample["outside"] = 4.5
        image = np.clip(np.rint(light), 0, 255).astype(np.uint8)
        edges.fit_edge_samples(image, 0.0, 1.0, sample, 1, 0.85, np.array([64.0, 0.0]), 1, sums)
        if sample["good"][0] == 1:
            shifts.append(float(sample["shift"][0]))
            weights.append(1.0 / float(sample["variance"][0]))
    assert len(shifts) > 2400
    assert abs(np.average(shifts, weights=weights)) < 0.01  # one sigma: 0.0025
