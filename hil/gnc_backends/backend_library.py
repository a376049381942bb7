"""Backends in shared libraries, with the functions and records of ``hil_backends.h``."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.core.backend_records import BACKEND_PROTOCOL, MAX_SETTINGS
from hil.core.gnc_records import REASON_BYTES
from hil.core.settings import Setting, checked_settings
from hil.errors import BadInput
from hil.gnc_backends.backend import BackendInstance
from hil.gnc_backends.external import printable
from hil.gnc_backends.shared_library import loaded_library

_FUNCTIONS: Final = ("open", "step", "close")


class _Declaration(ctypes.Structure):
    """hil_backend_setting."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("unit", ctypes.c_char_p),
        ("meaning", ctypes.c_char_p),
        ("value", ctypes.c_double),
        ("low", ctypes.c_double),
        ("high", ctypes.c_double),
    )


class LibraryBackend:
    """The shared library at ``path`` as a backend of ``part``: navigation or control. Raises BadInput."""

    def __init__(self, path: str, part: str, refuse: Callable[[str], BadInput]) -> None:
        self._path, self._part, self._refuse = Path(path).absolute(), part, refuse
        self.name = self._path.name
        names = ("hil_backends_protocol", *(f"hil_{part}_{name}" for name in _FUNCTIONS))
        version = "version {} of the records", BACKEND_PROTOCOL
        loaded = loaded_library(self._path, names, version, "hil gnc header --backends", refuse)
        self._open, step, self._close = (getattr(loaded, f"hil_{part}_{name}") for name in _FUNCTIONS)
        self._open.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
        self._open.restype = ctypes.c_void_p
        self._close.argtypes, self._close.restype = (ctypes.c_void_p,), None
        self._step_address = ctypes.cast(step, ctypes.c_void_p).value or 0
        self.settings = self._declared(loaded)

    def _declared(self, loaded: Any) -> tuple[Setting, ...]:
        """Return the settings of the table that the library may have."""
        symbol = f"hil_{self._part}_settings"
        if not hasattr(loaded, symbol):
            return ()
        table = (_Declaration * MAX_SETTINGS).in_dll(loaded, symbol)
        found = []
        try:
            for row in table:
                if row.name is None:
                    break
                name, unit, meaning = (printable(text or b"") for text in (row.name, row.unit, row.meaning))
                low, high = (row.low, row.high) if row.low < row.high else (-math.inf, math.inf)
                found.append(Setting(name, row.value, unit, low, high, meaning))
            return checked_settings(found)
        except ValueError as error:
            raise self._refuse(str(error)) from error

    def check(self, setup: np.record) -> None:
        """Open and close an instance. Raises BadInput with the reason if the library refuses the scenario."""
        self.open(setup, np.array([setting.default for setting in self.settings])).close()

    def open(self, setup: np.record, values: np.ndarray) -> BackendInstance:
        """Return an instance. Raises BadInput with the reason if the library refuses the scenario."""
        reason = ctypes.create_string_buffer(REASON_BYTES)
        block = np.array(values, float) if len(values) else np.zeros(1)
        pointer = self._open(np.asarray(setup).ctypes.data, block.ctypes.data, reason)
        if not pointer:
            raise self._refuse(f"refuses the scenario: {printable(reason.raw) or 'without a reason'}")
        return BackendInstance(self._step_address, pointer, block, self._close)
