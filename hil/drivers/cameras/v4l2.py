"""V4L2 cameras by OpenCV: free-running, without time stamps of their own."""

from __future__ import annotations

import fcntl
import os
import struct
from pathlib import Path
from typing import Final

import numpy as np

from hil.config.camera_identity import CameraIdentity
from hil.config.tables.cameras import CameraSettings
from hil.drivers.cameras.base import CameraFrame, CameraInfo, check_size
from hil.errors import DeviceError, LinkLost

_MANUAL: Final = 1  # V4L2_EXPOSURE_MANUAL
_UNIT_S: Final = 1e-4  # V4L2: units of 100 us
_TOLERANCE: Final = 0.1
_QUERY_CAPABILITIES: Final = 0x8068_5600  # VIDIOC_QUERYCAP
_CAPABILITIES: Final = struct.Struct("16s32s32sIII12x")  # driver, card, bus, version, capabilities of device and node
_SYSTEM: Final = Path("/sys/class/video4linux")
_VIDEO_CAPTURE: Final = 0x1 | 0x1000  # single-planar, multi-planar


class V4l2Camera:
    """A V4L2 device; see ``open_camera``. Its frames have numbers of this host and the time of their arrival."""

    def __init__(
        self, name: str, identifier: str, settings: CameraSettings, size: tuple[int, int], rate_hz: float
    ) -> None:
        import cv2  # slow to import

        self._name, self._identifier = name, identifier
        self._size = size
        self._frames = 0
        if settings.trigger != "none":
            raise DeviceError(name, f'trigger = "{settings.trigger}": V4L2 cameras have "none"')
        if settings.pixel_format != "Mono8":
            raise DeviceError(name, f'pixel_format = "{settings.pixel_format}": of V4L2 cameras allowed is "Mono8"')
        if settings.gain_db is not None:
            raise DeviceError(
                name, f"gain_db = {settings.gain_db:g}: the gain of V4L2 cameras has no unit, leave it out"
            )
        if settings.features:
            raise DeviceError(name, f"features {', '.join(settings.features)}: V4L2 cameras have none, leave them out")
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what it logs is raised below
        self._capture = cv2.VideoCapture(identifier, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise LinkLost(name, f"no camera {identifier!r}")
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, size[0]),
            (cv2.CAP_PROP_FRAME_HEIGHT, size[1]),
            (cv2.CAP_PROP_FPS, rate_hz),
            (cv2.CAP_PROP_BUFFERSIZE, 1),
        ):
            self._capture.set(key, value)
        if settings.exposure_s is not None:
            self.set_exposure(settings.exposure_s)

    @property
    def shutter(self) -> str:
        return ""

    @property
    def identity(self) -> CameraIdentity:
        node = _SYSTEM / Path(self._identifier).resolve().name
        return CameraIdentity(model=_line(node / "name"), serial=_line((node / "device").resolve().parent / "serial"))

    @property
    def packet_bytes(self) -> int:
        return 0

    def start(self) -> None:
        """Do nothing: the device runs when it is read."""

    def trigger(self) -> None:
        """Raise DeviceError: the device has no software trigger."""
        raise DeviceError(self._name, "has no software trigger")

    def receive(self, timeout_s: float) -> CameraFrame | None:
        """Return the next frame; waits for it, at most as long as the driver does."""
        import cv2

        whole, image = self._capture.read()
        if not whole or image is None:
            raise LinkLost(self._name, "sends no images")
        grey = np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        check_size(self._name, (grey.shape[1], grey.shape[0]), self._size)
        self._frames += 1
        return CameraFrame(grey, self._frames)

    def set_exposure(self, exposure_s: float) -> None:
        """Set the exposure time."""
        import cv2

        for key, value, what in (
            (cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL, "manual exposure"),
            (cv2.CAP_PROP_EXPOSURE, max(1, round(exposure_s / _UNIT_S)), f"exposure_s = {exposure_s:g}"),
        ):
            self._capture.set(key, value)
            if abs(self._capture.get(key) - value) > _TOLERANCE * value:
                raise DeviceError(self._name, f"{what}: the camera does not take it")

    def close(self) -> None:
        """Release the device. Idempotent."""
        self._capture.release()


def _line(path: Path) -> str | None:
    """Return the line of a file of the system, None without one."""
    return path.read_text(errors="replace").strip() or None if path.is_file() else None


def _captures(path: Path) -> bool:
    """Return whether a node gives images; cameras have further ones, of metadata."""
    try:
        descriptor = os.open(f"/dev/{path.name}", os.O_RDWR | os.O_NONBLOCK)
    except OSError:  # in use, or without permission: the first node of a device gives its images
        index = path / "index"
        return not index.exists() or index.read_text().strip() == "0"
    try:
        answer = fcntl.ioctl(descriptor, _QUERY_CAPABILITIES, bytes(_CAPABILITIES.size))
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return bool(_CAPABILITIES.unpack(answer)[5] & _VIDEO_CAPTURE)


def found_devices(folder: Path = _SYSTEM) -> list[CameraInfo]:
    """Return the video devices of this host that give images."""
    devices = []
    for path in sorted(folder.glob("video*")):
        if not _captures(path):
            continue
        model = (path / "name").read_text(errors="replace").strip()
        devices.append(CameraInfo(f"/dev/{path.name}", "", model, "", f"/dev/{path.name}", "V4L2", "v4l2"))
    return devices
