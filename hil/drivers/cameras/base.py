"""Interface of a camera, and its frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np

from hil.config.camera_identity import CameraIdentity
from hil.config.tables.cameras import CameraInterface, CameraSettings, PixelFormat
from hil.errors import DeviceError

SHUTTER: Final = "SensorShutterMode"
SIDES: Final = ("left", "right")
BITS: Final[dict[PixelFormat, int]] = {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono16": 16}


class CameraInfo(NamedTuple):
    """A camera that was found. identifier: what ``open_camera`` accepts with ``interface``."""

    identifier: str
    vendor: str
    model: str
    serial: str
    address: str
    protocol: str
    interface: CameraInterface


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """An image as received. image: (height, width), uint8; None if parts of it are missing.

    number: the camera's frame number. stamp_s: its time stamp, by its own clock; nan without one. missing_packets:
    whether packets were lost.
    """

    image: np.ndarray | None
    number: int
    stamp_s: float = math.nan


EXPOSURE_STARTS: Final = ("FrameStart", "ExposureStart", "AcquisitionStart")
"""Triggers that start one exposure (SFNC), the preferred one first."""
_GAIN_TOLERANCE_DB: Final = 0.5


def stamp_of(stamp_s: float) -> float:
    """Return the time stamp of a frame; nan for 0, which a camera without a clock sends."""
    return stamp_s if stamp_s != 0.0 else math.nan


def check_gain_unit(name: str, requested_db: float, unit: str | None) -> None:
    """Raise DeviceError unless a camera's gain is in dB.

    unit: of the feature Gain, None if the camera has a whole number in units of its own alone.
    """
    if unit is None:
        raise DeviceError(
            name,
            f"gain_db = {requested_db:g}: the camera has GainRaw alone, in units of its own: enter "
            "features = { GainRaw = ... } by its manual",
        )
    if unit.strip().lower() != "db":
        raise DeviceError(
            name,
            f"gain_db = {requested_db:g}: the unit of its Gain is {unit.strip() or 'not declared'}: enter "
            "features = { Gain = ... } by its manual",
        )


def check_gain_limits(name: str, requested_db: float, limits: tuple[float, float]) -> None:
    """Raise DeviceError unless a gain is within the limits of the camera."""
    if not limits[0] <= requested_db <= limits[1]:
        raise DeviceError(name, f"gain_db = {requested_db:g}: allowed {limits[0]:g} to {limits[1]:g}")


def check_gain_set(name: str, requested_db: float, actual_db: float) -> None:
    """Raise DeviceError if a camera has another gain than requested."""
    if abs(actual_db - requested_db) > _GAIN_TOLERANCE_DB:
        raise DeviceError(name, f"gain_db = {requested_db:g}: the camera reports {actual_db:g}")


class Camera(Protocol):
    """A camera that is open and set up; not thread-safe except for ``trigger``."""

    @property
    def shutter(self) -> str:
        """The camera's ``SensorShutterMode`` (SFNC): Global, Rolling, GlobalReset; empty without one."""

    @property
    def identity(self) -> CameraIdentity:
        """The camera, and the part of its sensor that its images show."""

    @property
    def packet_bytes(self) -> int:
        """Size of its network packets with all headers, the MTU that the network needs; 0 without a network."""

    def start(self) -> None:
        """Start the acquisition."""

    def trigger(self) -> None:
        """Command one exposure. Raises DeviceError."""

    def receive(self, timeout_s: float) -> CameraFrame | None:
        """Return the next frame, None if there is none within ``timeout_s`` of wall time. Raises DeviceError."""

    def set_exposure(self, exposure_s: float) -> None:
        """Set the exposure time, wall time. Raises DeviceError."""

    def close(self) -> None:
        """Stop and release the camera. Idempotent, never raises."""


class CameraType(Protocol):
    """Driver of an interface: opens a camera as ``open_camera`` does."""

    def __call__(
        self, name: str, identifier: str, settings: CameraSettings, size: tuple[int, int], rate_hz: float
    ) -> Camera: ...


def to_8_bits(raw: np.ndarray, bits: int) -> np.ndarray:
    """Return grey levels of ``bits`` bits, uint16, as uint8, rounded; saturated pixels stay saturated."""
    if bits == 8:
        return raw
    half = 1 << (bits - 9)
    reduced: np.ndarray = np.minimum((raw.astype(np.uint32) + half) >> (bits - 8), 255).astype(np.uint8)
    return reduced


def centred(sensor: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    """Return the corner of the region (width, height) in the middle of a sensor, px."""
    return (sensor[0] - size[0]) // 2, (sensor[1] - size[1]) // 2


def check_size(name: str, actual: tuple[int, int], size: tuple[int, int]) -> None:
    """Raise DeviceError if a camera's images, (width, height), are of another size than the geometry's."""
    if actual != size:
        raise DeviceError(name, f"images of {actual[0]} x {actual[1]} px, the geometry has {size[0]} x {size[1]}")
