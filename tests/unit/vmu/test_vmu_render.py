"""The renderer: light, noise, lights that are none of the target's."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.vmu_geometry import VmuCamera, VmuGeometry
from hil.vmu.geometry import camera_pair, led_positions
from hil.vmu.kernels.disc import add_disc
from hil.vmu.kernels.lens import CameraPair
from hil.vmu.render import Extras, HotPixel, Light, Reflection, RingAppearance, RingRenderer, Shade, projections

STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0])
QUIET = RingAppearance(
    electrons_per_level=1e9, read_noise_levels=0.0, lobe=0.0, auto_peak_levels=None, psf_sigma_px=1.2
)


@pytest.fixture
def geometry() -> VmuGeometry:
    camera = VmuCamera(fx=900.0, fy=900.0, cx=159.5, cy=119.5, width=320, height=240, distortion=(-0.08, 0.02, 0, 0, 0))
    leds = ((0.1, 0.0, -0.05), (-0.05, 0.09, 0.0), (-0.05, -0.09, 0.0))
    return VmuGeometry(leds_m=leds, left=camera, right=camera, baseline_m=(0.1, 0.0, 0.0))


@pytest.fixture
def pair(geometry: VmuGeometry) -> CameraPair:
    return camera_pair(geometry)


def brute_disc(shape: tuple[int, int], u: float, v: float, axes: np.ndarray, blur: float) -> np.ndarray:
    """Return a disc's image by adding up many points of light, each a Gaussian sampled 5 x 5 times a pixel."""
    rings = np.sqrt((np.arange(120) + 0.5) / 120)
    angles = 2.0 * np.pi * (np.arange(90) + 0.5) / 90
    circle = np.stack([np.outer(rings, f(angles)).ravel() for f in (np.cos, np.sin)])
    points = (axes @ circle).T + np.array([u, v])
    fine = (np.arange(5) - 2.0) / 5.0
    rows, columns = ((np.arange(n)[:, None] + fine).ravel() for n in shape)
    by_u = np.exp(-0.5 * ((columns[:, None] - points[:, 0]) / blur) ** 2)
    by_v = np.exp(-0.5 * ((rows[:, None] - points[:, 1]) / blur) ** 2)
    image = by_v @ by_u.T / (2.0 * np.pi * blur**2 * len(points))
    return image.reshape(shape[0], 5, shape[1], 5).mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("width", "shear", "height"), [(0.0, 0.0, 0.0), (0.4, 0.1, 0.3), (3.0, -1.0, 2.5), (7.5, 2, 6)]
)
def test_spot_is_a_blurred_disc_summed_over_pixels(width: float, shear: float, height: float) -> None:
    canvas, box = np.zeros((41, 43)), np.zeros(4, dtype=np.int64)
    add_disc(canvas, 21.3, 19.8, width, shear, height, 1.1, 1000.0, box)
    expected = 1000.0 * brute_disc(canvas.shape, 21.3, 19.8, np.array([[width, shear], [0.0, height]]), 1.1)
    assert np.abs(canvas - expected).max() < 5e-3 * expected.max()
    assert canvas.sum() == pytest.approx(1000.0, rel=1e-4)


def test_spots_are_at_the_projections_of_the_leds(pair: CameraPair, geometry: VmuGeometry) -> None:
    leds = led_positions(geometry)
    renderer = RingRenderer(pair, leds, RingAppearance(**{**_quiet(), "led_diameter_m": 0.0, "background_levels": 0.0}))
    t_v = np.array([0.05, 0.01, 1.4])
    lit = (False, True, False)
    images = renderer.pair(t_v, STRAIGHT, lit, np.random.default_rng(1))
    expected = projections(pair, leds, t_v, STRAIGHT)[:, 1]
    for image, place in zip(images, expected, strict=True):
        v, u = np.indices(image.shape)
        light = image.astype(float)
        assert (light * u).sum() / light.sum() == pytest.approx(place[0], abs=0.02)
        assert (light * v).sum() / light.sum() == pytest.approx(place[1], abs=0.02)


def _quiet(**changes: object) -> dict[str, object]:
    return {name: getattr(QUIET, name) for name in RingAppearance.__dataclass_fields__} | changes


def test_light_falls_with_the_square_of_the_range(pair: CameraPair, geometry: VmuGeometry) -> None:
    look = RingAppearance(**_quiet(flux_1m_levels=1500.0, background_levels=0.0))
    renderer = RingRenderer(pair, led_positions(geometry)[1:2], look)
    found = [
        renderer.image(0, np.array([0.05, -0.09, z]), STRAIGHT, None, np.random.default_rng(1)) for z in (1.0, 2.0)
    ]
    assert found[0].sum() == pytest.approx(1500.0, rel=0.02)
    assert found[1].sum() == pytest.approx(375.0, rel=0.05)


def test_exposure_brings_the_peak_to_its_level(pair: CameraPair, geometry: VmuGeometry) -> None:
    look = RingAppearance(**_quiet(auto_peak_levels=180.0, background_levels=10.0, gain_range=(0.01, 4.0)))
    renderer = RingRenderer(pair, led_positions(geometry), look)
    for z in (0.9, 1.2, 2.0):
        image = renderer.image(0, np.array([0.0, 0.0, z]), STRAIGHT, None, np.random.default_rng(1))
        assert image.max() == pytest.approx(190.0, abs=12.0)


def test_noise_has_the_variance_it_is_given(pair: CameraPair, geometry: VmuGeometry) -> None:
    look = RingAppearance(
        electrons_per_level=20.0, read_noise_levels=0.7, background_levels=30.0, gradient_levels=(40.0, 0.0)
    )
    image = RingRenderer(pair, led_positions(geometry), look).image(
        0, np.array([0.0, 0.0, -1.0]), STRAIGHT, None, np.random.default_rng(3)
    )
    for column in (20, 160, 300):
        part = image[:, column - 10 : column + 10].astype(float)
        level = 30.0 + 40.0 * (column - 160) / 320
        assert part.mean() == pytest.approx(level, abs=0.15)
        assert part.var() == pytest.approx(0.49 + level / 20.0 + 1.0 / 12.0 + (40.0 / 320) ** 2 * 33.0, rel=0.07)


def test_noise_in_a_spot_is_shot_noise(pair: CameraPair, geometry: VmuGeometry) -> None:
    look = RingAppearance(electrons_per_level=10.0, read_noise_levels=1.0, auto_peak_levels=150.0, lobe=0.0)
    renderer = RingRenderer(pair, led_positions(geometry), look)
    rng = np.random.default_rng(5)
    stack = np.stack([renderer.image(0, np.array([0.0, 0.0, 0.8]), STRAIGHT, None, rng) for _ in range(400)])
    v, u = np.unravel_index(stack.mean(axis=0).argmax(), stack.shape[1:])
    pixel = stack[:, v, u].astype(float)
    assert pixel.var() == pytest.approx(1.0 + pixel.mean() / 10.0 + 1.0 / 12.0, rel=0.25)


def test_a_light_in_space_is_seen_by_both_and_a_reflection_by_one(pair: CameraPair, geometry: VmuGeometry) -> None:
    renderer = RingRenderer(pair, led_positions(geometry), QUIET)
    extras = Extras(lights=[Light((0.05, 0.02, 1.0), 2000.0, 0.0)], reflections=[Reflection(1, 40.0, 50.0)])
    away = np.array([0.0, 0.0, -1.0])
    left, right = renderer.pair(away, STRAIGHT, None, np.random.default_rng(1), extras)
    place = projections(pair, np.array([[0.05, 0.02, 1.0]]), np.zeros(3), STRAIGHT)[:, 0]
    for image, (u, v) in zip((left, right), place, strict=True):
        assert image[round(v), round(u)] > 100
    assert right[50, 40] > 100
    assert left[50, 40] == 12


def test_dark_cameras_shades_unlit_leds_and_hot_pixels(pair: CameraPair, geometry: VmuGeometry) -> None:
    look = RingAppearance(**_quiet(hot_pixels=(HotPixel(0, 7, 9, 199),)))
    renderer = RingRenderer(pair, led_positions(geometry), look)
    t_v, rng = np.array([0.0, 0.0, 1.4]), np.random.default_rng(1)
    left, right = renderer.pair(t_v, STRAIGHT, None, rng, Extras(dark=(False, True), shades=[Shade(0, 0, 0, 160, 240)]))
    assert left[9, 7] == 199
    assert left[:, 160:].max() > 100
    left[9, 7] = 12
    assert left[:, :150].max() == 12
    assert right.max() == 12
    unlit, _ = renderer.pair(t_v, STRAIGHT, (False,) * 3, rng)
    assert np.unique(unlit).tolist() == [12, 199]


def test_the_generator_alone_decides(pair: CameraPair, geometry: VmuGeometry) -> None:
    t_v = np.array([0.0, 0.0, 1.4])
    first = RingRenderer(pair, led_positions(geometry), RingAppearance()).pair(
        t_v, STRAIGHT, None, np.random.default_rng(1)
    )
    other = RingRenderer(pair, led_positions(geometry), RingAppearance())
    other.pair(t_v, STRAIGHT, None, np.random.default_rng(2))
    again = other.pair(t_v, STRAIGHT, None, np.random.default_rng(1))
    assert np.array_equal(first, again)
