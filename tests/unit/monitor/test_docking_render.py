"""The rendered docking camera: where edges stand, how much light, how much noise, and what is faulty on purpose."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.config.load import load_scene
from hil.config.scene import PixelNoise, Scene
from hil.models import docking_view
from hil.parts.monitor import render
from hil.parts.monitor.render import Conditions, FlatShape, Glare, TargetRenderer, film
from hil.parts.monitor.sources import LOWER, UPPER

DATA = Path(__file__).parents[2] / "data" / "docking"
AHEAD = np.zeros(3)
QUIET = PixelNoise(read=0.0)

SAMPLES = {
    "near": (232, 258, [-0.245356896, -0.123116783, 9.0], [-0.013511701, 0.007411253, -0.025504982]),
    "far": (304, 186, [0.186316555, 0.189896014, 32.0], [0.007371118, -0.011441684, 0.008871079]),
}


@pytest.fixture(scope="module")
def atv() -> Scene:
    return load_scene("atv").value


def with_target(scene: Scene, **parts: object) -> Scene:
    """Return ``scene`` with a target of these parts alone."""
    empty = {name: None for name in type(scene.target).model_fields if name != "boxes"}
    return scene.model_copy(update={"target": scene.target.model_copy(update={**empty, "boxes": (), **parts})})


def middle_of(scene: Scene, d: np.ndarray, phi: np.ndarray, y: np.ndarray) -> np.ndarray:
    x = docking_view.to_camera(docking_view.attitude(phi), d, y)
    camera = scene.camera
    return np.array(docking_view.project_point(camera.f, camera.cx, camera.cy, x))


def centroid(image: np.ndarray) -> np.ndarray:
    lines, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(image * columns).sum(), (image * lines).sum()]) / image.sum()


@pytest.mark.parametrize("name", ["near", "far"])
def test_edges_agree_with_another_renderer(atv: Scene, name: str) -> None:
    u0, v0, d, phi = SAMPLES[name]
    sample = cv2.imread(str(DATA / f"{name}.png"), cv2.IMREAD_GRAYSCALE).astype(float)
    height, width = sample.shape
    drawn = TargetRenderer(atv).draw(np.array(d), np.array(phi)).astype(float)
    clean = drawn[v0 : v0 + height, u0 : u0 + width]
    down, right = np.gradient(drawn)
    down, right = down[v0 : v0 + height, u0 : u0 + width], right[v0 : v0 + height, u0 : u0 + width]
    lines, columns = np.mgrid[:height, :width]
    centre = middle_of(atv, np.array(d), np.array(phi), np.zeros(3)) - (u0, v0)
    out_u, out_v = columns - centre[0], lines - centre[1]
    terms = [clean, np.ones_like(clean), clean * out_u, clean * out_v, -right, -down]
    terms += [-(right * out_u + down * out_v), -(down * out_u - right * out_v)]
    found = np.linalg.lstsq(np.stack([term.ravel() for term in terms], 1), sample.ravel(), rcond=None)[0]
    shift_u, shift_v, growth, turn = found[4:]
    reach = 0.5 * width if name == "near" else 76.0
    assert abs(shift_u) < 0.02
    assert abs(shift_v) < 0.02
    assert abs(turn) * reach < 0.06
    assert 0.0 < growth * reach < 0.3  # the sample's parts are 0.07 px too large; boxes count for less than the reach


@pytest.mark.parametrize("roll", [0.0, 1e-6, 0.03, 0.8])
def test_the_area_of_a_disc_is_exact_at_any_position(atv: Scene, roll: float) -> None:
    scene = with_target(atv, disc=atv.target.disc).model_copy(
        update={"camera": atv.camera.model_copy(update={"sky": 0.0})}
    )
    renderer = TargetRenderer(scene, conditions=Conditions(blur_px=0.0))
    for shift in (0.0, 0.0123, -0.031):
        d = np.array([shift, -0.5 * shift, 11.0])
        image = renderer.draw(d, np.array([0.0, 0.0, roll])) / 205.0
        assert image.min() >= 0.0
        assert image.max() <= 1.0 + 1e-6
        assert image.sum() == pytest.approx(np.pi * (1100.0 * 0.3 / 11.0) ** 2, rel=1e-4)
        np.testing.assert_allclose(centroid(image), middle_of(scene, d, np.array([0.0, 0.0, roll]), AHEAD), atol=2e-3)


def test_upright_edge_covers_the_right_fraction_of_a_pixel(atv: Scene) -> None:
    for edge_px in (100.0, 100.25, 100.5, 100.9):
        width_m = 2.0 * edge_px / 1100.0 * 10.0
        half = FlatShape(render.rectangle(width_m, 2.0), 0.0, 100.0)
        scene = with_target(atv, outline=None).model_copy(
            update={"camera": atv.camera.model_copy(update={"sky": 0.0, "cx": 383.5})}
        )
        line = TargetRenderer(scene, conditions=Conditions(blur_px=0.0, extra=(half,))).draw(
            np.array([0, 0, 10.0]), AHEAD
        )[287]
        right = line[384:]  # its pixels end 1, 2, 3 ... px from the middle of the image
        np.testing.assert_allclose(right.sum() / 100.0, edge_px, atol=1e-4)
        assert right[int(edge_px) + 1] == 0.0


def test_parts_beyond_the_image_cover_the_pixels_inside(atv: Scene) -> None:
    scene = with_target(atv, outline=atv.target.outline)
    close = TargetRenderer(scene).draw(np.array([0.0, 0.0, 1.3]), AHEAD)
    np.testing.assert_allclose(close, 120.0, rtol=1e-6)
    for corner in ((2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.0), (1.5, 1.5)):
        d = np.array([*corner, 3.0])
        image = TargetRenderer(scene, conditions=Conditions(blur_px=0.0)).draw(d, AHEAD)
        lines, columns = np.mgrid[:576, :768]
        # the outline's plane is 3.4 m away and parallel to the image plane
        u, v = 383.5 - 1100.0 * corner[0] / 3.4, 287.5 - 1100.0 * corner[1] / 3.4
        reach = np.hypot(columns - u, lines - v) - 1100.0 * 2.24 / 3.4
        np.testing.assert_allclose(image[reach < -1.0], 120.0, rtol=1e-6)
        np.testing.assert_allclose(image[reach > 1.0], 12.0, rtol=1e-6)


def test_what_is_behind_the_camera_is_not_drawn(atv: Scene) -> None:
    cross = TargetRenderer(with_target(atv, cross=atv.target.cross))
    assert cross.draw(np.array([0.0, 0.0, 0.29]), AHEAD).max() == 12.0
    everything = TargetRenderer(atv).draw(np.array([0.0, 0.0, -5.0]), AHEAD)
    assert np.ptp(everything) == 0.0
    assert np.isfinite(TargetRenderer(atv).draw(np.array([0.3, 0.2, 0.5]), np.array([1.2, 0.3, 0.1]))).all()


def test_the_cross_moves_before_the_disc_as_the_camera_moves_aside(atv: Scene) -> None:
    d = np.array([0.5, 0.0, 8.0])
    black = atv.camera.model_copy(update={"sky": 0.0})
    scene = with_target(atv, cross=atv.target.cross).model_copy(update={"camera": black})
    seen = centroid(TargetRenderer(scene).draw(d, AHEAD))
    np.testing.assert_allclose(seen, middle_of(atv, d, AHEAD, np.array([0.0, 0.0, 0.3])), atol=5e-3)
    assert seen[0] < middle_of(atv, d, AHEAD, AHEAD)[0] - 2.0


def test_noise_is_the_cameras(atv: Scene, rng: np.random.Generator) -> None:
    scene = with_target(atv, outline=atv.target.outline)
    renderer = TargetRenderer(scene, conditions=Conditions(noise=PixelNoise(read=3.0, k=0.1)))
    image = renderer.image(np.array([0.0, 0.0, 1.3]), AHEAD, 0.0, rng)
    assert image.mean() == pytest.approx(120.0, abs=0.05)
    assert image.var() == pytest.approx(9.0 + 0.1 * 120.0 + 1.0 / 12.0, rel=0.02)


def test_image_is_reproducible_from_its_seed(atv: Scene) -> None:
    d = np.array([0.1, 0.2, 9.0])
    one, two = (TargetRenderer(atv).image(d, AHEAD, 0.0, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one, two)


def test_light_flicker_glare_black_and_cover_have_their_values(atv: Scene, rng: np.random.Generator) -> None:
    scene = with_target(atv, outline=atv.target.outline)
    d = np.array([0.0, 0.0, 1.3])

    def picture(t_s: float = 0.0, **what: object) -> np.ndarray:
        return TargetRenderer(scene, conditions=Conditions(noise=QUIET, **what)).image(d, AHEAD, t_s, rng)  # type: ignore[arg-type]

    sloped = picture(slope_right=0.2, slope_down=-0.1)
    assert (sloped[288, 0], sloped[288, 767]) == (96, 144)
    assert sloped[0, 384] == 132
    assert picture(t_s=0.25, flicker=0.5, flicker_hz=1.0).max() == 180
    assert picture(t_s=1.0, black_s=((0.5, 1.5),)).max() == 0
    assert picture(t_s=1.5, black_s=((0.5, 1.5),)).max() == 120
    spot = picture(glare=(Glare((0.1, 0.0, 0.0), 500.0, 5.0),))
    u, v = middle_of(scene, d, AHEAD, np.array([0.1, 0.0, 0.0]))
    assert spot[round(v), round(u)] == 255
    assert spot[round(v) + 40, round(u)] == 120
    cover = FlatShape(render.rectangle(0.1, 0.1, (0.2, 0.0)), 0.1, 60.0)
    covered = picture(extra=(cover,))
    u, v = middle_of(scene, d, AHEAD, np.array([0.2, 0.0, 0.1]))
    assert covered[round(v), round(u)] == 60


def test_half_frames_have_their_own_times_and_lines(rng: np.random.Generator) -> None:
    scene = load_scene("bright-cross").value
    renderer = TargetRenderer(scene, conditions=Conditions(noise=QUIET))

    def flight(t_s: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0.0, 0.0, 9.0 - 1.5 * t_s]), AHEAD

    frames = list(film(renderer, flight, 2, rng))
    assert [frame.field for frame in frames] == [UPPER, LOWER, UPPER, LOWER]
    np.testing.assert_allclose([frame.t_s for frame in frames], [0.0, 0.02, 0.04, 0.06])
    whole = renderer.image(*flight(0.06), 0.06, rng)
    np.testing.assert_array_equal(frames[3].image, whole[1::2])
    assert frames[3].image.flags.c_contiguous
    assert (frames[3].first_line, frames[3].line_step) == (1, 2)
    lower_first = TargetRenderer(scene.model_copy(update={"fields": "lower_first"}))
    assert [frame.field for frame in film(lower_first, flight, 1, rng)] == [LOWER, UPPER]
