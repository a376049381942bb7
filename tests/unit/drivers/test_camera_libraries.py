"""Camera libraries that are not installed: one line names the packages."""

from __future__ import annotations

import re
import sys

import pytest

from hil.config.tables.cameras import CameraSettings
from hil.drivers.cameras.interfaces import open_camera
from hil.errors import DeviceError


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    text = "vmu.left: interface gentl needs the packages harvesters and genicam: "
    with pytest.raises(DeviceError, match=re.escape(text)):
        open_camera("vmu.left", "1", CameraSettings(interface="gentl"), (64, 64), 10.0)
