"""Shared libraries: a whole GNC (``hil_gnc.h``), and backends of navigation and control (``hil_backends.h``)."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from hil.core.gnc_records import (
    BACKEND_PROTOCOL,
    MAX_SETTINGS,
    MEASURED_PROTOCOL,
    OLDEST_PROTOCOL,
    PROTOCOL,
    REASON_BYTES,
)
from hil.core.own_code import require_trust
from hil.core.settings import Setting, checked_settings
from hil.errors import BadInput
from hil.gnc_backends.backend import NO_SETTINGS, WHOLE, BackendInstance, address_of
from hil.gnc_backends.output_texts import printable

_FUNCTIONS: Final = ("open", "step", "close")
_SUBNORMAL: Final = 1e-310


class _Interface(NamedTuple):
    """Interface of a library. version: its function that returns one. shown: text of one with {}. header: prints it."""

    version: str
    shown: str
    oldest: int
    present: int
    header: str


_GNC: Final = _Interface("hil_gnc_protocol", "protocol {}", OLDEST_PROTOCOL, PROTOCOL, "hil gnc header")
_BACKENDS: Final = _Interface(
    "hil_backends_protocol",
    "version {} of the records",
    BACKEND_PROTOCOL,
    BACKEND_PROTOCOL,
    "hil gnc header --backends",
)


class LibraryBackend:
    """The shared library at ``path`` as a backend of ``part``: navigation, control or both. Raises BadInput."""

    def __init__(self, path: str, part: str, refuse: Callable[[str], BadInput]) -> None:
        self._path, self._part, self._refuse = Path(path).absolute(), part, refuse
        self.name = self._path.name
        names = [f"hil_{part}_{name}" for name in _FUNCTIONS]
        loaded = _loaded(self._path, names, _GNC if part == WHOLE else _BACKENDS, refuse)
        self._open, step, self._close = (getattr(loaded, name) for name in names)
        values = () if part == WHOLE else (ctypes.c_void_p,)
        self._open.argtypes, self._open.restype = (ctypes.c_void_p, *values, ctypes.c_char_p), ctypes.c_void_p
        self._close.argtypes, self._close.restype = (ctypes.c_void_p,), None
        self._step_address = address_of(step)
        self.settings = self._declared(loaded)
        self.receives_measurements: bool = part != WHOLE or loaded.hil_gnc_protocol() >= MEASURED_PROTOCOL

    def _declared(self, loaded: Any) -> tuple[Setting, ...]:
        """Return the settings of the table that the library may have."""
        symbol = f"hil_{self._part}_settings"
        if self._part == WHOLE or not hasattr(loaded, symbol):
            return ()
        table = (_Declaration * MAX_SETTINGS).in_dll(loaded, symbol)
        settings = []
        try:
            for row in table:
                if row.name is None:
                    break
                name, unit, meaning = (printable(text or b"") for text in (row.name, row.unit, row.meaning))
                low, high = (row.low, row.high) if row.low < row.high else (-math.inf, math.inf)
                settings.append(Setting(name, row.value, unit, low, high, meaning))
            return checked_settings(settings)
        except ValueError as error:
            raise self._refuse(str(error)) from error

    def check(self, setup: np.record) -> None:
        """Open and close an instance. Raises BadInput with the reason if the library refuses the scenario."""
        self.open(setup, np.array([setting.default for setting in self.settings])).close()

    def open(self, setup: np.record, values: np.ndarray = NO_SETTINGS) -> BackendInstance:
        """Return an instance. Raises BadInput with the reason if the library refuses the scenario."""
        reason = ctypes.create_string_buffer(REASON_BYTES)
        block = np.array(values, float) if len(values) else np.zeros(1)
        given = () if self._part == WHOLE else (block.ctypes.data,)
        pointer = self._open(np.asarray(setup).ctypes.data, *given, reason)
        if not pointer:
            raise self._refuse(f"refuses the scenario: {printable(reason.raw) or 'without a reason'}")
        return BackendInstance(self._step_address, pointer, block, self._close)


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


def _loaded(path: Path, names: list[str], interface: _Interface, refuse: Callable[[str], BadInput]) -> ctypes.CDLL:
    """Return the shared library at ``path`` with the functions ``names``. Raises BadInput, made by ``refuse``."""
    header = interface.header
    require_trust(str(path), refuse)
    if not path.is_file():
        raise refuse(f"no such file: give the path of a shared library ({header} prints its interface)")
    exact = _keeps_subnormals()
    try:
        loaded = ctypes.CDLL(str(path))
    except (OSError, ValueError) as error:
        raise refuse(f"cannot be loaded: {_reason(error, path)}") from error
    if exact and not _keeps_subnormals():
        raise refuse("makes this process round small numbers to zero: build it without -ffast-math")
    if missing := [name for name in (interface.version, *names) if not hasattr(loaded, name)]:
        raise refuse(f"has no function {', '.join(missing)}: {header} prints its interface")
    version = getattr(loaded, interface.version)
    version.argtypes, version.restype = (), ctypes.c_int
    if not interface.oldest <= (declared := version()) <= interface.present:
        text = f"has {interface.shown.format(declared)}, this bench has {interface.present}"
        raise refuse(f"{text}: build it with the header of {header}")
    return loaded


def _keeps_subnormals() -> bool:
    """Return whether this thread computes with subnormal numbers, as all results of this program do."""
    return float(np.float64(_SUBNORMAL) * np.float64(1.0)) != 0.0


def _reason(error: Exception, path: Path) -> str:
    return " ".join(str(error).split()).removeprefix(f"{path}: ")
