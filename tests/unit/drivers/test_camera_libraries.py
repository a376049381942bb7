"""Camera libraries that are not installed: one line names the package."""

from __future__ import annotations

import sys

import pytest

from hil.config.cameras import CameraInterface, CameraSettings
from hil.drivers.cameras.interfaces import open_camera
from hil.errors import DeviceError


@pytest.mark.parametrize(
    ("interface", "module", "text"),
    [
        ("pylon", "pypylon.pylon", "vmu.left: interface pylon needs the package pypylon: "),
        ("gentl", "harvesters.core", "vmu.left: interface gentl needs the packages harvesters and genicam: "),
    ],
)
def test_a_missing_library_is_named(
    interface: CameraInterface, module: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DeviceError) as raised:
        open_camera("vmu.left", "1", CameraSettings(interface=interface), (64, 64), 10.0)
    assert str(raised.value).startswith(text)
