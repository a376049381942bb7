"""Overlay of the vision unit's images: positions, and the most important shapes first."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from hil.config.load import load_rig
from hil.core.camera_images import Shape
from hil.maths.random_streams import stream
from hil.vmu.geometry import camera_pair, geometry_of_rig, led_positions
from hil.vmu.overlay import IDENTITY, LED, NOTE, SPOT, STATUS, VALUE, draw, lines, shapes
from hil.vmu.render import Extras, Light, RingAppearance, RingRenderer, projections
from hil.vmu.unit import Solution, VisionUnit

AHEAD = np.array([0.05, -0.02, 2.0])
FACING = np.array([0.0, 0.0, 0.0, 1.0])
DECOY = (0.3, 0.2, 2.0)


@pytest.fixture(scope="module")
def seen() -> tuple[VisionUnit, np.ndarray, np.ndarray, Solution, np.ndarray]:
    """Return a unit, a pair with a light that is no LED, its solution, and the true positions of the LEDs."""
    geometry = geometry_of_rig(load_rig("mock").value)
    pair, leds = camera_pair(geometry), led_positions(geometry)
    renderer, unit = RingRenderer(pair, leds, RingAppearance()), VisionUnit(geometry)
    left, right = renderer.pair(AHEAD, FACING, None, stream(0, "pictures"), Extras(lights=[Light(DECOY)]))
    return unit, left, right, unit.solve(left, right, 0.0), projections(pair, leds, AHEAD, FACING)


def parts(found: list[Shape]) -> dict[str, list[Shape]]:
    return {
        part: [shape for shape in found if shape["part"] == part] for part in (STATUS, VALUE, NOTE, LED, SPOT, IDENTITY)
    }


@pytest.mark.parametrize("camera", [0, 1])
def test_leds_spots_and_numbers_are_drawn_at_the_leds(seen: tuple, camera: int) -> None:
    unit, _, _, solution, truth = seen
    assert solution.status == "ok"
    found = parts(shapes(unit.solver.scene, solution, camera))
    np.testing.assert_allclose([shape["at"] for shape in found[LED]], truth[camera], atol=0.5)
    good = [shape for shape in found[SPOT] if shape["good"]]
    others = [shape for shape in found[SPOT] if not shape["good"]]
    assert (len(good), len(others), len(found[IDENTITY])) == (6, 1, 6)
    for circle, name in zip(good, found[IDENTITY], strict=True):
        np.testing.assert_allclose(circle["at"], truth[camera][int(name["text"])], atol=0.5)


def test_text_comes_first_with_pose_and_sigmas(seen: tuple) -> None:
    unit, _, _, solution, _ = seen
    found = shapes(unit.solver.scene, solution, 0)
    words = [shape for shape in found if shape["kind"] == "text" and shape["part"] != IDENTITY]
    assert found[: len(words)] == words
    assert words[0]["text"] == "ok  6 LEDs"
    assert words[1]["text"].startswith("t  +0.0")
    assert words[2]["text"].startswith("sigma ")
    assert all(shape["good"] for shape in words)
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_without_a_pose_there_are_spots_alone(seen: tuple) -> None:
    unit, _, _, solution, _ = seen
    none = tuple([-1] * 6)
    lost = Solution(0.0, "ambiguous", None, solution.spots, (none, none), candidates=2)
    found = parts(shapes(unit.solver.scene, lost, 0))
    assert (len(found[SPOT]), found[LED], found[IDENTITY]) == (7, [], [])
    assert not any(shape["good"] for group in found.values() for shape in group)
    assert lines(lost) == [("ambiguous  0 LEDs", STATUS), ("2 poses fit the spots", NOTE)]


def test_the_overlay_of_hil_vmu_paints_these_shapes(seen: tuple) -> None:
    unit, left, right, solution, _ = seen
    picture = draw(unit.solver.scene, left, right, solution, "frame 7")
    assert picture.shape == (1024, 2048, 3)
    plain = cv2.cvtColor(np.hstack((left, right)), cv2.COLOR_GRAY2BGR)
    for camera in (0, 1):
        for shape in shapes(unit.solver.scene, solution, camera):
            if shape["kind"] != "circle":
                continue
            u, v = round(shape["at"][0] + shape["radius"]) + 1024 * camera, round(shape["at"][1])
            blue, green, red = picture[v - 1 : v + 2, u - 1 : u + 2].reshape(-1, 3).max(axis=0).astype(int)
            assert (green if shape["good"] else red) > plain[v, u].max() + 60
            assert (green > red) == shape["good"]
            assert blue < 200
