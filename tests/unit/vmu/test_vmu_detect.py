"""The detector: what is a spot, where it is, and how well that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.config.vmu_geometry import Sensor
from hil.errors import BadInput
from hil.vmu.detect import SpotDetector
from hil.vmu.kernels.components import COMPONENT_WIDTH, END, FIRST, U0, U1, V0, V1
from hil.vmu.kernels.fit import light_fit
from hil.vmu.kernels.lens import LENS, CameraPair
from hil.vmu.kernels.records import AT_BORDER, MERGED, SATURATED
from hil.vmu.kernels.residuals import drop_outliers
from hil.vmu.kernels.search import is_fringe
from hil.vmu.render import Extras, HotPixel, Reflection, RingAppearance, RingRenderer, projections

SIZE, FOCAL = 320, 1200.0
STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0])
AWAY = np.array([0.0, 0.0, -1.0])  # the target is behind the camera: only the extras are visible
GRID = np.stack(np.meshgrid([60.0, 160.0, 260.0], [60.0, 160.0, 260.0]), axis=-1).reshape(-1, 2)
LOOK = RingAppearance()


@pytest.fixture(scope="module")
def pair() -> CameraPair:
    lens = np.zeros(2, LENS)
    for name, value in (("fx", FOCAL), ("fy", FOCAL), ("cx", SIZE / 2), ("cy", SIZE / 2)):
        lens[name] = value
    lens["width"] = lens["height"] = SIZE
    return CameraPair(lens, np.stack([np.eye(3)] * 2), np.zeros((2, 3)))


def nine_leds(range_m: float, rng: np.random.Generator) -> np.ndarray:
    pixels = GRID + rng.uniform(-0.5, 0.5, GRID.shape)
    rays = np.column_stack([(pixels - SIZE / 2) / FOCAL, np.ones(len(pixels))])
    return rays * range_m


def shown(
    pair: CameraPair, look: RingAppearance, *lights: Reflection, seed: int = 1, hot: tuple[HotPixel, ...] = ()
) -> np.ndarray:
    renderer = RingRenderer(pair, np.zeros((1, 3)), replace(look, hot_pixels=hot))
    return renderer.image(0, AWAY, STRAIGHT, None, np.random.default_rng(seed), Extras(reflections=lights))


def errors(
    pair: CameraPair, look: RingAppearance, range_m: float, images: int, sensor: Sensor | None
) -> tuple[list, list, int]:
    """Return normalised squares, errors in px, and how many spots there were besides the LEDs'."""
    rng, detector = np.random.default_rng(7), SpotDetector((SIZE, SIZE), sensor=sensor)
    squares, found, besides = [], [], 0
    for _ in range(images):
        leds = nine_leds(range_m, rng)
        image = RingRenderer(pair, leds, look).image(0, np.zeros(3), STRAIGHT, None, rng)
        spots = detector.spots(image)
        besides += len(spots) - 9
        for place in projections(pair, leds, np.zeros(3), STRAIGHT)[0]:
            s = spots[np.argmin(np.hypot(spots["u"] - place[0], spots["v"] - place[1]))]
            e = np.array([s["u"] - place[0], s["v"] - place[1]])
            squares.append(e @ np.linalg.solve([[s["var_u"], s["cov_uv"]], [s["cov_uv"], s["var_v"]]], e))
            found.append(e)
    return squares, found, besides


@pytest.mark.parametrize(
    ("look", "range_m"),
    [
        (LOOK, 12.0),
        (LOOK, 3.0),
        (LOOK, 1.0),
        (replace(LOOK, read_noise_levels=6.0, electrons_per_level=10.0), 3.0),
        (replace(LOOK, background_levels=60.0, gradient_levels=(60.0, -40.0), electrons_per_level=40.0), 6.0),
        (replace(LOOK, auto_peak_levels=600.0), 1.0),
        (replace(LOOK, psf_sigma_px=0.7), 9.0),
    ],
    ids=["12 m", "3 m", "1 m", "noisy", "gradient", "clipped", "sharp"],
)
def test_errors_of_every_led_match_its_covariance(pair: CameraPair, look: RingAppearance, range_m: float) -> None:
    squares, found, besides = errors(pair, look, range_m, 14, None)
    assert besides == 0
    assert np.max(np.abs(found)) < 0.5
    # 252 degrees of freedom: four sigma of their mean are 0.36
    assert np.mean(squares) / 2.0 == pytest.approx(1.0, abs=0.36)


def test_centres_are_near_the_bound_of_a_gaussian_in_white_noise(pair: CameraPair) -> None:
    look = replace(LOOK, electrons_per_level=1e6, read_noise_levels=1.0, led_diameter_m=0.0, auto_peak_levels=None)
    _, found, _ = errors(pair, look, 6.0, 30, None)
    flux = LOOK.flux_1m_levels / 36.0
    square = look.psf_sigma_px**2 + 1.0 / 12.0
    bound = np.sqrt(8.0 * np.pi * (1.0 + 1.0 / 12.0)) * square / flux
    assert np.sqrt(np.mean(np.square(found))) < 1.12 * bound  # 540 numbers: 3 % of chance, the slope of the background


def test_shot_noise_is_learnt_from_the_spots(pair: CameraPair) -> None:
    look, rng, detector = replace(LOOK, electrons_per_level=20.0), np.random.default_rng(3), SpotDetector((SIZE, SIZE))
    for _ in range(12):
        leds = nine_leds(2.0, rng)
        detector.spots(RingRenderer(pair, leds, look).image(0, np.zeros(3), STRAIGHT, None, rng))
    assert detector.variance_per_level == pytest.approx(1.0 / 20.0, rel=0.35)
    known = SpotDetector((SIZE, SIZE), sensor=Sensor(electrons_per_level=20.0, read_noise_levels=1.0))
    assert known.variance_per_level == pytest.approx(0.05)


@pytest.mark.parametrize("level", [0.0, 12.0, 120.0, 250.0])
@pytest.mark.parametrize("noise", [0.0, 0.5, 3.0, 8.0])
def test_nothing_is_found_in_the_dark(pair: CameraPair, level: float, noise: float) -> None:
    detector = SpotDetector((SIZE, SIZE))
    for seed in range(3):
        image = shown(pair, replace(LOOK, background_levels=level, read_noise_levels=noise), seed=seed)
        assert len(detector.spots(image)) == 0


def test_black_and_white_images_have_no_spots() -> None:
    detector = SpotDetector((SIZE, SIZE))
    assert len(detector.spots(np.zeros((SIZE, SIZE), dtype=np.uint8))) == 0
    assert len(detector.spots(np.full((SIZE, SIZE), 255, dtype=np.uint8))) == 0
    half = np.zeros((SIZE, SIZE), dtype=np.uint8)
    half[:, 150:] = 255
    assert len(detector.spots(half)) == 0


def test_hot_pixels_are_no_spots_and_do_not_hide_one(pair: CameraPair) -> None:
    hot = (HotPixel(0, 30, 40), HotPixel(0, 200, 100, 255), HotPixel(0, 200, 160, 40), HotPixel(0, 101, 101, 230))
    pair_of_two = (HotPixel(0, 250, 60), HotPixel(0, 251, 60))
    spots = SpotDetector((SIZE, SIZE)).spots(
        shown(pair, LOOK, Reflection(0, 103.3, 99.6, 900.0), hot=hot + pair_of_two)
    )
    assert len(spots) == 1
    assert spots[0]["u"] == pytest.approx(103.3, abs=0.1)
    assert spots[0]["v"] == pytest.approx(99.6, abs=0.1)


def test_clipped_spot_is_flagged(pair: CameraPair) -> None:
    (spot,) = SpotDetector((SIZE, SIZE)).spots(shown(pair, LOOK, Reflection(0, 150.3, 99.6, 9000.0, 1.5)))
    assert spot["flags"] == SATURATED
    assert spot["u"] == pytest.approx(150.3, abs=0.05)


def test_spot_cut_by_the_edge_is_flagged_and_less_certain_across_it(pair: CameraPair) -> None:
    (spot,) = SpotDetector((SIZE, SIZE)).spots(shown(pair, LOOK, Reflection(0, 0.4, 99.6, 3000.0, 2.5)))
    assert spot["flags"] == AT_BORDER
    assert spot["var_u"] > 1.5 * spot["var_v"]
    assert abs(spot["u"] - 0.4) < 4.0 * np.sqrt(spot["var_u"])


def test_two_overlapping_lights_are_separated(pair: CameraPair) -> None:
    lights = Reflection(0, 150.2, 100.0, 1500.0), Reflection(0, 154.9, 101.0, 1100.0)
    spots = SpotDetector((SIZE, SIZE)).spots(shown(pair, LOOK, *lights))
    assert len(spots) == 2
    for spot, light in zip(spots[np.argsort(spots["u"])], lights, strict=True):
        assert spot["flags"] == MERGED
        assert abs(spot["u"] - light.u_px) < 4.0 * np.sqrt(spot["var_u"])
        assert abs(spot["v"] - light.v_px) < 4.0 * np.sqrt(spot["var_v"])


def test_windows_show_what_they_contain_once(pair: CameraPair) -> None:
    lights = [Reflection(0, u, 100.3, 1500.0) for u in (50.2, 150.7, 250.1)]
    image, detector = shown(pair, LOOK, *lights), SpotDetector((SIZE, SIZE))
    whole = np.sort(detector.spots(image), order="u")
    assert len(whole) == 3
    inside = detector.spots(image, np.array([[30, 80, 70, 120], [40, 90, 90, 130], [-20, -20, 10, 10]]))
    assert len(inside) == 1
    assert inside[0]["u"] == pytest.approx(whole[0]["u"], abs=0.02)
    cut = detector.spots(image, np.array([[152, 80, 190, 120]]))  # the light's middle is outside of it
    assert cut[0]["u"] == pytest.approx(whole[1]["u"], abs=0.02)
    assert len(detector.spots(image, np.empty((0, 4)))) == 0
    assert len(detector.spots(image, np.array([[400, 400, 420, 420], [10, 10, 11, 11]]))) == 0


def test_one_image_leaves_nothing_behind_for_the_next(pair: CameraPair) -> None:
    sensor = Sensor(electrons_per_level=100.0, read_noise_levels=0.8)
    detector, image = SpotDetector((SIZE, SIZE), sensor=sensor), shown(pair, LOOK, Reflection(0, 100.2, 100.3))
    first = detector.spots(image)
    detector.spots(shown(pair, LOOK, Reflection(0, 102.0, 101.0, 5000.0, 4.0), hot=(HotPixel(0, 100, 100),)))
    assert np.array_equal(first, detector.spots(image))


def test_disc_followed_from_the_previous_image_equals_a_fresh_detection(pair: CameraPair) -> None:
    sensor, rng = Sensor(electrons_per_level=100.0, read_noise_levels=0.8), np.random.default_rng(5)
    following, windows = SpotDetector((SIZE, SIZE), sensor=sensor), np.column_stack([GRID - 30.0, GRID + 30.0])
    shifts, variances = [], []
    for range_m in np.linspace(1.0, 0.7, 8):
        leds = nine_leds(range_m, rng)
        image = RingRenderer(pair, leds, LOOK).image(0, np.zeros(3), STRAIGHT, None, rng)
        if not len(shifts):
            following.spots(image)
        here = following.spots(image, windows)
        anew = SpotDetector((SIZE, SIZE), sensor=sensor).spots(image, windows)
        assert len(here) == len(anew) == 9
        assert (here["blur"] > 0.0).all()
        for name in ("u", "v"):
            shifts += list((here[name] - anew[name]) / np.sqrt(anew[f"var_{name}"]))
            variances += list(here[f"var_{name}"] / anew[f"var_{name}"])
        assert np.abs(here["size"] - anew["size"]).max() < 0.5 * anew["shape_sigma"][:, 1].max()
        assert np.abs(here["elongation"] - anew["elongation"]).max() < anew["shape_sigma"][:, 0].max()
        assert here["shape_sigma"] == pytest.approx(anew["shape_sigma"], rel=0.2)
    assert np.abs(shifts).max() < 1.0
    assert np.sqrt(np.mean(np.square(shifts))) < 0.3
    assert np.mean(variances) == pytest.approx(1.0, abs=0.05)


def test_point_of_light_after_a_disc_is_measured_as_well_as_in_a_fresh_image(pair: CameraPair) -> None:
    sensor, windows = Sensor(electrons_per_level=100.0, read_noise_levels=0.8), np.array([[60, 60, 140, 140]])
    image, detector = shown(pair, LOOK, Reflection(0, 100.2, 100.3)), SpotDetector((SIZE, SIZE), sensor=sensor)
    anew = SpotDetector((SIZE, SIZE), sensor=sensor).spots(image, windows)
    disc = RingRenderer(pair, nine_leds(0.7, np.random.default_rng(1))[:1], LOOK)
    assert detector.spots(disc.image(0, np.zeros(3), STRAIGHT, None, np.random.default_rng(2)))["blur"] > 0.0
    found = detector.spots(image, windows)
    assert len(found) == len(anew) == 1
    assert abs(found["u"] - anew["u"]) < 0.5 * np.sqrt(anew["var_u"])
    assert found["var_u"] == pytest.approx(anew["var_u"], rel=0.3)


def test_images_of_another_size_are_rejected() -> None:
    detector = SpotDetector((240, 320))
    with pytest.raises(BadInput, match=r"image: shape: uint8 \(320, 240\), must be uint8 \(240, 320\)"):
        detector.spots(np.zeros((320, 240), dtype=np.uint8))
    with pytest.raises(BadInput, match="uint16"):
        detector.spots(np.zeros((240, 320), dtype=np.uint16))


def test_small_and_oblong_images_are_searched_to_their_edges() -> None:
    for shape in ((16, 16), (17, 200), (240, 31)):
        image = np.full(shape, 10, dtype=np.uint8)
        v, u = np.indices(shape)
        image += np.rint(150.0 * np.exp(-0.5 * ((u - 8.3) ** 2 + (v - 7.6) ** 2) / 1.3)).astype(np.uint8)
        (spot,) = SpotDetector(shape).spots(image)
        assert (spot["u"], spot["v"]) == pytest.approx((8.3, 7.6), abs=0.02)


def test_noise_that_is_all_lights_is_survived() -> None:
    image = np.random.default_rng(1).choice(np.array([0, 255], dtype=np.uint8), size=(SIZE, SIZE), p=[0.97, 0.03])
    assert len(SpotDetector((SIZE, SIZE)).spots(image)) <= 64


def test_few_pixels_next_to_a_large_light_are_noise_of_its_edge() -> None:
    label = np.zeros((64, 64), np.int16)
    label[20:40, 20:40] = 1
    label[30, 42] = 2
    label[30, 50] = 3
    components = np.zeros((3, COMPONENT_WIDTH), np.int64)
    for k, pixels in enumerate((400, 1, 1)):
        rows, columns = np.nonzero(label == k + 1)
        components[k, [FIRST, END]] = 0, pixels
        components[k, [U0, V0, U1, V1]] = columns.min(), rows.min(), columns.max(), rows.max()
    assert [is_fringe(label, components, k) for k in range(3)] == [False, True, False]
    components[0, END] = 100
    assert not is_fringe(label, components, 1)


@pytest.mark.parametrize(("off", "dropped"), [(2, 2), (20, 1), (100, 1)])
def test_of_many_pixels_off_the_model_only_the_worst_is_dropped(off: int, dropped: int) -> None:
    fitted = light_fit(False, np.zeros(7), np.array([0, 0, 20, 20]), 1.0, 0.01, np.array([1e9, 0.0, 0.0]))
    fitted.model[:], fitted.light[:], fitted.weighed[:] = 20.0, 0.0, 1.0
    fitted.pixels[:] = fitted.model
    fitted.pixels[:off] += 50.0 + np.arange(off)
    assert drop_outliers(fitted) == dropped
    assert fitted.weighed.sum() == 400 - dropped
