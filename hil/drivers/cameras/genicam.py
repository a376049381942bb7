"""GenICam cameras (GigE Vision and USB3 Vision) by libaravis."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from hil.config.camera_identity import CameraIdentity, identity_by
from hil.config.tables.cameras import CameraSettings
from hil.drivers.cameras.base import (
    BITS,
    EXPOSURE_STARTS,
    SHUTTER,
    CameraFrame,
    CameraInfo,
    centred,
    check_gain_limits,
    check_gain_set,
    check_gain_unit,
    check_size,
    stamp_of,
    to_8_bits,
)
from hil.drivers.cameras.libaravis import AravisError, aravis
from hil.errors import DeviceError, LinkLost

_BUFFERS: Final = 8
_COMPLETE: Final = 0  # ArvBufferStatus
_CLEARED: Final = 1
_PACKET_TIMEOUT_US: Final = 5_000  # until a missing packet is requested again
_FRAME_RETENTION_US: Final = 40_000  # until a frame with missing packets is given up


class GenicamCamera:
    """A camera, set up and ready to start; see ``open_camera``."""

    def __init__(
        self, name: str, identifier: str, settings: CameraSettings, size: tuple[int, int], rate_hz: float
    ) -> None:
        self._name = name
        self._library = aravis(name)
        self._camera: int | None = None
        self._stream: int | None = None
        self._started = False
        self._bits = BITS[settings.pixel_format]
        self._size = size
        try:
            self._camera = self._do(f"no camera {identifier!r}", self._library.camera_new, identifier.encode())
            if self._camera is None:
                raise LinkLost(name, f"no camera {identifier!r}")
            self._set_up(settings, rate_hz)
        except BaseException:
            self.close()
            raise

    def _set_up(self, settings: CameraSettings, rate_hz: float) -> None:
        library, camera, (width, height) = self._library, self._camera, self._size
        device = library.camera_get_device(camera)
        for feature, value in settings.features.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            what = f"{feature} = {value}"
            self._do(what, library.device_set_features_from_string, device, f"{feature}={text}".encode())
        self._check_offered(
            "pixel format", settings.pixel_format, library.camera_dup_available_pixel_formats_as_strings
        )
        self._do("pixel format", library.camera_set_pixel_format_from_string, camera, settings.pixel_format.encode())
        sensor = (ctypes.c_int(), ctypes.c_int())
        self._do("sensor size", library.camera_get_sensor_size, camera, *map(ctypes.byref, sensor))
        if sensor[0].value < width or sensor[1].value < height:
            check_size(self._name, (sensor[0].value, sensor[1].value), self._size)
        corner = centred((sensor[0].value, sensor[1].value), self._size)
        self._do("region", library.camera_set_region, camera, *corner, width, height)
        region = tuple(ctypes.c_int() for _ in range(4))
        self._do("region", library.camera_get_region, camera, *map(ctypes.byref, region))
        check_size(self._name, (region[2].value, region[3].value), self._size)
        if settings.packet_bytes is not None and library.camera_is_gv_device(camera):
            self._do("packet size", library.camera_gv_set_packet_size, camera, settings.packet_bytes)
        if settings.exposure_s is not None:
            self.set_exposure(settings.exposure_s)
        if settings.gain_db is not None:
            self._set_gain(settings.gain_db)
        self._set_trigger(settings, rate_hz)
        self._stream = self._do("stream", library.camera_create_stream, camera, None, None)
        if self._stream is None:
            raise DeviceError(self._name, "has no stream")
        if library.camera_is_gv_device(camera):
            library.set_number(self._stream, "packet-timeout", _PACKET_TIMEOUT_US)
            library.set_number(self._stream, "frame-retention", _FRAME_RETENTION_US)
        payload = self._do("payload", library.camera_get_payload, camera)
        for _ in range(_BUFFERS):
            library.stream_push_buffer(self._stream, library.buffer_new_allocate(payload))

    def _set_trigger(self, settings: CameraSettings, rate_hz: float) -> None:
        library, camera = self._library, self._camera
        if settings.trigger == "none":
            self._do("trigger", library.camera_clear_triggers, camera)
            self._do("frame rate", library.camera_set_frame_rate, camera, rate_hz)
            return
        source = "Software" if settings.trigger == "software" else settings.trigger_source
        self._check_offered("trigger source", source, library.camera_dup_available_trigger_sources)
        self._do("trigger", library.camera_set_trigger, camera, source.encode())

        self._check_trigger_selector()

    def _check_trigger_selector(self) -> None:
        """Raise DeviceError if what libaravis has switched on is no trigger of an exposure."""
        library = self._library
        try:
            device = library.camera_get_device(self._camera)
            selector = (library.device_get_string_feature_value(device, b"TriggerSelector") or b"").decode()
        except AravisError:
            return  # the camera has one trigger
        if selector and selector not in EXPOSURE_STARTS:
            raise DeviceError(self._name, f"trigger selector {selector}: allowed {', '.join(EXPOSURE_STARTS)}")

    def _set_gain(self, gain_db: float) -> None:
        """Set the gain by a feature in dB, with the automatic one off, and read it back."""
        library, unit, feature = self._library, None, b""
        device = library.camera_get_device(self._camera)
        with contextlib.suppress(AravisError):  # cameras without an automatic gain
            library.device_set_features_from_string(device, b"GainAuto=Off")
        for name in (b"GainAbs", b"Gain"):
            node = library.device_get_feature(device, name)
            if node and library.is_a(node, library.gc_float_get_type()):
                feature, unit = name, (library.gc_float_get_unit(node) or b"").decode(errors="replace")
        check_gain_unit(self._name, gain_db, unit)
        low, high = ctypes.c_double(), ctypes.c_double()
        limits = ctypes.byref(low), ctypes.byref(high)
        self._do("gain", library.device_get_float_feature_bounds, device, feature, *limits)
        check_gain_limits(self._name, gain_db, (low.value, high.value))
        self._do("gain", library.device_set_float_feature_value, device, feature, gain_db)
        actual_db = self._do("gain", library.device_get_float_feature_value, device, feature)
        check_gain_set(self._name, gain_db, actual_db)

    def _check_offered(self, what: str, requested: str, offered: Callable[..., Any]) -> None:
        """Raise DeviceError if the camera does not have ``requested``; a camera that does not list them is tried."""
        count = ctypes.c_uint()
        try:
            values = offered(self._camera, ctypes.byref(count))
        except AravisError:
            return
        names = [values[k].decode() for k in range(count.value)]
        if requested not in names:
            raise DeviceError(self._name, f"{what} {requested!r}: the camera has {', '.join(names) or 'none'}")

    @property
    def shutter(self) -> str:
        device = self._library.camera_get_device(self._camera)
        try:
            mode: bytes | None = self._library.device_get_string_feature_value(device, SHUTTER.encode())
        except AravisError:
            return ""
        return (mode or b"").decode(errors="replace")

    @property
    def identity(self) -> CameraIdentity:
        library, device = self._library, self._library.camera_get_device(self._camera)

        def read(feature: str, kind: type) -> Any:
            get = {
                str: library.device_get_string_feature_value,
                int: library.device_get_integer_feature_value,
                bool: library.device_get_boolean_feature_value,
            }[kind]
            try:
                value = get(device, feature.encode())
            except AravisError:
                return None
            return (
                value.decode(errors="replace") if isinstance(value, bytes) else None if value is None else kind(value)
            )

        return identity_by(read)

    @property
    def packet_bytes(self) -> int:
        library = self._library
        if not library.camera_is_gv_device(self._camera):
            return 0
        return int(self._do("packet size", library.camera_gv_get_packet_size, self._camera))

    def start(self) -> None:
        """Start the acquisition. Raises DeviceError."""
        self._do("acquisition", self._library.camera_start_acquisition, self._camera)
        self._started = True

    def trigger(self) -> None:
        self._do("software trigger", self._library.camera_software_trigger, self._camera)

    def receive(self, timeout_s: float) -> CameraFrame | None:
        """Return the next frame, None if there is none within ``timeout_s`` of wall time."""
        library = self._library
        buffer = library.stream_timeout_pop_buffer(self._stream, round(1e6 * timeout_s))
        if not buffer:
            return None
        try:
            status = library.buffer_get_status(buffer)
            if status == _CLEARED:
                return None
            number, stamp_s = library.buffer_get_frame_id(buffer), 1e-9 * library.buffer_get_timestamp(buffer)
            image = self._image(buffer) if status == _COMPLETE else None
            return CameraFrame(image, number, stamp_of(stamp_s))
        finally:
            library.stream_push_buffer(self._stream, buffer)

    def set_exposure(self, exposure_s: float) -> None:
        """Set the exposure time. Raises DeviceError."""
        with contextlib.suppress(AravisError):  # cameras without an automatic exposure
            device = self._library.camera_get_device(self._camera)
            self._library.device_set_features_from_string(device, b"ExposureAuto=Off")
        self._do("exposure time", self._library.camera_set_exposure_time, self._camera, 1e6 * exposure_s)

    def _image(self, buffer: int) -> np.ndarray:
        library = self._library
        size = library.buffer_get_image_width(buffer), library.buffer_get_image_height(buffer)
        check_size(self._name, size, self._size)
        length = ctypes.c_size_t()
        address = library.buffer_get_data(buffer, ctypes.byref(length))
        pixel_bytes = 1 if self._bits == 8 else 2
        expected = self._size[0] * self._size[1] * pixel_bytes
        if length.value < expected:
            raise DeviceError(self._name, f"image of {length.value} bytes, expected {expected}")
        raw = np.frombuffer(ctypes.string_at(address, expected), f"<u{pixel_bytes}")
        return to_8_bits(raw.reshape(self._size[1], self._size[0]), self._bits)

    def close(self) -> None:
        if self._started:
            self._started = False
            with contextlib.suppress(AravisError):
                self._library.camera_stop_acquisition(self._camera)
        for thing in (self._stream, self._camera):
            if thing is not None:
                self._library.unref(thing)
        self._stream = self._camera = None

    def _do(self, what: str, function: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except AravisError as cause:
            raise LinkLost(self._name, f"{what}: {cause}") from cause


def found_cameras() -> list[CameraInfo]:
    """Return the GenICam cameras that answer. Raises DeviceError without libaravis."""
    library = aravis("cameras")
    library.update_device_list()

    def text(key: str, k: int) -> str:
        value: bytes | None = getattr(library, f"get_device_{key}")(k)
        return (value or b"").decode(errors="replace")

    return [
        CameraInfo(
            text("id", k),
            text("vendor", k),
            text("model", k),
            text("serial_nbr", k),
            text("address", k),
            text("protocol", k),
            "genicam",
        )
        for k in range(library.get_n_devices())
    ]
