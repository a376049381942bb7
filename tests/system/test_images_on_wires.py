"""Images of the emulated rig, whose vision unit and docking monitor are processes of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.scene import Scene
from hil.config.vmu_geometry import VmuGeometry
from hil.core.camera_images import GEOMETRY_FILE, SCENE_FILE
from hil.parts.vision.replay_images import replay_monitor, replay_vision_unit
from hil.recording.images import pairs
from hil.recording.read import load
from hil.recording.replay import replay
from tests.support.run_settings import UNHURRIED, typed

pytestmark = pytest.mark.wires

SETTINGS = (
    "vmu.source=rendered",
    "monitor.source=rendered",
    "rig.vmu.rate_hz=4.0",  # a busy computer draws and encodes these as well
    "rig.recording.images=png",
    "rig.recording.image_interval_s=0",
)


@pytest.mark.slow
def test_images_of_a_rig_on_wires_replay_bit_by_bit(tmp_path: Path) -> None:
    arguments = ("--rig", "emulated", "--duration", "6", "--record", str(tmp_path))
    assert execute(["run", "scheme-1", *typed(*SETTINGS, *UNHURRIED), *arguments]) in (0, 1)
    (path,) = tmp_path.glob("*.mcap")
    recorded = load(path)
    assert recorded.end is not None
    assert recorded.end["dropped"] == "0"
    for found in (
        replay_vision_unit(recorded, recorded.calibration(GEOMETRY_FILE, VmuGeometry)),
        replay_monitor(recorded, recorded.calibration(SCENE_FILE, Scene)),
    ):
        assert found.identical, (found.statuses, found.differences, found.remarks)
        assert found.compared >= 5
    used = recorded.arrivals[recorded.arrivals["cycle"] >= 0]
    by_frame = {round(1e6 * f["frame"]["t_s"]): float(f["pose"]["t_s"]) for f in used}
    in_the_run = [left for left, _ in pairs(path) if left.t_s >= 0.0]
    same = [(left.t_s, by_frame[key]) for left in in_the_run if (key := round(1e6 * left.bench_s)) in by_frame]
    assert len(same) > 15
    np.testing.assert_allclose(*zip(*same, strict=True), atol=0.03)  # a lost period moves the run's time by 0.02 s
    assert replay(recorded, recorded.scenario).identical
