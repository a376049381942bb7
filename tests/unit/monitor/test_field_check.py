"""Fields in frames that the scene states as whole: found from the images, named, and measured with no wrong sigmas."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_scene
from hil.config.scene import PixelNoise, Scene
from hil.parts.monitor.field_check import FieldCheck, FieldDifference
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.motion import Motion
from hil.parts.monitor.render import Conditions, TargetRenderer
from hil.parts.monitor.results import Result
from hil.parts.monitor.sources import VideoFrame

PLACE = np.array([0.15, -0.1, 5.0]), np.array([-0.02, -0.03, 0.03])
RATES = np.array([0.004, -0.003, -0.08]), np.array([5e-4, -1e-3, 1e-3])


@pytest.fixture(scope="module")
def atv() -> Scene:
    """Return the shipped ATV-like scene, whose frames are whole."""
    return load_scene("atv").value


def images_of(scene: Scene, fields: str, speed: float, images: int) -> Iterator[np.ndarray]:
    """Yield images that hold ``fields`` ("": whole). speed: times RATES."""
    renderer, rng = TargetRenderer(scene, conditions=Conditions(noise=PixelNoise(read=2.0))), np.random.default_rng(2)

    def image_at(t_s: float) -> np.ndarray:
        d, phi = (place + speed * t_s * rate for place, rate in zip(PLACE, RATES, strict=True))
        return renderer.image(d, phi, t_s, rng)

    for k in range(images):
        image = image_at(k / scene.fps)
        if fields:
            second = 1 if fields == "upper_first" else 0
            image[second::2] = image_at((k + 0.5) / scene.fps)[second::2]
        yield image


def watched(scene: Scene, fields: str, speed: float = 1.0, images: int = 20) -> tuple[list[Result], DockingMonitor]:
    """Return the portions of ``images_of``, and their monitor."""
    monitor, found = DockingMonitor(scene), []
    for k, image in enumerate(images_of(scene, fields, speed, images)):
        found += monitor.feed(VideoFrame(k, k / scene.fps, image))
    return found + monitor.finish(), monitor


@pytest.mark.parametrize("fields", ["upper_first", "lower_first"])
def test_fields_are_found_and_their_frames_give_no_numbers(atv: Scene, fields: str) -> None:
    portions, monitor = watched(atv, fields)
    assert [portion.status for portion in portions] == ["rejected_fields"] * 2
    assert all(np.isnan(portion.values).all() and np.isnan(portion.sigmas).all() for portion in portions)
    assert monitor.warning == f'frames hold two fields: set fields = "{fields}" in the scene'
    assert portions[0].reasons == portions[1].reasons == ((monitor.warning, 10),)
    assert monitor.last is not None
    assert (monitor.last.status, monitor.last.reason) == ("rejected_fields", monitor.warning)
    stated = atv.model_copy(update={"fields": fields})
    measured, suited = watched(stated, "", images=1)
    assert (measured[0].status, suited.warning) == ("near", "")


@pytest.mark.parametrize("speed", [1.0, 0.02, 0.0])
def test_whole_frames_are_measured_as_before(atv: Scene, speed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    portions, monitor = watched(atv, "", speed)
    assert monitor.warning == ""
    monkeypatch.setattr(FieldCheck, "add", lambda *_: None)
    plain, _ = watched(atv, "", speed)
    for one, other in zip(portions, plain, strict=True):
        assert (one.status, one.timing) == (other.status, other.timing) == ("near", "")
        np.testing.assert_array_equal(one.values, other.values)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_fields_of_a_target_at_rest_are_whole_frames(atv: Scene) -> None:
    portions, monitor = watched(atv, "upper_first", speed=0.0, images=10)
    assert ([portion.status for portion in portions], monitor.warning) == (["near"], "")


def test_a_tolerance_of_time_that_has_the_fields_keeps_the_numbers_and_they_are_named(atv: Scene) -> None:
    """Half of 40 ms between the fields, as ``time_s``."""
    tolerances = atv.camera.tolerances.model_copy(update={"time_s": 0.02})
    scene = atv.model_copy(update={"camera": atv.camera.model_copy(update={"tolerances": tolerances})})
    portions, monitor = watched(scene, "upper_first", images=10)
    assert [(portion.status, portion.timing) for portion in portions] == [("near", "two fields")]
    assert "upper_first" in monitor.warning


def test_command_prints_what_to_set(atv: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, summary = tmp_path / "frames", tmp_path / "summary.json"
    folder.mkdir()
    for k, image in enumerate(images_of(atv, "lower_first", 1.0, 10)):
        cv2.imwrite(str(folder / f"{k:03d}.png"), image)
    out = tmp_path / "out.csv"
    assert execute(["monitor", str(folder), "--scene", "atv", "--out", str(out), "--json", str(summary)]) == 0
    warning = 'frames hold two fields: set fields = "lower_first" in the scene'
    assert f"Warning: {warning}" in " ".join(capsys.readouterr().out.split())
    told = json.loads(summary.read_text())
    assert (told["warning"], told["portions_by_status"]) == (warning, {"rejected_fields": 1})
    assert ",rejected_fields,nan," in out.read_text()


def motion(rate: float) -> Motion:
    w = np.zeros(12)
    w[5] = rate
    return Motion(0.0, w, np.eye(12), np.eye(12))


def decided(scene: Scene, differences: Callable[[int], float], rate: float = 0.05) -> tuple[str, bool]:
    """Return what ten differences along d3, m, of 1 mm (1 sigma) each decide."""
    check = FieldCheck(scene)
    for k in range(10):
        check.add(FieldDifference(np.array([0.0, 0.0, differences(k), 0.0, 0.0, 0.0]), 1e6 * np.eye(6)))
    check.update(motion(rate))
    return check.order, check.decided


def test_likelihood_decides_and_unexplained_differences_do_not(atv: Scene) -> None:
    """Half a period at 0.05 m/s is 2 mm; differences of 10 and 20 mm are neither of the two, one of 1 mm is either."""
    scatter = [0.3e-3 * (-1.0) ** k for k in range(10)]
    assert decided(atv, lambda k: 2e-3 + scatter[k]) == ("upper_first", True)
    assert decided(atv, lambda k: -2e-3 + scatter[k]) == ("lower_first", True)
    assert decided(atv, lambda k: scatter[k]) == ("", True)
    assert decided(atv, lambda k: 1e-3 + scatter[k]) == ("", False)
    assert decided(atv, lambda k: 10e-3 + scatter[k]) == ("", False)
    assert decided(atv, lambda k: 20e-3 * (-1.0) ** k) == ("", False)
    assert decided(atv, lambda k: 2e-3, rate=0.001) == ("", False)
    check = FieldCheck(atv)
    check.add(None)
    check.drop()
    check.update(motion(1.0))
    assert (check.order, check.decided, check.warning) == ("", False, "")
    assert FieldCheck(load_scene("bright-cross").value).decided
