"""Docking monitor on a live camera: an emulated GigE Vision camera, the camera process and the monitor's process."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from hil.cli.main import BAD_INPUT, execute
from hil.config.load import load_rig, load_scenario, load_scene
from hil.core.clock import WallClock
from hil.core.messages import CYCLE
from hil.drivers.cameras.brightness import BrightnessControl
from hil.errors import LinkLost
from hil.frmn.image_memory import RunTime
from hil.frmn.ring import Ring
from hil.maths.random_streams import stream
from hil.parts.monitor.render import Conditions, TargetRenderer
from hil.parts.monitor.results import PORTION
from hil.parts.monitor.setup import LiveClock, MonitorOutcome, MonitorProcess, MonitorRings, RingPortions
from tests.support.emulated_cameras import emulated, require_libaravis
from tests.support.run_settings import typed

ADDRESS = "127.0.0.4"
RANGE_M = 3.0
RIG = ("rig.monitor_camera.timeout_s=3.0", "rig.monitor_camera.brightness_levels=180.0")
WAIT_S = 60.0


def image_of_target() -> np.ndarray:
    scene = load_scene("atv").value
    renderer = TargetRenderer(scene, scene.chosen("basic"), Conditions(gain=0.5))
    d, phi = np.array([0.02, -0.01, RANGE_M]), np.zeros(3)
    return renderer.frame(0, lambda _: (d, phi), stream(0, "monitor")).image


def monitored(address: str, until: Callable[[RingPortions], None]) -> MonitorOutcome:
    """Return the results of a monitor of the camera at ``address``, which runs until ``until`` returns."""
    scenario = load_scenario("scheme-1", ["monitor.source=camera"]).value
    rig = load_rig("emulated", [*RIG, f'rig.monitor_camera.camera="{address}"']).value
    clock, run_time = WallClock(), RunTime()
    run_time.set_zero(clock.now_s())
    ring, portions = Ring.create(CYCLE, 16), Ring.create(PORTION, 64, "portions")
    times = LiveClock(clock.epoch_ns, clock.speed, run_time.descriptor)
    try:
        with MonitorProcess(
            scenario, load_scene("atv").value, rig, 0, MonitorRings(ring, None, portions), times
        ) as process:
            process.wait_ready()
            until(RingPortions(portions))
            return process.finish()
    finally:
        for each in (ring, portions, run_time):
            each.close()


@pytest.mark.slow
@pytest.mark.wires
def test_it_measures_and_the_brightness_is_controlled_and_a_dead_camera_ends_the_monitor_alone() -> None:
    image = image_of_target()
    found = []

    def until(source: RingPortions) -> None:
        end_s = time.monotonic() + WAIT_S
        while time.monotonic() < end_s and sum(portion.status == "near" for portion in found) < 3:
            time.sleep(0.1)
            found.extend(source.poll())
        camera.faults.on("link_down")
        time.sleep(6.0)

    with emulated(ADDRESS, lambda _: image, (image.shape[1], image.shape[0]), 0.01) as camera:
        outcome = monitored(ADDRESS, until)
    near = [portion for portion in found if portion.status == "near"]
    assert len(near) >= 3
    ranges = np.array([portion.value("range_m") for portion in near])
    assert np.abs(ranges - RANGE_M).max() < 0.01
    assert outcome.failure.startswith("monitor: no image for ")
    assert outcome.frames > 30


@pytest.mark.slow
@pytest.mark.wires
def test_a_missing_camera_is_named_in_one_line() -> None:
    require_libaravis()
    with pytest.raises(LinkLost, match=r"monitor: no camera '127.0.0.9'"):
        monitored("127.0.0.9", lambda _: None)


def test_a_mock_rig_has_no_camera(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["run", "scheme-1", *typed("monitor.source=camera")]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line == '--set: monitor.source: "camera": rig "mock" is in memory, use one on wires, as emulated'


@pytest.mark.parametrize("scene_level", [30.0, 2000.0])
def test_brightness_reaches_its_level_and_stays(scene_level: float) -> None:
    """scene_level: of the image at 10 ms; 8 bits saturate."""
    control, changes = BrightnessControl(180.0, 0.01, 0.1), []
    for k in range(60):
        level = min(255.0, scene_level * control.exposure_s / 0.01)
        if control.update(np.full((40, 40), round(level), np.uint8)):
            changes.append(k)
    assert scene_level * control.exposure_s / 0.01 == pytest.approx(180.0, rel=0.1)
    assert max(changes) < 40


def test_exposure_has_a_longest_time() -> None:
    control = BrightnessControl(180.0, 0.01, 0.02)
    for _ in range(30):
        control.update(np.zeros((40, 40), np.uint8))
    assert control.exposure_s == 0.02
