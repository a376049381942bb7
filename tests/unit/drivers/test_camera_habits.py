"""Cameras that differ: gain in units of their own, no time stamps, odd trigger selectors, V4L2 in automatic mode."""

from __future__ import annotations

import math
from types import SimpleNamespace

import cv2
import pytest

from hil.config.tables.cameras import CameraSettings
from hil.drivers.cameras.base import stamp_of
from hil.drivers.cameras.node_map import NodeMap
from hil.drivers.cameras.v4l2 import V4l2Camera, found_devices
from hil.errors import DeviceError


class Node(SimpleNamespace):
    """A feature of GenApi."""

    def from_string(self, text: str) -> None:
        if not self.sticks:
            self.value = type(self.value)(float(text)) if isinstance(self.value, float | int) else text


def node(value: object, **more: object) -> Node:
    defaults = {"sticks": False, "symbolics": (), "unit": "", "min": 0.0, "max": 24.0, "inc": 1}
    return Node(**{"value": value, **defaults, **more})


def camera(**features: Node) -> tuple[NodeMap, dict[str, Node]]:
    nodes = {
        "PixelFormat": node("Mono8", symbolics=("Mono8",)),
        "Width": node(64, max=64),
        "Height": node(64, max=64),
        "AcquisitionFrameRate": node(10.0),
        **features,
    }
    return NodeMap("vmu.left", nodes.get, ValueError), nodes


def set_up(settings: dict[str, object], **features: Node) -> dict[str, Node]:
    nodes_of, nodes = camera(**features)
    nodes_of.set_up(CameraSettings.model_validate({"trigger": "none", **settings}), (64, 64), 10.0)
    return nodes


def test_gain_in_db_is_set_with_the_automatic_one_off() -> None:
    nodes = set_up({"gain_db": 6.0}, Gain=node(0.0, unit="dB"), GainAuto=node("Continuous"))
    assert (nodes["Gain"].value, nodes["GainAuto"].value) == (6.0, "Off")


@pytest.mark.parametrize(
    ("features", "text"),
    [
        ({"GainRaw": node(300)}, "the camera has GainRaw alone, in units of its own"),
        ({"Gain": node(0.0, unit="")}, "the unit of its Gain is not declared"),
        ({"Gain": node(0.0, unit="%")}, "the unit of its Gain is %"),
        ({"Gain": node(0.0, unit="dB", max=4.0)}, "gain_db = 6: allowed 0 to 4"),
        ({"Gain": node(0.0, unit="dB", sticks=True)}, "the camera reports 0"),
    ],
)
def test_gain_that_cannot_be_set_in_db_is_refused(features: dict[str, Node], text: str) -> None:
    with pytest.raises(DeviceError, match=text):
        set_up({"gain_db": 6.0}, **features)


@pytest.mark.parametrize(
    ("selectors", "chosen"),
    [
        (("AcquisitionStart", "FrameStart"), "FrameStart"),
        (("ExposureStart", "ExposureActive"), "ExposureStart"),
        (("AcquisitionStart",), "AcquisitionStart"),
        (("ExposureActive", "LineStart"), None),
    ],
)
def test_trigger_is_one_that_starts_an_exposure(selectors: tuple[str, ...], chosen: str | None) -> None:
    features = {
        "TriggerSelector": node(selectors[-1], symbolics=selectors),
        "TriggerMode": node("Off"),
        "TriggerSource": node("Line0", symbolics=("Line1", "Software")),
    }
    if chosen is None:
        with pytest.raises(DeviceError, match="trigger selectors ExposureActive, LineStart: none of FrameStart"):
            set_up({"trigger": "software"}, **features)
        return
    nodes = set_up({"trigger": "software"}, **features)
    assert (nodes["TriggerSelector"].value, nodes["TriggerMode"].value) == (chosen, "On")


def test_time_stamp_that_is_zero_is_none() -> None:
    assert math.isnan(stamp_of(0.0))
    assert stamp_of(12.5) == 12.5


class Capture:
    """A V4L2 device of OpenCV; ``automatic`` ignores what is set."""

    def __init__(self, automatic: bool) -> None:
        self.automatic = automatic
        self.values: dict[int, float] = {cv2.CAP_PROP_AUTO_EXPOSURE: 3.0}

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        if not self.automatic:
            self.values[key] = value
        return True

    def get(self, key: int) -> float:
        return self.values.get(key, 0.0)


def opened(monkeypatch: pytest.MonkeyPatch, automatic: bool, **settings: object) -> Capture:
    device = Capture(automatic)
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: device)
    chosen = CameraSettings.model_validate({"interface": "v4l2", "trigger": "none", **settings})
    V4l2Camera("vmu.left", "/dev/video0", chosen, (64, 64), 10.0)
    return device


def test_v4l2_camera_is_switched_to_manual_exposure(monkeypatch: pytest.MonkeyPatch) -> None:
    device = opened(monkeypatch, automatic=False, exposure_s=0.004)
    assert device.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    assert device.values[cv2.CAP_PROP_EXPOSURE] == 40


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"exposure_s": 0.004}, "manual exposure: the camera does not take it"),
        ({"gain_db": 3.0}, "gain_db = 3: the gain of V4L2 cameras has no unit"),
        ({"features": {"Gamma": 1}}, "features Gamma: V4L2 cameras have none"),
    ],
)
def test_v4l2_setting_without_effect_is_refused(monkeypatch, settings: dict[str, object], text: str) -> None:
    with pytest.raises(DeviceError, match=text):
        opened(monkeypatch, automatic=True, **settings)


def test_metadata_nodes_are_not_listed(tmp_path) -> None:
    for name, index in (("video900", 0), ("video901", 1)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "name").write_text("camera\n")
        (tmp_path / name / "index").write_text(f"{index}\n")
    assert [found.identifier for found in found_devices(tmp_path)] == ["/dev/video900"]
