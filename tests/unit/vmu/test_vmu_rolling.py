"""Vision unit on cameras with a rolling shutter, by images whose rows are rendered one by one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hil.config.vmu_geometry import VmuGeometry
from hil.drivers.cameras.node_map import NodeMap
from hil.errors import DeviceError
from hil.parts.cameras.live import check_shutters, middle_row_s
from hil.vmu.unit import VisionUnit
from tests.support.vmu_disturbances import PERIOD_S, VERY_GOOD, Frames, Tally, known_geometry
from tests.support.vmu_rolling import TOP_DOWN_S, drawn_rolling, rolling_approach


def with_row_time(row_s: float | None) -> VmuGeometry:
    """Return the lab's geometry file with the row time of both cameras."""
    known = known_geometry(VERY_GOOD)
    left, right = (camera.model_copy(update={"row_time_s": row_s}) for camera in (known.left, known.right))
    return known.model_copy(update={"left": left, "right": right})


def solved(unit: VisionUnit, frames: Frames, count: int, seed: int) -> Tally:
    """Return the results of ``count`` frames, each without a track."""
    tally, rng = Tally(), np.random.default_rng([seed, 7])
    for k, (scene, truth) in enumerate(frames(rng, count)):
        unit.track.drop()
        tally.add(unit.solve(*scene.pair(truth.turn, truth.t_v, rng), PERIOD_S * k), truth, 0.0)
    return tally


@pytest.mark.parametrize(
    ("speed_mps", "rate_degps", "row_s"),
    [(0.3, 0.0, TOP_DOWN_S), (0.0, 10.0, TOP_DOWN_S), (0.3, 10.0, 10e-6), (0.3, 10.0, -TOP_DOWN_S), (0.2, 5.0, 60e-6)],
)
def test_poses_of_a_moving_ring_are_within_their_sigmas(speed_mps: float, rate_degps: float, row_s: float) -> None:
    unit = VisionUnit(with_row_time(row_s))
    tally = solved(unit, drawn_rolling(speed_mps, rate_degps, row_s, 0.8), 6, 3)
    assert tally.solved == 6, tally.line()
    assert np.abs(tally.ratios).max() < 4.5, tally.line()


def test_rates_of_the_track_move_the_leds_between_the_rows() -> None:
    unit, rng, tally = VisionUnit(with_row_time(TOP_DOWN_S)), np.random.default_rng([2, 7]), Tally()
    for k, (scene, truth) in enumerate(rolling_approach(0.3, 10.0)(rng, 9)):
        tally.add(unit.solve(*scene.pair(truth.turn, truth.t_v, rng), PERIOD_S * k), truth, 0.0)
    assert tally.solved == 9, tally.line()
    assert np.abs(tally.ratios).max() < 4.5, tally.line()
    off = unit.solver.scene.motion[0] - np.concatenate([scene.speed, scene.rate])
    assert np.abs(off).max() < 0.1


def test_row_time_that_is_not_stated_is_what_the_poses_lack() -> None:
    tally = solved(VisionUnit(with_row_time(None)), drawn_rolling(0.3, 0.0), 6, 3)
    assert np.abs(tally.ratios).max() > 5.0, tally.line()


def test_rolling_shutter_without_a_row_time_is_refused_with_the_key() -> None:
    stated, not_stated = with_row_time(TOP_DOWN_S), with_row_time(None)
    check_shutters({"vmu.left": "Rolling", "vmu.right": "Global"}, stated)
    check_shutters({"vmu.left": "Global", "vmu.right": ""}, not_stated)
    with pytest.raises(DeviceError, match=r"vmu\.right: .*SensorShutterMode = Rolling.*right\.row_time_s"):
        check_shutters({"vmu.left": "Global", "vmu.right": "Rolling"}, not_stated)
    assert middle_row_s(stated) == pytest.approx(TOP_DOWN_S * 511.5)
    assert middle_row_s(not_stated) == 0.0


@pytest.mark.parametrize(("nodes", "shutter"), [({"SensorShutterMode": "Rolling"}, "Rolling"), ({}, "")])
def test_shutter_is_read_from_the_camera(nodes: dict[str, str], shutter: str) -> None:
    def find(feature: str) -> object:
        return SimpleNamespace(value=nodes[feature]) if feature in nodes else None

    assert NodeMap("vmu.left", find, RuntimeError).shutter == shutter
