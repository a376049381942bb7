"""GenICam cameras by GenTL producers, the libraries of camera vendors, through harvesters."""

from __future__ import annotations

import contextlib
import logging
import math
import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.config.camera_identity import CameraIdentity
from hil.config.tables.cameras import CameraSettings
from hil.drivers.cameras.base import BITS, CameraFrame, CameraInfo, check_size, stamp_of, to_8_bits
from hil.drivers.cameras.node_map import NodeMap, link_lost, reason, vendor_module
from hil.errors import DeviceError, LinkLost

PATH: Final = "GENICAM_GENTL64_PATH"
"""Environment variable with the folders of the producers (``*.cti``), which GenTL prescribes."""
_BUFFERS: Final = 8
_NAMES: Final = ("id_", "serial_number", "user_defined_name")


class GentlCamera:
    """A camera, set up and ready to start; see ``open_camera``. identifier: its GenTL id, serial number or name.

    Images with missing packets are discarded by harvesters.
    """

    def __init__(
        self, name: str, identifier: str, settings: CameraSettings, size: tuple[int, int], rate_hz: float
    ) -> None:
        self._name = name
        library = _library(name)
        self._errors = library.errors
        self._bits = BITS[settings.pixel_format]
        self._size = size
        self._camera: Any = None
        self._producers = _producers(name, library)
        try:
            with link_lost(name, self._errors):
                devices = self._producers.device_info_list
                device = next(
                    (d for d in devices if identifier in [_text(d, key, self._errors) for key in _NAMES]), None
                )
                if device is None:
                    raise LinkLost(name, f"no camera {identifier!r}")
                self._camera = self._producers.create(device)
                self._camera.num_buffers = _BUFFERS
                self._nodes = _node_map(name, library, self._camera.remote_device.node_map)
                self._nodes.set_up(settings, size, rate_hz)
        except BaseException:
            self.close()
            raise

    @property
    def shutter(self) -> str:
        return self._nodes.shutter

    @property
    def identity(self) -> CameraIdentity:
        return self._nodes.identity

    @property
    def packet_bytes(self) -> int:
        return self._nodes.packet_bytes

    def start(self) -> None:
        """Start the acquisition. Raises DeviceError."""
        with link_lost(self._name, self._errors, "acquisition"):
            self._camera.start()

    def trigger(self) -> None:
        self._nodes.execute("TriggerSoftware")

    def receive(self, timeout_s: float) -> CameraFrame | None:
        camera = self._camera
        with link_lost(self._name, self._errors):
            camera.timeout_period_on_update_event_data_call = max(1, round(1e3 * timeout_s))
            buffer = camera.try_fetch(timeout=timeout_s, is_raw=True)
            if buffer is None:
                return None
            try:
                return CameraFrame(self._image(buffer), buffer.frame_id, stamp_of(_stamp_s(buffer, self._errors)))
            finally:
                buffer.parent.queue_buffer(buffer)

    def _image(self, buffer: Any) -> np.ndarray:
        size = int(buffer.width), int(buffer.height)
        check_size(self._name, size, self._size)
        pixel_bytes = 1 if self._bits == 8 else 2
        row = size[0] * pixel_bytes + _whole(buffer, "padding_x", self._errors)
        data = np.frombuffer(buffer.raw_buffer, np.uint8, offset=_whole(buffer, "image_offset", self._errors))
        if len(data) < row * size[1]:
            raise DeviceError(self._name, f"image of {len(data)} bytes, expected {row * size[1]}")
        rows = data[: row * size[1]].reshape(size[1], row)[:, : size[0] * pixel_bytes]
        return to_8_bits(rows.copy().view(f"<u{pixel_bytes}"), self._bits)  # the producer uses the buffer again

    def set_exposure(self, exposure_s: float) -> None:
        """Set the exposure time. Raises DeviceError."""
        self._nodes.set_exposure(exposure_s)

    def close(self) -> None:
        camera, self._camera = self._camera, None
        for end in (camera.destroy if camera is not None else None, self._producers.reset):
            if end is not None:
                with contextlib.suppress(*self._errors):
                    end()


def found_gentl() -> list[CameraInfo]:
    """Return the cameras of all producers; none without ``PATH``. Raises DeviceError without harvesters."""
    if not os.environ.get(PATH):
        return []
    library = _library("cameras")
    producers, errors = _producers("cameras", library), library.errors
    try:
        return [
            CameraInfo(
                device.id_,
                _text(device, "vendor", errors),
                _text(device, "model", errors),
                _text(device, "serial_number", errors),
                "",
                _text(device, "tl_type", errors),
                "gentl",
            )
            for device in producers.device_info_list
        ]
    finally:
        producers.reset()


class _Library:
    """Modules of harvesters and of its binding of the GenICam reference implementation."""

    def __init__(self) -> None:
        self.core = vendor_module("harvesters.core")
        self.genapi = vendor_module("genicam.genapi")
        self.gentl = vendor_module("genicam.gentl")
        self.errors = self.genapi.GenericException, self.gentl.GenericException
        logging.getLogger("harvesters").setLevel(logging.CRITICAL)  # what it logs also raises


def _library(name: str) -> _Library:
    try:
        return _Library()
    except ImportError as cause:
        raise DeviceError(name, f"interface gentl needs the packages harvesters and genicam: {cause}") from cause


def _producers(name: str, library: _Library) -> Any:
    """Return a Harvester with the producers of ``PATH`` and the cameras that they find. Raises DeviceError."""
    folders = [Path(folder) for folder in os.environ.get(PATH, "").split(os.pathsep) if folder]
    files = sorted(path for folder in folders for path in folder.glob("*.cti"))
    if not files:
        raise DeviceError(name, f"no GenTL producer (*.cti) in the folders of {PATH}")
    producers = library.core.Harvester()
    try:
        for path in files:
            producers.add_file(str(path))
        producers.update()
    except library.gentl.GenericException as cause:
        raise DeviceError(name, f"{', '.join(path.name for path in files)}: {reason(cause)}") from cause
    return producers


def _text(device: Any, key: str, error: tuple[type[Exception], ...]) -> str:
    """Return a text of a device, "" if its producer does not have it."""
    try:
        return getattr(device, key) or ""
    except error:
        return ""


def _node_map(name: str, library: _Library, nodes: Any) -> NodeMap:
    genapi = library.genapi

    def find(feature: str) -> Any:
        try:
            node = nodes.get_node(feature)
        except genapi.GenericException:
            return None
        return node if node is not None and genapi.is_available(node) else None

    return NodeMap(name, find, genapi.GenericException)


def _stamp_s(buffer: Any, error: tuple[type[Exception], ...]) -> float:
    """Return the time stamp, s, by the camera's clock; nan without one."""
    try:
        return 1e-9 * float(buffer.timestamp_ns)
    except error:
        pass
    try:
        return float(buffer.timestamp) / max(1.0, float(buffer.parent.parent.timestamp_frequency))
    except error:
        return math.nan


def _whole(buffer: Any, key: str, error: tuple[type[Exception], ...]) -> int:
    """Return a number of a buffer, 0 if its producer does not have it."""
    try:
        return int(getattr(buffer, key))
    except error:
        return 0
