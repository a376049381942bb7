"""Cameras by libraries of vendors: GenTL with the producer in the genicam wheel."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import closing
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hil.config.tables.cameras import VisionCameras
from hil.drivers.cameras.base import Camera
from hil.drivers.cameras.gentl import PATH
from hil.drivers.cameras.interfaces import list_cameras, open_camera
from hil.errors import DeviceError
from tests.support.emulated_cameras import require_libaravis

SIZE = (320, 240)
VIKY = "VikyTL_DEV_red"


@pytest.fixture(autouse=True)
def vendors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the test without the libraries; offer their simulated cameras."""
    genicam = find_spec("genicam")
    if genicam is None or genicam.origin is None or find_spec("harvesters") is None:
        pytest.skip("needs pip install 'hil-bench[gentl]'")
    monkeypatch.setenv(PATH, os.path.dirname(genicam.origin))


def opened(identifier: str, size: tuple[int, int] = SIZE, rate_hz: float = 50.0, **settings: object) -> Camera:
    chosen = VisionCameras.model_validate({"interface": "gentl", **settings})
    return open_camera("vmu.left", identifier, chosen, size, rate_hz)


def taken(camera: Camera, count: int) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the numbers and images of ``count`` frames."""
    with closing(camera):
        camera.start()
        for _ in range(count):
            frame = camera.receive(2.0)
            assert frame is not None
            assert frame.image is not None
            assert np.isnan(frame.stamp_s)
            yield frame.number, frame.image


def test_images_of_a_gentl_producer_stay_after_their_buffer_is_used_again() -> None:
    frames = list(taken(opened(VIKY, trigger="none"), 20))
    assert {b[0] - a[0] for a, b in pairwise(frames)} == {1}
    for _, image in frames:  # a black ball on white
        assert image.shape == SIZE[::-1]
        assert np.unique(image).tolist() == [0, 255]
        assert 350 < np.count_nonzero(image == 0) <= 400


@pytest.mark.parametrize(
    ("identifier", "settings", "text"),
    [
        ("123", {}, "no camera '123'"),
        (VIKY, {"trigger": "none", "features": {"Nonsense": 1}}, "has no feature Nonsense"),
        (VIKY, {}, 'trigger = "software": the camera has no trigger'),
        (VIKY, {"trigger": "none", "pixel_format": "Mono12"}, "pixel format 'Mono12': the camera has RGBa8, Mono8"),
    ],
)
def test_a_camera_that_cannot_be_used_is_named_in_one_line(
    identifier: str, settings: dict[str, object], text: str
) -> None:
    with pytest.raises(DeviceError, match=re.escape(f"vmu.left: {text}")) as raised:
        opened(identifier, **settings)  # type: ignore[arg-type]
    assert "\n" not in str(raised.value)


def test_the_cameras_of_all_interfaces_are_listed() -> None:
    require_libaravis()
    assert {(VIKY, "gentl")} <= {(found.identifier, found.interface) for found in list_cameras()}


def test_a_folder_without_a_producer_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(PATH, str(tmp_path))
    with pytest.raises(DeviceError, match=r"vmu.left: no GenTL producer \(\*.cti\) in the folders of GENICAM_GENTL64"):
        opened(VIKY)
