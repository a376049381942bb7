"""The monitor paper's relations, corrected: lines, circle, motion over portions, derived quantities."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_scene
from hil.config.scene import PixelNoise
from hil.models import docking_view
from hil.parts.monitor.kernels.quantities import derive, quantities
from hil.parts.monitor.render import Conditions, TargetRenderer, film
from hil.parts.monitor.results import QUANTITIES
from sims import monitor_paper as paper
from sims.monitor_paper import PaperFrame, PaperMotionFit, pair

F, B, R = 1100.0, 0.3, 0.3
SIGMAS = np.array([0.02, 0.02, 2e-4, 0.01, 0.01, 0.008])
Z = np.array([0.2, 0.01, -0.15, 0.02, 8.0, -0.1])
V = np.array([0.01, 1e-3, -0.02, 5e-4, 0.03, -1e-3])


def line_points(a: float, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points of both bars of a cross of slope ``a`` about (x, y)."""
    t = np.linspace(-30.0, 30.0, 9)
    across = np.column_stack((x + t, y + a * t, np.full(9, 0.01), np.zeros(9)))
    upright = np.column_stack((x - a * t, y + t, np.full(9, 0.01), np.zeros(9)))
    return across, upright


def test_the_cross_centre_is_where_the_lines_meet() -> None:
    """Misprint 5: the second residual is U + a V - c2 and Y_C = (a c2 - c1) / (1 + a^2)."""
    found, covariance = paper.cross_centre(*line_points(0.07, 12.0, -31.0))
    np.testing.assert_allclose(found, [12.0, -31.0, 0.07], atol=1e-9)
    assert covariance[0, 0] == pytest.approx(0.01 / 9.0, rel=0.2)


def test_points_of_both_sides_of_wide_bars_count_by_their_middle() -> None:
    """The half widths are unknowns, so a bar seen wider than it is moves nothing."""
    across, upright = line_points(-0.03, 5.0, 6.0)
    n = np.array([0.03, 1.0]) / np.hypot(0.03, 1.0)
    sides = []
    for side in (-1.0, 1.0):
        moved = across.copy()
        moved[:, :2] += side * 4.2 * n
        moved[:, 3] = side
        sides.append(moved)
    found, _ = paper.cross_centre(np.vstack(sides), upright)
    np.testing.assert_allclose(found, [5.0, 6.0, -0.03], atol=1e-9)


def test_the_bar_across_has_the_slope_minus_phi3() -> None:
    """Misprint 6: in the axes of 3.1, vertical axis up, a = -phi3 and not phi3."""
    phi3 = 0.05
    a = docking_view.attitude(np.array([0.0, 0.0, phi3]))
    ends = []
    for y1 in (-0.1, 0.1):
        x = docking_view.to_camera(a, np.array([0.0, 0.0, 5.0]), np.array([y1, 0.0, B]))
        ends.append((x[0] / x[2], x[1] / x[2]))
    slope = (ends[1][1] - ends[0][1]) / (ends[1][0] - ends[0][0])
    assert slope == pytest.approx(-np.tan(phi3))


def test_the_circle_of_noisy_points_is_within_its_covariance(rng: np.random.Generator) -> None:
    """Gauss-Newton on Phi_2 from the geometric start: errors match the covariance."""
    ratios = []
    for _ in range(200):
        t = rng.uniform(0.0, 2.0 * np.pi, 40)
        radius = 37.0 + 0.05 * rng.normal(size=40)
        points = np.column_stack((10.0 + radius * np.cos(t), -5.0 + radius * np.sin(t)))
        found, covariance = paper.circle(points, np.full(40, 0.05**2))
        error = found - [10.0, -5.0, 37.0]
        ratios.append(error @ np.linalg.solve(covariance, error))
    assert np.mean(ratios) == pytest.approx(3.0, abs=0.6)


def paper_looks(rng: np.random.Generator, start: int) -> list[tuple[float, PaperFrame]]:
    """Return ten frames, 0.1 s apart, by the paper's simplified relations, of even motion with Z, V at 0 s."""
    looks = []
    for k in range(start, start + 10):
        t = 0.1 * k
        d, phi = Z[0::2] + t * Z[1::2], V[0::2] + t * V[1::2]
        gap = F * B / (d[2] * (d[2] - B))
        xo, yo = -F * d[0] / d[2] - F * phi[1], F * d[1] / d[2] + F * phi[0]
        values = np.array([xo - gap * d[0], yo + gap * d[1], -phi[2], xo, yo, F * R / d[2]])
        values += SIGMAS * rng.normal(size=6)
        looks.append((t, PaperFrame(values, np.diag(SIGMAS**2))))
    return looks


@pytest.mark.parametrize("q", [0.0, 0.6])
def test_one_time_origin_and_one_a_portion_give_the_same_motion(rng: np.random.Generator, q: float) -> None:
    """Carrying z, v and their normal matrices to a new origin changes only the conditioning."""
    one, own = PaperMotionFit(F, B, R, q, printed=True), PaperMotionFit(F, B, R, q)
    for portion in range(4):
        looks = paper_looks(rng, 10 * portion)
        t_s = looks[-1][0]
        first, second = one.fit(looks, t_s), own.fit(looks, t_s)
        assert first is not None
        assert second is not None
        np.testing.assert_allclose(first[0], second[0], rtol=1e-6, atol=1e-9)


def test_corrected_covariance_matches_the_errors_and_the_printed_one_does_not(rng: np.random.Generator) -> None:
    """Misprint 7: with q < 1, sigma^2 B^-1 over-reports; the propagated covariance covers, rates included."""
    squares = {"corrected": np.zeros(6), "printed": np.zeros(6)}
    runs = 150
    for _ in range(runs):
        fits = {name: PaperMotionFit(F, B, R, printed=name == "printed") for name in squares}
        results = {}
        for portion in range(5):
            looks = paper_looks(rng, 10 * portion)
            t_s = looks[-1][0]
            results = {name: fit.fit(looks, t_s) for name, fit in fits.items()}
        truth = pair(t_s) @ Z
        for name, result in results.items():
            assert result is not None
            squares[name] += (result[0][:6] - truth) ** 2 / np.diag(result[1])[:6] / runs
    np.testing.assert_allclose(squares["corrected"], 1.0, atol=0.4)
    assert np.all(squares["printed"] < 0.85 * squares["corrected"])


def test_its_motion_is_that_of_the_images_within_the_papers_own_error(rng: np.random.Generator) -> None:
    """Its relations are of first order in small angles and neglect the growth of edges: some hundredths of a degree."""
    atv, w = load_scene("atv").value, np.zeros(12)
    w[0], w[2], w[4], w[5] = 0.1, -0.1, 6.0, -0.05
    conditions = Conditions(noise=PixelNoise(read=3.0, k=0.02))
    images = film(TargetRenderer(atv, conditions=conditions), lambda t: (w[0:6:2] + t * w[1:6:2], w[6::2]), 10, rng)
    ((exact, found),) = paper.watched(atv, images, [paper.fit_of(atv)])
    truth = np.empty(12)
    w[4] += 9 / atv.fps * w[5]
    quantities(w, truth)
    for values, _ in (exact, found):
        assert abs(values[6] - truth[6]) < 0.003 * 6.0
        assert np.all(np.abs(values[3:6] - truth[3:6]) < np.radians(0.1))
    assert not np.array_equal(exact[0], found[0])


def test_rates_have_a_variance_and_range_has_its_root() -> None:
    """Misprint 7: U has a second row, and sigma_rho is the root of the printed expression."""
    w = np.zeros(12)
    w[4], w[5] = 8.0, -0.1
    covariance = np.diag(np.arange(1.0, 13.0) * 1e-6)
    values, sigmas = derive(w, covariance)
    named, sigma = dict(zip(QUANTITIES, values, strict=True)), dict(zip(QUANTITIES, sigmas, strict=True))
    assert named["range_m"] == pytest.approx(8.0)
    assert named["range_rate_mps"] == pytest.approx(-0.1)
    assert sigma["range_m"] == pytest.approx(np.sqrt(5e-6), rel=1e-6)
    assert sigma["range_rate_mps"] == pytest.approx(np.sqrt(6e-6), rel=1e-6)


def test_derived_quantities_are_those_of_their_definitions() -> None:
    """Passive angles, line of sight and rate of a motion that is not small."""
    w = np.array([1.0, 0.1, -2.0, 0.2, 9.0, -0.5, 0.1, 0.0, -0.05, 0.0, 0.2, 0.0])
    out = np.empty(12)
    quantities(w, out)
    d, rate = w[0:6:2], w[1:6:2]
    assert out[7] == pytest.approx(d @ rate / np.linalg.norm(d))
    assert out[8] == pytest.approx(np.arctan2(d[1], np.hypot(d[0], d[2])))
    assert out[9] == pytest.approx(np.arctan2(d[0], d[2]))
    x = docking_view.attitude(w[6::2].copy()).T @ -d
    np.testing.assert_allclose(out[10:], [np.arctan2(x[0], x[2]), np.arctan2(x[1], x[2])])
