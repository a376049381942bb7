"""Emulated GigE Vision camera: libaravis' fake camera with images of our own."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import re
import socket
import struct
import threading
import time
from collections.abc import Callable
from tempfile import NamedTemporaryFile
from typing import Final

import numpy as np

from hil.config.camera_identity import CameraIdentity
from hil.config.rig import Vmu
from hil.config.tables.cameras import CameraHabits
from hil.core.clock import WallClock
from hil.drivers.cameras.base import EXPOSURE_STARTS, centred
from hil.drivers.cameras.libaravis import FILL, Aravis, aravis
from hil.drivers.vmu import NAME
from hil.errors import DeviceError, LinkLost
from hil.parts.emulation.fault_injection import Faults

OBLIGING: Final = CameraHabits()
_POLL_WALL_S: Final = 0.05
_TRIGGER_HZ: Final = 500.0  # at which the fake camera looks for a software trigger
_SENSOR_WIDTH, _SENSOR_HEIGHT = 0x11C, 0x118  # registers of the fake camera
_PORT: Final = 3956
_SIOCSIFADDR: Final = 0x8916  # linux/sockios.h


class CameraEmulator:
    """A GigE Vision camera at ``address``, on port 3956, which GigE Vision prescribes.

    image_at: returns the image, (height, width), uint8, of an exposure at a bench time, s. sensor: (width, height) of
    the sensor, px. exposure_s: exposure time of the images of ``image_at``; None: they are those of any exposure time.
    habits: of its make.
    """

    def __init__(
        self,
        name: str,
        address: str,
        clock: WallClock,
        image_at: Callable[[float], np.ndarray],
        sensor: tuple[int, int] = (2048, 2048),
        exposure_s: float | None = None,
        habits: CameraHabits = OBLIGING,
    ) -> None:
        self.faults = Faults(name, ("camera",))
        self._name = name
        self._address = address
        self._clock = clock
        self._image_at = image_at
        self._sensor = sensor
        self._exposure_s = exposure_s
        self._habits = habits
        self._camera: int | None = None
        self._fill = FILL(self._fill_buffer)
        self._last: np.ndarray | None = None
        self._serial = name.replace(".", "-").upper()

    def identity(self, size: tuple[int, int]) -> CameraIdentity:
        """Return what it reports of itself to a driver that sets images of ``size`` (width, height), px."""
        offset = centred(self._sensor, size)
        return CameraIdentity(serial=self._serial, sensor_px=self._sensor, offset_px=offset, binning=(1, 1))

    def start(self) -> dict[str, str]:
        """Open the camera's port; return ``{name: address}``. Raises LinkLost, DeviceError without libaravis."""
        self._library = aravis(self._name)
        add_loopback_address(self._name, self._address)
        check_port(self._name, self._address)
        with NamedTemporaryFile(suffix=".xml") as file:
            file.write(_description(self._library, self._habits))
            file.flush()
            names = [text.encode() for text in (self._address, self._serial, file.name)]
            self._camera = self._library.gv_fake_camera_new_full(*names)
        if not self._library.gv_fake_camera_is_running(self._camera):
            raise LinkLost(self._name, f"{self._address}: no address of a network interface of this host")
        fake = self._library.gv_fake_camera_get_fake_camera(self._camera)
        for register, pixels in zip((_SENSOR_WIDTH, _SENSOR_HEIGHT), self._sensor, strict=True):
            self._library.fake_camera_write_register(fake, register, pixels)
        self._library.fake_camera_set_trigger_frequency(fake, _TRIGGER_HZ)
        self._library.fake_camera_set_fill_pattern(fake, self._fill, None)
        return {self._name: self._address}

    def run(self, stop: threading.Event) -> None:
        """Pass on the fault of lost packets until ``stop`` is set; the library's thread serves the camera."""
        lost = 0.0
        while not stop.wait(_POLL_WALL_S):
            loss = 1.0 if self.faults.value("link_down") is not None else self.faults.value("drop") or 0.0
            if loss != lost:
                lost = loss
                assert self._camera is not None
                self._library.set_number(self._camera, "gvsp-lost-ratio", lost)

    def close(self) -> None:
        """Close the camera. Idempotent."""
        if self._camera is not None:
            self._library.unref(self._camera)
            self._camera = None

    def _fill_buffer(self, buffer: int, data: int, exposure_us: int, gain: int, pixel_format: int) -> None:
        """Fill a buffer with the image of its time; called in the library's thread."""
        library = self._library
        address = library.buffer_get_data(buffer, None)
        width, height = library.buffer_get_image_width(buffer), library.buffer_get_image_height(buffer)
        age_s = (time.time_ns() - library.buffer_get_timestamp(buffer)) * 1e-9
        image = self._image(self._clock.now_s() - age_s * self._clock.speed)
        if self._exposure_s is not None:
            brighter = image * (1e-6 * exposure_us / self._exposure_s)
            image = np.minimum(np.rint(brighter), 255.0).astype(np.uint8)
        pixel_bytes = pixel_format >> 19 & 0x1F  # bits 16 to 23: bits per pixel
        pixels = np.zeros((height, width), f"<u{pixel_bytes}")
        rows, columns = min(height, image.shape[0]), min(width, image.shape[1])
        pixels[:rows, :columns] = image[:rows, :columns]
        if pixel_bytes == 2:
            pixels <<= 8
        ctypes.memmove(address, pixels.ctypes.data, pixels.nbytes)
        if not self._habits.stamps:
            library.buffer_set_timestamp(buffer, 0)
        if (delay_s := self.faults.value("delay")) is not None:
            time.sleep(self._clock.wall_s(delay_s))

    def _image(self, exposed_s: float) -> np.ndarray:
        if self.faults.value("freeze") is None or self._last is None:
            self._last = self._image_at(exposed_s)
        return np.zeros_like(self._last) if self.faults.value("dark") is not None else self._last


def _description(library: Aravis, habits: CameraHabits) -> bytes:
    """Return the description, XML of GenApi, of the library's fake camera with ``habits``."""
    length, plain = ctypes.c_size_t(), library.fake_camera_new(b"PLAIN")
    address = library.fake_camera_get_genicam_xml(plain, ctypes.byref(length))
    text = ctypes.string_at(address, length.value).replace(b"FrameStart", habits.trigger_selector.encode())
    if habits.trigger_selector not in EXPOSURE_STARTS:
        text = text.replace(b'EnumEntry Name="AcquisitionStart"', b'EnumEntry Name="AcquisitionActive"')
    library.unref(plain)
    if habits.gain_unit is None:
        return text
    gain = re.search(rb'<Integer Name="GainRaw".*?</Integer>', text, re.DOTALL)
    assert gain is not None
    whole = gain[0].replace(b"Integer", b"Float").replace(b'"GainRaw"', b'"Gain"')
    floating = whole.replace(b"</Max>", b"</Max><Unit>%s</Unit>" % habits.gain_unit.encode())
    return text.replace(gain[0], floating).replace(b"<pFeature>GainRaw<", b"<pFeature>Gain<")


def check_port(name: str, address: str) -> None:
    """Raise LinkLost if the port of GigE Vision at ``address`` is in use: libaravis would share it."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((address, _PORT))
    except OSError as cause:
        raise LinkLost(name, f"{address} port {_PORT} (GigE Vision): {cause.strerror}") from cause


def add_loopback_address(name: str, address: str) -> None:
    """Add an address 127.x.y.z to the loopback interface, as an alias; other addresses are left alone.

    Raises LinkLost if that is not permitted.
    """
    octets = address.split(".")
    if octets[0] != "127" or address == "127.0.0.1":
        return
    label = f"lo:{'.'.join(octets[2:]).removeprefix('0.')}"[:15]
    request = struct.pack("16sHH4s8x", label.encode(), socket.AF_INET, 0, socket.inet_aton(address))
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            fcntl.ioctl(control, _SIOCSIFADDR, request)
    except OSError as cause:
        if cause.errno == errno.EEXIST:
            return
        text = f"{address} cannot be added to lo: {cause.strerror}; as root: ip addr add {address}/8 dev lo"
        raise LinkLost(name, text) from cause


ADDRESSES: Final = {"left": "127.0.0.2", "right": "127.0.0.3"}
"""Addresses of emulated cameras unless the rig file sets others."""


def emulated_camera(table: Vmu, clock: WallClock, image_at: Callable[[float], np.ndarray], side: str) -> CameraEmulator:
    """Return the camera ``side``, left or right, of ``table``; image_at: its image at a bench time, s."""
    if table.settings.interface != "genicam":
        raise DeviceError(NAME, f'cameras.interface = "{table.settings.interface}": only "genicam" can be emulated')
    address, habits = getattr(table.settings, side) or ADDRESSES[side], table.settings.emulated
    return CameraEmulator(f"{NAME}.{side}", address, clock, image_at, habits=habits)
