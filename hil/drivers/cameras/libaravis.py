"""Binding of libaravis 0.8 by ctypes: the functions that cameras and emulated cameras use."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_uint32, c_uint64, c_void_p
from functools import cache
from typing import Any, Final

from hil.errors import DeviceError

LIBRARY: Final = "libaravis-0.8.so.0"
_GOBJECT: Final = "libgobject-2.0.so.0"


class GError(ctypes.Structure):
    """Error of a function of GLib."""

    _fields_ = (("domain", c_uint32), ("code", c_int), ("message", c_char_p))


FILL = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, c_uint32, c_uint32, c_uint32)
"""Callback that fills an image of an emulated camera: buffer, data, exposure time in us, gain, pixel format."""

_ERROR: Final = POINTER(POINTER(GError))
_INT_P: Final = POINTER(c_int)

# result and arguments; of functions with an error, "error" stands for the last argument
_FUNCTIONS: Final[dict[str, tuple[Any, list[Any]]]] = {
    "arv_update_device_list": (None, []),
    "arv_get_n_devices": (c_uint, []),
    "arv_get_device_id": (c_char_p, [c_uint]),
    "arv_get_device_vendor": (c_char_p, [c_uint]),
    "arv_get_device_model": (c_char_p, [c_uint]),
    "arv_get_device_serial_nbr": (c_char_p, [c_uint]),
    "arv_get_device_address": (c_char_p, [c_uint]),
    "arv_get_device_protocol": (c_char_p, [c_uint]),
    "arv_camera_new": (c_void_p, [c_char_p, "error"]),
    "arv_camera_is_gv_device": (c_int, [c_void_p]),
    "arv_camera_get_device": (c_void_p, [c_void_p]),
    "arv_device_set_features_from_string": (c_int, [c_void_p, c_char_p, "error"]),
    "arv_device_get_string_feature_value": (c_char_p, [c_void_p, c_char_p, "error"]),
    "arv_device_get_integer_feature_value": (c_int64, [c_void_p, c_char_p, "error"]),
    "arv_device_get_boolean_feature_value": (c_int, [c_void_p, c_char_p, "error"]),
    "arv_camera_get_sensor_size": (None, [c_void_p, _INT_P, _INT_P, "error"]),
    "arv_camera_set_region": (None, [c_void_p, c_int, c_int, c_int, c_int, "error"]),
    "arv_camera_get_region": (None, [c_void_p, _INT_P, _INT_P, _INT_P, _INT_P, "error"]),
    "arv_camera_set_pixel_format_from_string": (None, [c_void_p, c_char_p, "error"]),
    "arv_camera_dup_available_pixel_formats_as_strings": (POINTER(c_char_p), [c_void_p, POINTER(c_uint), "error"]),
    "arv_camera_dup_available_trigger_sources": (POINTER(c_char_p), [c_void_p, POINTER(c_uint), "error"]),
    "arv_camera_set_exposure_time": (None, [c_void_p, c_double, "error"]),
    "arv_camera_get_exposure_time": (c_double, [c_void_p, "error"]),
    "arv_device_set_float_feature_value": (None, [c_void_p, c_char_p, c_double, "error"]),
    "arv_device_get_float_feature_value": (c_double, [c_void_p, c_char_p, "error"]),
    "arv_device_get_float_feature_bounds": (None, [c_void_p, c_char_p, POINTER(c_double), POINTER(c_double), "error"]),
    "arv_device_get_feature": (c_void_p, [c_void_p, c_char_p]),
    "arv_gc_float_get_type": (c_size_t, []),
    "arv_gc_float_get_unit": (c_char_p, [c_void_p]),
    "arv_camera_set_frame_rate": (None, [c_void_p, c_double, "error"]),
    "arv_camera_set_trigger": (None, [c_void_p, c_char_p, "error"]),
    "arv_camera_clear_triggers": (None, [c_void_p, "error"]),
    "arv_camera_software_trigger": (None, [c_void_p, "error"]),
    "arv_camera_gv_set_packet_size": (None, [c_void_p, c_int, "error"]),
    "arv_camera_gv_get_packet_size": (c_uint, [c_void_p, "error"]),
    "arv_camera_get_payload": (c_uint, [c_void_p, "error"]),
    "arv_camera_create_stream": (c_void_p, [c_void_p, c_void_p, c_void_p, "error"]),
    "arv_camera_start_acquisition": (None, [c_void_p, "error"]),
    "arv_camera_stop_acquisition": (None, [c_void_p, "error"]),
    "arv_stream_push_buffer": (None, [c_void_p, c_void_p]),
    "arv_stream_timeout_pop_buffer": (c_void_p, [c_void_p, c_uint64]),
    "arv_buffer_new_allocate": (c_void_p, [c_size_t]),
    "arv_buffer_get_status": (c_int, [c_void_p]),
    "arv_buffer_get_data": (c_void_p, [c_void_p, POINTER(c_size_t)]),
    "arv_buffer_get_timestamp": (c_uint64, [c_void_p]),
    "arv_buffer_get_frame_id": (c_uint64, [c_void_p]),
    "arv_buffer_get_image_width": (c_int, [c_void_p]),
    "arv_buffer_get_image_height": (c_int, [c_void_p]),
    "arv_buffer_set_timestamp": (None, [c_void_p, c_uint64]),
    "arv_gv_fake_camera_new_full": (c_void_p, [c_char_p, c_char_p, c_char_p]),
    "arv_fake_camera_new": (c_void_p, [c_char_p]),
    "arv_fake_camera_get_genicam_xml": (c_void_p, [c_void_p, POINTER(c_size_t)]),
    "arv_gv_fake_camera_get_fake_camera": (c_void_p, [c_void_p]),
    "arv_gv_fake_camera_is_running": (c_int, [c_void_p]),
    "arv_fake_camera_set_fill_pattern": (None, [c_void_p, FILL, c_void_p]),
    "arv_fake_camera_set_trigger_frequency": (None, [c_void_p, c_double]),
    "arv_fake_camera_write_register": (c_int, [c_void_p, c_uint32, c_uint32]),
}


class AravisError(Exception):
    """Error that libaravis reports; the text is its message."""


class Aravis:
    """The library: ``aravis.camera_new(...)`` calls ``arv_camera_new``, and raises AravisError if that reports one."""

    def __init__(self) -> None:
        self._library = ctypes.CDLL(LIBRARY)
        self._gobject = ctypes.CDLL(_GOBJECT)
        self._gobject.g_object_unref.argtypes = [c_void_p]
        self._gobject.g_clear_error.argtypes = [_ERROR]

    def __getattr__(self, name: str) -> Callable[..., Any]:
        symbol = f"arv_{name}"
        result, arguments = _FUNCTIONS[symbol]
        function = getattr(self._library, symbol)
        function.restype = result
        reports = bool(arguments) and arguments[-1] == "error"
        function.argtypes = [*arguments[:-1], _ERROR] if reports else arguments
        call = self._reporting(function) if reports else function
        setattr(self, name, call)
        return call

    def _reporting(self, function: Any) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            error = POINTER(GError)()
            result = function(*arguments, byref(error))
            if error:
                text = error.contents.message.decode(errors="replace")
                self._gobject.g_clear_error(byref(error))
                raise AravisError(text)
            return result

        return call

    def set_number(self, thing: int, name: str, value: float | int) -> None:
        """Set the property ``name`` of an object: an int is an unsigned one, a float a double."""
        number = c_uint(value) if isinstance(value, int) else c_double(value)
        self._gobject.g_object_set(c_void_p(thing), name.encode(), number, c_void_p(None))

    def is_a(self, thing: int, kind: int) -> bool:
        """Return whether an object is of the type ``kind`` of GObject."""
        return bool(self._gobject.g_type_check_instance_is_a(c_void_p(thing), c_size_t(kind)))

    def unref(self, thing: int) -> None:
        """Release a reference to an object."""
        self._gobject.g_object_unref(thing)


@cache
def aravis(device: str) -> Aravis:
    """Return the library; DeviceError of ``device`` if it is not installed."""
    try:
        return Aravis()
    except OSError as cause:
        text = f"GenICam cameras need {LIBRARY}, Debian package libaravis-0.8-0: {cause}"
        raise DeviceError(device, text) from cause
