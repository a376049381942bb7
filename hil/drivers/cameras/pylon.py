"""GenICam cameras of Basler by pylon (package pypylon), which emulates cameras of its own: PYLON_CAMEMU."""

from __future__ import annotations

import contextlib
import math
from typing import Any, Final

import numpy as np

from hil.config.cameras import CameraSettings
from hil.drivers.cameras.base import BITS, CameraFrame, CameraInfo, check_size, to_8_bits
from hil.drivers.cameras.node_map import NodeMap, link_lost, reason, vendor_module
from hil.errors import DeviceError, LinkLost

_BUFFERS: Final = 8
_TRIGGER_READY_MS: Final = 100
_NS: Final = 1e-9


class PylonCamera:
    """A camera, set up and ready to start; see ``open_camera``. identifier: its serial number, name or IP address."""

    def __init__(
        self, name: str, identifier: str, settings: CameraSettings, size: tuple[int, int], rate_hz: float
    ) -> None:
        self._name = name
        self._pylon, genicam = _library(name)
        self._errors: tuple[type[Exception], ...] = (genicam.GenericException,)
        self._bits = BITS[settings.pixel_format]
        self._size = size
        self._camera: Any = None
        factory = self._pylon.TlFactory.GetInstance()
        try:
            with link_lost(name, self._errors):
                device = next((found for found in factory.EnumerateDevices() if identifier in _names(found)), None)
                if device is None:
                    raise LinkLost(name, f"no camera {identifier!r}")
                self._camera = self._pylon.InstantCamera(factory.CreateDevice(device))
                self._camera.MaxNumBuffer.Value = _BUFFERS
                self._camera.Open()
                nodes = self._camera.GetNodeMap()
                self._nodes = NodeMap(
                    name, lambda feature: _available(genicam, nodes, feature), genicam.GenericException
                )
                self._nodes.set_up(settings, size, rate_hz)
                self._tick_s = _NS
                if self._nodes.has("GevTimestampTickFrequency"):
                    self._tick_s = 1.0 / self._nodes.whole("GevTimestampTickFrequency")
        except BaseException:
            self.close()
            raise

    @property
    def shutter(self) -> str:
        """See ``Camera``."""
        return self._nodes.shutter

    def start(self) -> None:
        """Start the acquisition. Raises DeviceError."""
        with link_lost(self._name, self._errors, "acquisition"):
            self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def trigger(self) -> None:
        """Command one exposure, once the camera can take it. Raises DeviceError."""
        camera = self._camera
        with link_lost(self._name, self._errors, "software trigger"):
            if camera.CanWaitForFrameTriggerReady():
                camera.WaitForFrameTriggerReady(_TRIGGER_READY_MS, self._pylon.TimeoutHandling_ThrowException)
        self._nodes.execute("TriggerSoftware")

    def receive(self, timeout_s: float) -> CameraFrame | None:
        """Return the next frame, None if there is none within ``timeout_s`` of wall time. Raises DeviceError."""
        with link_lost(self._name, self._errors):
            result = self._camera.RetrieveResult(round(1e3 * timeout_s), self._pylon.TimeoutHandling_Return)
            if not result or not result.IsValid():
                if self._camera.IsCameraDeviceRemoved():
                    raise LinkLost(self._name, "has been removed")
                return None
            try:
                image = self._image(result) if result.GrabSucceeded() else None
                ticks = result.TimeStamp  # 0 of the emulated camera
                return CameraFrame(image, result.BlockID, ticks * self._tick_s if ticks else math.nan)
            finally:
                result.Release()

    def _image(self, result: Any) -> np.ndarray:
        raw = np.asarray(result.Array)
        check_size(self._name, (raw.shape[1], raw.shape[0]), self._size)
        return to_8_bits(raw, self._bits)

    def set_exposure(self, exposure_s: float) -> None:
        """Set the exposure time. Raises DeviceError."""
        self._nodes.set_exposure(exposure_s)

    def close(self) -> None:
        """Stop and release the camera. Idempotent, never raises."""
        camera, self._camera = self._camera, None
        if camera is not None:
            with contextlib.suppress(*self._errors):
                camera.StopGrabbing()
                camera.Close()


def found_pylon() -> list[CameraInfo]:
    """Return the cameras that pylon finds. Raises DeviceError without pypylon."""
    pylon, genicam = _library("cameras")
    try:
        devices = pylon.TlFactory.GetInstance().EnumerateDevices()
    except genicam.GenericException as cause:
        raise DeviceError("cameras", f"pylon: {reason(cause)}") from cause
    return [
        CameraInfo(
            device.GetSerialNumber(),
            device.GetVendorName(),
            device.GetModelName(),
            device.GetSerialNumber(),
            device.GetIpAddress() if device.IsIpAddressAvailable() else "",
            device.GetTLType() if device.IsTLTypeAvailable() else "",
            "pylon",
        )
        for device in devices
    ]


def _library(name: str) -> tuple[Any, Any]:
    """Return pylon and its GenApi; DeviceError of ``name`` if it is not installed."""
    try:
        return vendor_module("pypylon.pylon"), vendor_module("pypylon.genicam")
    except ImportError as cause:
        raise DeviceError(name, f"interface pylon needs the package pypylon: {cause}") from cause


def _names(device: Any) -> set[str]:
    """Return what identifies a device."""
    names = {device.GetSerialNumber(), device.GetFullName()}
    if device.IsUserDefinedNameAvailable():
        names.add(device.GetUserDefinedName())
    if device.IsIpAddressAvailable():
        names.add(device.GetIpAddress())
    return names - {""}


def _available(genicam: Any, nodes: Any, feature: str) -> Any:
    """Return the node of ``feature``, None without an available one."""
    node = nodes.GetNode(feature)
    return node if node is not None and genicam.IsAvailable(node) else None
