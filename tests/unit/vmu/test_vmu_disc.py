"""Light of a blurred disc over pixels: against scipy, and its derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from hil.vmu.kernels.disc import gauss_edges, strip_sums
from hil.vmu.kernels.fit import DISC, PLANE, POINT, fill_disc, fill_points, whole_spans

BOX = np.array([3, 7, 30, 32])


@pytest.mark.parametrize("centre", [-40.0, 2.49, 2.5, 37.3, 95.0, 300.0])
@pytest.mark.parametrize("blur", [0.25, 0.8, 3.0])
def test_gaussian_at_the_edges_of_pixels(centre: float, blur: float) -> None:
    count, first = 96, 3
    z, density, rise = np.empty((3, count + 1))
    gauss_edges(first, count, centre, blur, z, density, rise)
    expected = (np.arange(count + 1) + first - 0.5 - centre) / blur
    assert z == pytest.approx(expected, abs=1e-12 * (1.0 + np.abs(expected).max()))
    assert density == pytest.approx(np.exp(-0.5 * expected**2), rel=1e-9, abs=1e-15)
    assert rise == pytest.approx(0.5 * erf(expected / np.sqrt(2.0)), abs=5e-9)


@pytest.mark.parametrize("half", [0.0, 0.01, 0.4, 5.0])
def test_strip_of_light_has_unit_flux_and_its_centre(half: float) -> None:
    count = 40
    lines, edges = np.empty((4, count)), np.empty((6, count + 1))
    strip_sums(0, count, 18.3, half, 0.9, edges, *lines)
    assert lines[0].sum() == pytest.approx(1.0, abs=1e-7)
    assert lines[0] @ np.arange(count) == pytest.approx(18.3, abs=1e-6)
    assert lines[1:].sum(axis=1) == pytest.approx(0.0, abs=1e-7)


LIGHTS = {
    "point": (fill_points, PLANE + POINT, [900.0, 15.2, 18.7, 1.3]),
    "disc": (fill_disc, PLANE + DISC, [2500.0, 15.2, 18.7, 0.9, 4.0, 1.1, 3.2]),
    "wide disc": (fill_disc, PLANE + DISC, [9000.0, 16.0, 19.1, 0.8, 8.0, -2.0, 6.9]),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_derivatives_are_those_of_the_light(name: str) -> None:
    fill, n, light = LIGHTS[name]
    p = np.array([12.0, 0.1, -0.2, *light])
    pixels = int((BOX[2] - BOX[0]) * (BOX[3] - BOX[1]))

    def image(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        model, alone, slopes = np.empty(pixels), np.empty(pixels), np.empty((n, pixels))
        arrays = (model, alone, slopes)
        fill(BOX, parameters, *(arrays if fill is fill_disc else (*arrays, whole_spans(n, pixels))))
        return model, slopes

    _, slopes = image(p)
    for m in range(n):
        step = np.zeros(n)
        step[m] = 1e-3 * max(1.0, 1e-2 * abs(p[m]))
        difference = (image(p + step)[0] - image(p - step)[0]) / (2.0 * step[m])
        assert slopes[m] == pytest.approx(difference, abs=2e-5 * np.abs(difference).max()), m
