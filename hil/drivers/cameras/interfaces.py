"""Interfaces of cameras: their drivers by name, which are imported when they are used."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any, Final

from hil.config.tables.cameras import CameraInterface, CameraSettings
from hil.drivers.cameras.base import Camera, CameraInfo, CameraType
from hil.drivers.cameras.genicam import found_cameras
from hil.drivers.cameras.v4l2 import found_devices

_DRIVERS: Final[dict[CameraInterface, str]] = {
    "genicam": "genicam:GenicamCamera",
    "gentl": "gentl:GentlCamera",
    "v4l2": "v4l2:V4l2Camera",
}


def camera_type(interface: CameraInterface) -> CameraType:
    """Return the driver of ``interface``; the first call imports it."""
    driver: CameraType = _imported(_DRIVERS[interface])
    return driver


def _imported(path: str) -> Any:
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(f"hil.drivers.cameras.{module}"), name)


def open_camera(name: str, identifier: str, settings: CameraSettings, size: tuple[int, int], rate_hz: float) -> Camera:
    """Return the camera ``identifier``, set up for images of ``size`` (width, height), px. Raises DeviceError.

    name: of the device in errors.
    """
    return camera_type(settings.interface)(name, identifier, settings, size, rate_hz)


def list_cameras() -> list[CameraInfo]:
    """Return the cameras that answer, once per interface. Raises DeviceError without libaravis."""
    by_producers = _imported("gentl:found_gentl")() if importlib.util.find_spec("harvesters") is not None else []
    return [*found_cameras(), *found_devices(), *by_producers]
