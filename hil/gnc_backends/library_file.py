"""External GNC in a shared library (``hil_gnc.h``): loading, protocol check, opening and closing of an instance."""

from __future__ import annotations

import ctypes
import hashlib
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np

from hil.core.gnc_records import PROTOCOL, REASON_BYTES
from hil.errors import BadInput

KEY: Final = "gnc.library"
_SYMBOLS: Final = ("hil_gnc_protocol", "hil_gnc_open", "hil_gnc_step", "hil_gnc_close")
_SUBNORMAL: Final = 1e-310


class Library:
    """The shared library at ``path``. source: who named it, for messages. Raises BadInput where it is none of ours.

    step_address: of ``hil_gnc_step``, for compiled code.
    """

    def __init__(self, path: str, source: str = "--set") -> None:
        self.path = Path(path).absolute()
        self.name = self.path.name
        self._shown = path
        self._source = source
        if not self.path.is_file():
            raise self._refusal(
                "no such file: give the path of a shared library (hil gnc header says what it must have)"
            )
        exact = _keeps_subnormals()
        try:
            self._loaded = ctypes.CDLL(str(self.path))
        except (OSError, ValueError) as error:
            raise self._refusal(f"cannot be loaded: {_reason(error, self.path)}") from error
        if exact and not _keeps_subnormals():
            raise self._refusal("makes this process round small numbers to zero: build it without -ffast-math")
        missing = [name for name in _SYMBOLS if not hasattr(self._loaded, name)]
        if missing:
            raise self._refusal(f"has no function {', '.join(missing)}: hil gnc header says what it must have")
        self._declare()
        spoken = self._loaded.hil_gnc_protocol()
        if spoken != PROTOCOL:
            raise self._refusal(f"speaks protocol {spoken}, this bench speaks {PROTOCOL}: build it with hil gnc header")

    def _declare(self) -> None:
        loaded = self._loaded
        loaded.hil_gnc_protocol.argtypes, loaded.hil_gnc_protocol.restype = (), ctypes.c_int
        loaded.hil_gnc_open.argtypes, loaded.hil_gnc_open.restype = (ctypes.c_void_p, ctypes.c_char_p), ctypes.c_void_p
        loaded.hil_gnc_close.argtypes, loaded.hil_gnc_close.restype = (ctypes.c_void_p,), None
        self.step_address: int = ctypes.cast(loaded.hil_gnc_step, ctypes.c_void_p).value or 0

    def open(self, setup: np.record) -> Instance:
        """Return a GNC that knows ``setup`` (GNC_SETUP). Raises BadInput with its reason where it refuses."""
        reason = ctypes.create_string_buffer(REASON_BYTES)
        pointer = self._loaded.hil_gnc_open(np.asarray(setup).ctypes.data, reason)
        if not pointer:
            said = reason.raw.split(b"\0")[0].decode("utf-8", "replace").strip()
            raise self._refusal(f"refuses the scenario: {said or 'without a reason'}")
        return Instance(self._loaded.hil_gnc_close, pointer)

    def _refusal(self, what: str) -> BadInput:
        return BadInput.single(self._source, KEY, f'"{self._shown}": {what}')


class Instance:
    """One GNC of a library; address: what ``hil_gnc_open`` gave, 0 once it is closed."""

    def __init__(self, close: Any, pointer: int) -> None:
        self._close = close
        self.address = pointer

    def close(self) -> None:
        """Let the library free it; may be called more than once."""
        pointer, self.address = self.address, 0
        if pointer:
            self._close(pointer)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()


def digest_of(path: str) -> str:
    """Return the SHA-256 of a library's file, "" where there is none."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return ""


def _keeps_subnormals() -> bool:
    """Return whether this thread computes with the smallest numbers, as every result here has been computed."""
    return float(np.float64(_SUBNORMAL) * np.float64(1.0)) != 0.0


def _reason(error: Exception, path: Path) -> str:
    return " ".join(str(error).split()).removeprefix(f"{path}: ")
