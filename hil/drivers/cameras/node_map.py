"""Set-up of a GenICam camera by the standard names of its features (SFNC), for libraries with a GenApi node map."""

from __future__ import annotations

import importlib
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from hil.config.camera_identity import CameraIdentity, identity_by
from hil.config.tables.cameras import CameraSettings
from hil.drivers.cameras.base import (
    EXPOSURE_STARTS,
    SHUTTER,
    centred,
    check_gain_limits,
    check_gain_set,
    check_gain_unit,
    check_size,
)
from hil.errors import DeviceError, LinkLost

_PACKET_SIZE: Final = "GevSCPSPacketSize"
_OFFSETS: Final = ("OffsetX", "OffsetY")
_SIZES: Final = ("Width", "Height")
_PLACE = re.compile(r"[\s:]*\w*Exception thrown.*", re.DOTALL)  # in the library's sources


class NodeMap:
    """Features of the camera ``name``, for errors. Each method raises DeviceError for a feature that it cannot set.

    find: returns the node of a feature, None if the camera does not have it. error: base of the library's exceptions.
    """

    def __init__(self, name: str, find: Callable[[str], Any], error: type[Exception]) -> None:
        self._name = name
        self._find = find
        self._error = error

    def set_up(self, settings: CameraSettings, size: tuple[int, int], rate_hz: float) -> None:
        """Set the camera up for images of ``size`` (width, height), px, at ``rate_hz`` without a trigger."""
        for feature, value in settings.features.items():
            self.set(feature, value)
        self._choose("pixel format", "PixelFormat", settings.pixel_format)
        self._set_region(size)
        if settings.packet_bytes is not None and self.has(_PACKET_SIZE):
            self.set(_PACKET_SIZE, settings.packet_bytes)
        if settings.exposure_s is not None:
            self.set_exposure(settings.exposure_s)
        if settings.gain_db is not None:
            self._set_gain(settings.gain_db)
        self._set_trigger(settings, rate_hz)

    def has(self, feature: str) -> bool:
        """Return whether the camera has ``feature``."""
        return self._find(feature) is not None

    def set(self, feature: str, value: float | str) -> None:
        """Set ``feature``."""
        text = str(value).lower() if isinstance(value, bool) else str(value)
        self._call(feature, f"{feature} = {value}", "from_string", text)

    def execute(self, feature: str) -> None:
        """Execute a command."""
        self._call(feature, feature, "execute")

    def whole(self, feature: str, limit: str = "value") -> int:
        """Return a whole number: the value of ``feature``, or its limit ``max`` or ``inc``."""
        return int(self._attribute(feature, limit))

    @property
    def shutter(self) -> str:
        """The camera's shutter, empty without one."""
        return str(self._attribute(SHUTTER, "value")) if self.has(SHUTTER) else ""

    @property
    def identity(self) -> CameraIdentity:
        """See ``Camera``."""
        return identity_by(lambda feature, kind: kind(self._attribute(feature, "value")) if self.has(feature) else None)

    @property
    def packet_bytes(self) -> int:
        """See ``Camera``."""
        return self.whole(_PACKET_SIZE) if self.has(_PACKET_SIZE) else 0

    def set_exposure(self, exposure_s: float) -> None:
        """Set the exposure time."""
        feature = "ExposureTime" if self.has("ExposureTime") else "ExposureTimeAbs"
        self._set_by_hand(feature, "ExposureAuto", 1e6 * exposure_s)

    def _set_gain(self, gain_db: float) -> None:
        """Set the gain by a feature in dB, with the automatic one off, and read it back."""
        feature = next((each for each in ("Gain", "GainAbs") if self.has(each)), "")
        unit = str(getattr(self._node(feature), "unit", "")) if feature else None
        check_gain_unit(self._name, gain_db, unit)
        limits = float(self._attribute(feature, "min")), float(self._attribute(feature, "max"))
        check_gain_limits(self._name, gain_db, limits)
        self._set_by_hand(feature, "GainAuto", gain_db)
        check_gain_set(self._name, gain_db, float(self._attribute(feature, "value")))

    def _set_by_hand(self, feature: str, automatic: str, value: float) -> None:
        if self.has(automatic):
            self.set(automatic, "Off")
        self.set(feature, value)

    def _set_region(self, size: tuple[int, int]) -> None:
        offsets = [feature for feature in _OFFSETS if self.has(feature)]
        for feature in offsets:
            self.set(feature, 0)
        sensor = self.whole("Width", "max"), self.whole("Height", "max")
        if sensor[0] < size[0] or sensor[1] < size[1]:
            check_size(self._name, sensor, size)
        for feature, pixels in zip(_SIZES, size, strict=True):
            self.set(feature, pixels)
        check_size(self._name, (self.whole("Width"), self.whole("Height")), size)
        for feature in offsets:
            axis = _OFFSETS.index(feature)
            step = self.whole(feature, "inc")
            self.set(feature, centred(sensor, size)[axis] // step * step)

    def _set_trigger(self, settings: CameraSettings, rate_hz: float) -> None:
        selectors = self._choices("TriggerSelector") if self.has("TriggerSelector") else ()
        for selector in selectors:
            self.set("TriggerSelector", selector)
            if self.has("TriggerMode"):
                self.set("TriggerMode", "Off")
        if settings.trigger == "none":
            if self.has("AcquisitionFrameRateEnable"):
                self.set("AcquisitionFrameRateEnable", True)
            rate = "AcquisitionFrameRate" if self.has("AcquisitionFrameRate") else "AcquisitionFrameRateAbs"
            self.set(rate, rate_hz)
            return
        if not self.has("TriggerSource"):
            raise DeviceError(self._name, f'trigger = "{settings.trigger}": the camera has no trigger')
        if selectors:
            start = next((each for each in EXPOSURE_STARTS if each in selectors), None)
            if start is None:
                allowed = ", ".join(EXPOSURE_STARTS)
                raise DeviceError(self._name, f"trigger selectors {', '.join(selectors)}: none of {allowed}")
            self.set("TriggerSelector", start)
        self.set("TriggerMode", "On")
        source = "Software" if settings.trigger == "software" else settings.trigger_source
        self._choose("trigger source", "TriggerSource", source)

    def _choose(self, what: str, feature: str, requested: str) -> None:
        """Set ``feature`` to one of its names."""
        names = self._choices(feature)
        if requested not in names:
            raise DeviceError(self._name, f"{what} {requested!r}: the camera has {', '.join(names) or 'none'}")
        self.set(feature, requested)

    def _choices(self, feature: str) -> Sequence[str]:
        return tuple(self._attribute(feature, "symbolics"))

    def _attribute(self, feature: str, name: str) -> Any:
        try:
            return getattr(self._node(feature), name)
        except self._error as cause:
            raise self._failure(feature, cause) from cause

    def _call(self, feature: str, what: str, method: str, *arguments: Any) -> None:
        try:
            getattr(self._node(feature), method)(*arguments)
        except self._error as cause:
            raise self._failure(what, cause) from cause

    def _node(self, feature: str) -> Any:
        node = self._find(feature)
        if node is None:
            raise DeviceError(self._name, f"has no feature {feature}")
        return node

    def _failure(self, what: str, cause: Exception) -> DeviceError:
        return DeviceError(self._name, f"{what}: {reason(cause)}")


def vendor_module(name: str) -> Any:
    """Return a module of a camera library. Raises ImportError.

    Their bindings by SWIG warn while they are initialised; as an exception this would end the process.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(name)


@contextmanager
def link_lost(name: str, errors: tuple[type[Exception], ...], what: str = "") -> Iterator[None]:
    """Raise LinkLost of the camera ``name`` in place of the library's ``errors``. what: start of its text."""
    try:
        yield
    except errors as cause:
        raise LinkLost(name, f"{what}: {reason(cause)}" if what else reason(cause)) from cause


def reason(cause: Exception) -> str:
    """Return the text of an exception of GenApi or GenTL without the place in its sources."""
    return " ".join(_PLACE.sub("", str(cause)).split()) or type(cause).__name__
