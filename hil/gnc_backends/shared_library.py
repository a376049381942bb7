"""Shared libraries: a whole GNC (``hil_gnc.h``) with its instance and backend, and backends (``hil_backends.h``)."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NoReturn, Protocol, Self

import numpy as np

from hil.core.backend_records import BACKEND_PROTOCOL, MAX_SETTINGS
from hil.core.files import sha256_of
from hil.core.gnc_records import PROTOCOL, REASON_BYTES, GncMode, GncState
from hil.core.kernel_record import kernel_record
from hil.core.messages import new
from hil.core.settings import Setting, checked_settings
from hil.errors import BadInput, DeviceError, ProtocolError
from hil.gnc.estimation.step_memory import new_memory
from hil.gnc_backends import external_records
from hil.gnc_backends.backend import BackendInstance
from hil.gnc_backends.base import Poses, Records
from hil.gnc_backends.external import BackendSetup, ExternalGnc, fault_text, hold_reason, printable, reported_fault
from hil.gnc_backends.library_kernel import LIBRARY, library_step, output_of

KEY: Final = "gnc.library"
_SYMBOLS: Final = ("hil_gnc_protocol", "hil_gnc_open", "hil_gnc_step", "hil_gnc_close")
_SUBNORMAL: Final = 1e-310


class Library:
    """The shared library at ``path``. Raises BadInput if it is not a GNC of this protocol.

    source: option or file that names it, for messages. step_address: of ``hil_gnc_step``, for compiled code.
    """

    def __init__(self, path: str, source: str = "--set") -> None:
        self.path = Path(path).absolute()
        self.name = self.path.name
        self._shown = path
        self._source = source
        version = "protocol {}", PROTOCOL
        loaded = self._loaded = loaded_library(self.path, _SYMBOLS, version, "hil gnc header", self._refusal)
        loaded.hil_gnc_open.argtypes, loaded.hil_gnc_open.restype = (ctypes.c_void_p, ctypes.c_char_p), ctypes.c_void_p
        loaded.hil_gnc_close.argtypes, loaded.hil_gnc_close.restype = (ctypes.c_void_p,), None
        self.step_address: int = ctypes.cast(loaded.hil_gnc_step, ctypes.c_void_p).value or 0

    def open(self, setup: np.record) -> Instance:
        """Return a GNC set up with ``setup`` (GNC_SETUP). Raises BadInput with the reason if the library refuses it."""
        reason = ctypes.create_string_buffer(REASON_BYTES)
        pointer = self._loaded.hil_gnc_open(np.asarray(setup).ctypes.data, reason)
        if not pointer:
            raise self._refusal(f"refuses the scenario: {printable(reason.raw) or 'without a reason'}")
        return Instance(self._loaded.hil_gnc_close, pointer)

    def _refusal(self, what: str) -> BadInput:
        return BadInput.single(self._source, KEY, f'"{self._shown}": {what}')


def loaded_library(
    path: Path, names: Sequence[str], version: tuple[str, int], header: str, refuse: Callable[[str], BadInput]
) -> ctypes.CDLL:
    """Return the shared library at ``path``. Raises BadInput, made by ``refuse``.

    names: of its functions; the first returns its version. version: text of one with {}, and that of this bench.
    header: command that prints its interface.
    """
    if not path.is_file():
        raise refuse(f"no such file: give the path of a shared library ({header} prints its interface)")
    exact = _keeps_subnormals()
    try:
        loaded = ctypes.CDLL(str(path))
    except (OSError, ValueError) as error:
        raise refuse(f"cannot be loaded: {_reason(error, path)}") from error
    if exact and not _keeps_subnormals():
        raise refuse("makes this process round small numbers to zero: build it without -ffast-math")
    if missing := [name for name in names if not hasattr(loaded, name)]:
        raise refuse(f"has no function {', '.join(missing)}: {header} prints its interface")
    versioned, (text, expected) = getattr(loaded, names[0]), version
    versioned.argtypes, versioned.restype = (), ctypes.c_int
    if (found := versioned()) != expected:
        raise refuse(f"has {text.format(found)}, this bench has {expected}: build it with the header of {header}")
    return loaded


class Instance:
    """One GNC of a library; address: as returned by ``hil_gnc_open``, 0 once it is closed."""

    def __init__(self, close: Any, pointer: int) -> None:
        self._close = close
        self.address = pointer

    def close(self) -> None:
        """Free it; may be called more than once."""
        pointer, self.address = self.address, 0
        if pointer:
            self._close(pointer)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def digest_of(path: str) -> str:
    """Return the SHA-256 of a library's file, "" if there is none."""
    try:
        return sha256_of(Path(path))
    except BadInput:
        return ""


def _keeps_subnormals() -> bool:
    """Return whether this thread computes with subnormal numbers, as all results of this program do."""
    return float(np.float64(_SUBNORMAL) * np.float64(1.0)) != 0.0


def _reason(error: Exception, path: Path) -> str:
    return " ".join(str(error).split()).removeprefix(f"{path}: ")


class GncLibrary(Protocol):
    """A binary with GNCs; ``step_address`` is that of a function with the signature of ``hil_gnc_step``."""

    path: Path
    name: str
    step_address: int

    def open(self, setup: np.record) -> Instance:
        """Return a GNC set up with ``setup`` (GNC_SETUP). Raises BadInput with the reason if it is refused."""


class SharedLibraryGnc(ExternalGnc):
    """Calls ``library`` in the loop's own thread, in the cycles of a run and of a hold; a session has one instance.

    approach: APPROACH_STATE, record: LIBRARY, those of the loop; None: of its own.
    """

    def __init__(
        self,
        library: GncLibrary,
        setup: BackendSetup,
        approach: np.record | None = None,
        record: np.record | None = None,
    ) -> None:
        super().__init__(gnc_name(library), setup, approach)
        self.library = library
        self._instance: Instance | None = None
        self._record = kernel_record(new(LIBRARY) if record is None else record)
        self.input, self.output = kernel_record(self._record.input), output_of(self._record)
        self.memory = new_memory(self.params.navigation.fusion)
        """Of the filters, which a library does not use."""
        external_records.compile_call(self.input, self.output)

    def open(self, bench_s: float) -> None:
        """Open an instance. Raises BadInput if the library refuses."""
        if self._instance is None:
            self._instance = self.library.open(self.setup)
            self._record.step_address, self._record.instance = self.library.step_address, self._instance.address

    def close(self) -> None:
        """Close the instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None
            self._record.step_address = 0

    def step(self, t_s: float, now: Records, inbox: Poses) -> None:
        """Run stages 4 to 7 of the cycle; log what has changed."""
        self.cycle += 1
        before = self._progress.tobytes()
        works = library_step(
            self.params, self._record, self.approach_state, now.record, inbox.poses, inbox.arrived, self.cycle, t_s
        )
        if not works:
            self.fail(t_s, before, now.supervision)
        self.log_step(t_s, before, now.supervision)
        if self._record["asks_for_hold"]:
            self.hold_as_asked()

    def add_innovations(self, cycle: int, nis_position: float, nis_attitude: float) -> None:
        """Do nothing: the filters of a library are not monitored."""

    def log_step(self, t_s: float, before: bytes, supervision: np.record) -> None:
        """Log the progress since ``before`` (bytes of APPROACH_PROGRESS) in guidance, the text, and what followed."""
        guided = self._record["guided"]
        self.log_progress(t_s, before, supervision, guided)
        self.log_text(t_s)
        self._record["last_text"] = self._record["output"]["text"]
        self.log_progress(t_s, guided.tobytes(), supervision)

    def hold_as_asked(self) -> None:
        """Request the hold for which the library has asked."""
        self.request_hold(hold_reason(self.name, self.output))

    def fail(self, t_s: float, before: bytes, supervision: np.record) -> NoReturn:
        """Log the step in which the library has failed; raise its failure."""
        record = self._record
        self.log_progress(t_s, before, supervision, record["guided"])
        if record["code"] == 0 and record["fault"] == external_records.FINE:
            self.log_text(t_s)
        raise library_failure(self.name, record, int(self.params.n_thrusters))

    def on_idle_cycle(self, mode: GncMode, bench_s: float) -> None:
        """Call the library in a cycle of a hold; its demands there have no effect."""
        if mode is not GncMode.HOLD or self._instance is None or self.cycle < 0:
            return
        self.input.mode, self.input.orders, self.input.n_poses = int(mode), 0, 0
        code = external_records.call_library(
            self.library.step_address, self._instance.address, self.input, self.output
        )  # fmt: skip
        if code != 0:
            raise step_failed(self.name, code, self.output)
        if self.output.state == GncState.FAULT:
            self.on_state(self.output)


def library_failure(name: str, record: np.record, n_thrusters: int) -> DeviceError:
    """Return the failure of the last step of the GNC ``name``. record: LIBRARY."""
    output = output_of(record)
    if record.code != 0:
        return step_failed(name, int(record.code), output)
    if record.fault != external_records.FINE:
        cycle = int(record.input.cycle)
        return ProtocolError(name, fault_text(output, int(record.fault), int(record.place), cycle, n_thrusters))
    return reported_fault(name, output)


def gnc_name(library: GncLibrary) -> str:
    """Return the name of the GNC of ``library`` in events and errors."""
    return f"gnc {library.name}"


def step_failed(name: str, code: int, output: np.record) -> DeviceError:
    """Return the error of a step that returned ``code``, not 0."""
    text = printable(output.text)
    return DeviceError(name, f"its step returned {code}" + (f": {text}" if text else ""))


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
