"""Docking monitor of a ship whose outline has corners, on images of another renderer."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from hil.config.load import load_scene
from hil.config.scene import Outline, Scene, Target
from hil.parts.monitor.features import OUTLINE, target_features
from hil.parts.monitor.kernels.quantities import quantities
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.render import parts_of
from hil.parts.monitor.results import FAR_QUANTITIES, QUANTITIES, Result
from hil.parts.monitor.screen.overlay import CIRCLE, shapes
from hil.parts.monitor.sources import VideoFrame
from tests.support.tv_pixels import TvCamera, TvTarget

Corners = tuple[tuple[float, float], ...]

OCTAGON: Corners = tuple(
    (2.3 * math.cos(math.pi * (k + 0.5) / 4), 2.3 * math.sin(math.pi * (k + 0.5) / 4)) for k in range(8)
)
L_SHAPE: Corners = ((-2.2, -2.2), (2.4, -2.2), (2.4, 0.9), (0.9, 0.9), (0.9, 2.6), (-2.2, 2.6))
IRREGULAR: Corners = (
    (-2.1, -1.5), (-0.4, -2.3), (2.5, -1.2), (1.9, 0.6), (2.2, 1.9), (0.3, 1.2), (-1.0, 2.4), (-2.4, 0.8)
)  # fmt: skip
SHAPES = {"octagon": OCTAGON, "L": L_SHAPE, "irregular": IRREGULAR}


def scene_of(corners: Corners, boxes: bool = True) -> Scene:
    """Return the ATV-like scene with another outline."""
    atv = load_scene("atv").value
    outline = Outline(corners_m=corners, offset_m=-0.4)
    changed = {"outline": outline} | ({} if boxes else {"boxes": ()})
    target = Target.model_validate(atv.target.model_copy(update=changed).model_dump())
    return atv.model_copy(update={"target": target})


def portion_at(
    scene: Scene, range_m: float, seed: int, finer: bool = False
) -> tuple[Result, np.ndarray, DockingMonitor]:
    """Return a portion of a new monitor, its errors in sigmas, and the monitor."""
    rng = np.random.default_rng([seed, round(range_m)])
    w = np.zeros(12)
    w[0:6:2] = *(rng.uniform(-0.03, 0.03, 2) * range_m), range_m
    w[6:12:2] = *rng.uniform(-0.03, 0.03, 2), rng.uniform(-0.4, 0.4)
    w[1::2] = 0.002, -0.003, -0.05, 1e-4, -2e-4, 3e-4
    target, monitor = TvTarget(scene, TvCamera(finer=finer)), DockingMonitor(scene)
    found: list[Result] = []
    for k in range(10):
        t_s = k / scene.fps
        image = target.frame(lambda t: (w[0:6:2] + t * w[1:6:2], w[6::2] + t * w[7::2]), t_s, rng)
        found += monitor.feed(VideoFrame(k, t_s, image))
    (portion,) = found
    truth, at = np.empty(12), w.copy()
    at[0::2] += portion.t_s * w[1::2]
    quantities(at, truth)
    return portion, (portion.values - truth) / portion.sigmas, monitor


@pytest.mark.parametrize(
    ("shape", "range_m", "status"),
    [("octagon", 24.0, "far"), ("L", 24.0, "far"), ("irregular", 30.0, "far"), ("L", 6.0, "near")],
)
def test_outline_with_corners_is_found_and_measured_within_its_sigmas(shape: str, range_m: float, status: str) -> None:
    portion, ratios, _ = portion_at(scene_of(SHAPES[shape]), range_m, 3)
    assert (portion.status, portion.frames, portion.consistent) == (status, 10, True)
    observed = np.isfinite(portion.values)
    if status == "far":
        assert {name for name, seen in zip(QUANTITIES, observed, strict=True) if seen} == FAR_QUANTITIES
    assert np.abs(ratios[observed]).max() < 4.0
    assert portion.sigma("range_m") < 4e-5 * range_m


def test_roll_of_an_irregular_outline_is_found_without_boxes() -> None:
    """The plate alone looks the same after a rotation by 90 deg, and a wrong roll would be found by no search."""
    portion, ratios, monitor = portion_at(scene_of(IRREGULAR, boxes=False), 24.0, 5)
    assert (portion.status, portion.frames) == ("far", 10)
    assert np.nanmax(np.abs(ratios)) < 4.0
    assert monitor.last is not None
    assert monitor.last.detection.outline is None
    assert monitor.last.detection.corners.shape == (8, 2)
    assert sum(shape["part"] == CIRCLE and shape["kind"] == "line" for shape in shapes(monitor.last.detection)) == 8


def test_another_outline_is_not_taken_for_it() -> None:
    """Images of the L before a monitor of the octagon."""
    shown, known = scene_of(L_SHAPE), scene_of(OCTAGON)
    rng = np.random.default_rng(1)
    image = TvTarget(shown, TvCamera()).frame(lambda _: (np.array([0.1, 0.2, 26.0]), np.zeros(3)), 0.0, rng)
    monitor = DockingMonitor(known)
    monitor.feed(VideoFrame(0, 0.0, image))
    assert monitor.last is not None
    assert not monitor.last.used


def test_order_of_the_corners_does_not_matter() -> None:
    one, other = Outline(corners_m=IRREGULAR), Outline(corners_m=IRREGULAR[::-1])
    assert one.ordered_corners_m == IRREGULAR
    start = other.ordered_corners_m.index(IRREGULAR[0])
    assert other.ordered_corners_m[start:] + other.ordered_corners_m[:start] == IRREGULAR
    np.testing.assert_allclose(one.middle_m, other.middle_m)
    assert one.mean_radius_m == pytest.approx(other.mean_radius_m)


@pytest.mark.parametrize("corners", [IRREGULAR, IRREGULAR[::-1]])
def test_outside_of_an_edge_is_to_its_right_and_each_edge_keeps_from_the_others(corners: Corners) -> None:
    scene = scene_of(corners)
    features = target_features(scene.camera, scene.target)
    lines = features.lines[features.lines["feature"] == OUTLINE]
    assert len(set(lines["group"])) == 8
    assert set(lines["group"]) <= set(features.borders["group"])
    outline = np.array(corners, np.float32)
    for line in lines:
        along = np.array([line["b1"] - line["a1"], line["b2"] - line["a2"]])
        right = np.array([along[1], -along[0]])  # y2 is down in the image
        beside = 0.5 * np.array([line["a1"] + line["b1"], line["a2"] + line["b2"]]) + 0.01 * right
        assert cv2.pointPolygonTest(outline, (float(beside[0]), float(beside[1])), measureDist=False) < 0.0


def test_middle_and_mean_radius_of_a_polygon_are_those_of_its_area() -> None:
    square = Outline(corners_m=((1.0, 0.0), (3.0, 0.0), (3.0, 2.0), (1.0, 2.0)))
    assert square.middle_m == pytest.approx((2.0, 1.0))
    assert square.mean_radius_m == pytest.approx(math.sqrt(4.0 / math.pi))
    circle = Outline(radius_m=2.24, center_m=(0.0, 0.9))
    assert (circle.middle_m, circle.mean_radius_m) == ((0.0, 0.9), 2.24)


def test_renderer_draws_the_corners() -> None:
    part = parts_of(scene_of(L_SHAPE).target)[0]
    np.testing.assert_array_equal(part.corners_m, np.array(L_SHAPE))


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("shape", list(SHAPES))
def test_errors_of_an_outline_with_corners_agree_with_their_sigmas(shape: str) -> None:
    ratios = []
    for seed in range(3):
        for range_m in (9.0, 14.0, 22.0, 34.0):
            portion, found, _ = portion_at(scene_of(SHAPES[shape]), range_m, seed, finer=True)
            assert portion.frames == 10
            ratios.append(found[np.isfinite(found)])
    every = np.concatenate(ratios)
    # 12 portions, with 7 independent values if near and 5 if far: 1 sigma of the root mean square is 0.083
    assert abs(float(np.sqrt(np.mean(every**2))) - 1.0) < 0.25
    assert np.abs(every).max() < 5.0
