"""Docking monitor and the four rolls at which a cross looks the same, on images of another renderer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.config.load import load_scene
from hil.config.scene import Box, Labels, Scene, Target
from hil.parts.monitor.features import quarter_rolled, target_features
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.results import ANY_ROLL_QUANTITIES, QUANTITIES, Result
from hil.parts.monitor.sources import VideoFrame
from tests.support.monitor_disturbances import MONITOR_ROWS
from tests.support.tv_pixels import TvCamera, TvTarget

BY_NAME = {row.name: row for row in MONITOR_ROWS}
UNSEEN = [name not in ANY_ROLL_QUANTITIES for name in QUANTITIES]


def portion(monitor: DockingMonitor, real: Scene, d3: float, first: int) -> Result:
    """Return the result of two frames of ``real`` at a distance of ``d3``, m."""
    rng, target = np.random.default_rng(first), TvTarget(real, TvCamera())
    for number in (first, first + 1):
        image = target.frame(lambda _: (np.array([0.05, -0.03, d3]), np.array([0.01, 0.0, 0.1])), 0.0, rng)
        monitor.feed(VideoFrame(number, number / real.fps, image))
    return monitor.finish()[0]


@pytest.mark.parametrize("roll_max_deg", [40.0, 180.0])
@pytest.mark.parametrize("name", ["ship rolled by 60 deg", "ship rolled by 90 deg"])
def test_ship_rolled_to_where_its_boxes_show_it_keeps_range_and_line_of_sight(name: str, roll_max_deg: float) -> None:
    """Its cross is found a quarter of a turn off: its boxes are where those of a ship rolled by that much would be."""
    tally = replace(BY_NAME[name], roll_max_deg=roll_max_deg).run(1, 3)
    assert tally.statuses == {"ambiguous": 1}, tally.line()
    assert [len(ratios) for ratios in tally.ratios] == [len(ANY_ROLL_QUANTITIES)]
    assert np.abs(np.concatenate(tally.ratios)).max() < 4.5


def test_ship_whose_boxes_are_nowhere_is_refused() -> None:
    scene = load_scene("atv").value
    real = scene.model_copy(update={"target": scene.target.model_copy(update={"boxes": ()})})
    assert portion(DockingMonitor(scene), real, 4.0, 0).status == "rejected_boxes"


def test_four_quarter_turns_are_the_target_itself() -> None:
    target = load_scene("atv").value.target
    once = quarter_rolled(target)
    assert (once.boxes, once.disc, once.cross) != (target.boxes, target.disc, target.cross)
    assert quarter_rolled(quarter_rolled(quarter_rolled(once))) == target


@pytest.mark.parametrize("name", ["ship rolled by 180 deg", "ship without boxes, rolled by 90 deg"])
def test_roll_that_no_part_distinguishes_is_ambiguous_with_range_and_line_of_sight(name: str) -> None:
    tally = BY_NAME[name].run(1, 3)
    assert tally.statuses == {"ambiguous": 1}, tally.line()
    assert [len(ratios) for ratios in tally.ratios] == [len(ANY_ROLL_QUANTITIES)]
    assert np.abs(np.concatenate(tally.ratios)).max() < 4.5


def test_stated_roll_is_measured_without_boxes() -> None:
    tally = BY_NAME["ship without boxes, roll stated"].run(1, 3)
    assert tally.statuses == {"near": 1}
    assert np.abs(np.concatenate(tally.ratios)).max() < 4.5


def test_labels_distinguish_rolls() -> None:
    """The labels of one scene are three: after any turn of the cross, one would be elsewhere."""
    scene = load_scene("atv").value
    target = scene.target.model_copy(
        update={"boxes": (), "labels": Labels(radius_m=0.022, centers_m=((0.24, 0.0), (-0.12, 0.2), (-0.12, -0.2)))}
    )
    real = scene.model_copy(update={"roll_max_deg": 180.0, "target": target})
    plain = real.model_copy(update={"target": target.model_copy(update={"labels": None})})
    monitor = DockingMonitor(real)
    assert portion(monitor, real, 4.0, 0).status == "near"
    monitor = DockingMonitor(plain)
    hidden = portion(monitor, plain, 4.0, 0)
    assert hidden.status == "ambiguous"
    assert np.isnan(hidden.values[UNSEEN]).all()
    assert abs(hidden.value("range_m") - np.linalg.norm([0.05, 0.03, 4.0])) < 5.0 * hidden.sigma("range_m")


def test_roll_determined_by_a_box_is_kept_while_the_target_is_followed_without_it() -> None:
    """From 3.4 m the only box is outside of the image."""
    scene = load_scene("atv").value
    box = Box(x_m=1.3, y_m=0.0, width_m=0.14, height_m=0.7)
    target = scene.target.model_copy(update={"boxes": (box,), "outline": None})
    scene = scene.model_copy(update={"roll_max_deg": 180.0, "target": target})
    rng, real = np.random.default_rng(3), TvTarget(scene, TvCamera())
    monitor, fresh, still_open = DockingMonitor(scene), DockingMonitor(scene), []
    for number, d3 in enumerate((4.0, 3.9, 3.8, 3.7, 3.6, 3.5, 3.4)):
        image = real.frame(lambda _, d3=d3: (np.array([0.05, 0.0, d3]), np.array([0.0, 0.0, 0.02])), 0.0, rng)
        monitor.feed(VideoFrame(number, number / scene.fps, image))
        assert monitor.last is not None
        assert monitor.last.status == "near"
        still_open.append(monitor.last.roll_open)
    fresh.feed(VideoFrame(0, 0.0, image))
    assert fresh.last is not None
    assert fresh.last.status == "near"
    assert (any(still_open), fresh.last.roll_open) == (False, True)


def test_turn_shows_in_the_parts_that_it_moves() -> None:
    scene = load_scene("atv").value
    features = target_features(scene.camera, scene.target)
    quarter, half, _ = features.partner_m
    assert half.max() < 1e-9  # everything on this ship looks the same after half a turn
    assert quarter.max() > 0.5
    assert target_features(scene.camera, replaced_box(scene)).partner_m[1].max() > 0.1


def replaced_box(scene: Scene) -> Target:
    """Return the target with one box of another width."""
    one, two = scene.target.boxes
    return scene.target.model_copy(update={"boxes": (one, two.model_copy(update={"width_m": 0.4}))})
