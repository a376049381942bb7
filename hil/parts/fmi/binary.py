"""Binary of an FMU for this computer: loaded, with the functions of FMI 2.0 and 3.0 behind one interface."""

from __future__ import annotations

import ctypes
import platform
import sys
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from hil.core.own_code import require_trust
from hil.core.surroundings import temporary_folder, temporary_folder_in
from hil.parts.fmi.archive import Archive, FmuError
from hil.parts.fmi.description import FmiVariable, ModelDescription, parse

LOG_BYTES: Final = 1024
OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
"""Status of a function; both versions have the same numbers up to FATAL."""
_STATUS: Final = ("ok", "warning", "discard", "error", "fatal", "pending")
_CO_SIMULATION: Final = 1  # fmi2Type
_SYSTEMS: Final = {"Linux": "linux", "Darwin": "darwin", "Windows": "win"}
_MACHINES: Final = {"AMD64": "x86_64", "arm64": "aarch64"}
_NEEDED: Final = {
    2: (
        "Instantiate",
        "SetupExperiment",
        "EnterInitializationMode",
        "ExitInitializationMode",
        "DoStep",
        "FreeInstance",
    ),
    3: ("InstantiateCoSimulation", "EnterInitializationMode", "ExitInitializationMode", "DoStep", "FreeInstance"),
}
_TYPES: Final[Mapping[str, Any]] = {
    "f8": ctypes.c_double,
    "f4": ctypes.c_float,
    "i1": ctypes.c_int8,
    "u1": ctypes.c_uint8,
    "i2": ctypes.c_int16,
    "u2": ctypes.c_uint16,
    "i4": ctypes.c_int32,
    "u4": ctypes.c_uint32,
    "i8": ctypes.c_int64,
    "u8": ctypes.c_uint64,
    "S": ctypes.c_char_p,
}
_POINTER = ctypes.c_void_p
_LOG_2: Final = ctypes.CFUNCTYPE(
    None, _POINTER, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p, _POINTER
)  # its last argument is the first of a variable number, a pointer if the message has %s for it
_LOG_3: Final = ctypes.CFUNCTYPE(None, _POINTER, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)


class _Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = (
        ("logger", _LOG_2),
        ("allocate", _POINTER),
        ("free", _POINTER),
        ("step_finished", _POINTER),
        ("environment", _POINTER),
    )


def platform_folders(version: int) -> tuple[str, ...]:
    """Return the names of folders in ``binaries`` that this computer can use."""
    system, machine = _SYSTEMS.get(platform.system(), ""), _MACHINES.get(platform.machine(), platform.machine())
    modern = f"{machine}-{'windows' if system == 'win' else system}"
    if version == 3:
        return (modern,)
    return (f"{system}{'64' if sys.maxsize > 2**32 else '32'}",) if machine in ("x86_64", "i686") else (modern,)


class Fmu:
    """The FMU at ``path``, unpacked, with its binary loaded. Raises FmuError.

    within: folder for the unpacked files, which go into a new folder inside it; None: the folder of temporary files.
    description: its model description. log: buffer of LOG_BYTES with the last message of the FMU, zero at its end.
    """

    def __init__(self, path: Path, within: Path | None = None) -> None:
        require_trust(str(path), FmuError)
        with Archive(path) as archive:
            self.description: ModelDescription = parse(archive.description())
            version = self.description.version
            binary = _binary_name(self.description, archive.names())
            unpacked = (
                temporary_folder("fmu", executable=True) if within is None else temporary_folder_in(within, "fmu")
            )
            self.folder = Path(unpacked.name)
            weakref.finalize(self, unpacked.cleanup)
            archive.unpack(self.folder)
        try:
            self._loaded = ctypes.CDLL(str(self.folder / binary))
        except (OSError, ValueError) as error:
            text = " ".join(str(error).split()).replace(f"{self.folder}/", "")
            raise FmuError(f"cannot be loaded: {text}") from error
        self._prefix = f"fmi{version}"
        if missing := [name for name in _NEEDED[version] if not hasattr(self._loaded, self._prefix + name)]:
            raise FmuError(f"{binary} has no function {self._prefix}{missing[0]}")
        self.log = ctypes.create_string_buffer(LOG_BYTES)
        self._free = self._function("FreeInstance", None, _POINTER)
        self._logger: Any = _LOG_2(self._on_log_2) if version == 2 else _LOG_3(self._on_log_3)

    def address(self, name: str) -> int:
        """Return the address of the function ``name``, without prefix. Raises FmuError."""
        function = getattr(self._loaded, self._prefix + name, None)
        if function is None:
            raise FmuError(f"has no function {self._prefix}{name}")
        return ctypes.cast(function, _POINTER).value or 0

    def instantiate(self, name: str) -> int:
        """Return the address of a new component. Raises FmuError."""
        self.log.value = b""
        described, resources = self.description, self.folder / "resources"
        if described.version == 2:
            libc = ctypes.CDLL(None)
            allocate, free = (ctypes.cast(f, _POINTER) for f in (libc.calloc, libc.free))
            self._callbacks = _Callbacks(self._logger, allocate, free, None, None)
            make = self._function(
                "Instantiate", _POINTER, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p, _POINTER,
                ctypes.c_int, ctypes.c_int,
            )  # fmt: skip
            component = make(
                name.encode(), _CO_SIMULATION, described.token.encode(), resources.as_uri().encode(),
                ctypes.byref(self._callbacks), 0, 0,
            )  # fmt: skip
        else:
            text, flag = ctypes.c_char_p, ctypes.c_bool
            make = self._function(
                "InstantiateCoSimulation", _POINTER, text, text, text, flag, flag, flag, flag, _POINTER,
                ctypes.c_size_t, _POINTER, _LOG_3, _POINTER,
            )  # fmt: skip
            component = make(
                name.encode(), described.token.encode(), f"{resources}/".encode(), False, False, False, False, None, 0,
                None, self._logger, None,
            )  # fmt: skip
        if not component:
            raise FmuError(f"cannot be instantiated{self._last_message()}")
        address: int = component
        return address

    def initialise(self, component: int) -> None:
        """Initialise ``component`` for a run from t = 0. Raises FmuError."""
        real, flag = ctypes.c_double, ctypes.c_int if self.description.version == 2 else ctypes.c_bool
        arguments = (flag, real, real, flag, real)
        if self.description.version == 2:
            self._call("SetupExperiment", component, arguments, 0, 0.0, 0.0, 0, 0.0)
            self._call("EnterInitializationMode", component)
        else:
            self._call("EnterInitializationMode", component, arguments, False, 0.0, 0.0, False, 0.0)
        self._call("ExitInitializationMode", component)

    def free(self, component: int) -> None:
        """Release ``component``."""
        self._free(component)

    def set_variable(self, component: int, name: str, value: Any) -> None:
        """Set one variable, of any type; ``value`` is in its unit. Raises FmuError."""
        variable = self.description.variables[name]
        if variable.size != 1:
            raise FmuError(f"{name}: is an array, its value cannot be set")
        self.set_values(component, variable.access, [variable], [value])

    def set_values(
        self, component: int, access: str, variables: Sequence[FmiVariable], values: Sequence[float | str]
    ) -> None:
        """Set ``variables``, all of one type, to their elements in ``values``. Raises FmuError."""
        code = variables[0].code
        try:
            given: list[Any] = [v.encode() if isinstance(v, str) else int(v) if code[0] in "iu" else v for v in values]
            if any(whole != v for whole, v in zip(given, values, strict=True) if code[0] in "iu"):
                raise ValueError
            block = (_TYPES[code] * len(given))(*given)
            if code[0] in "iu" and list(block) != given:  # the types of ctypes drop the higher bits
                raise OverflowError
        except (TypeError, ValueError, OverflowError) as error:
            raise FmuError(f"{variables[0].name}: {values[0]!r}, expected {variables[0].type}") from error
        references = (ctypes.c_uint32 * len(variables))(*(variable.reference for variable in variables))
        more = () if self.description.version == 2 else (ctypes.c_size_t(len(given)),)
        function = self._function(f"Set{access}", ctypes.c_int)
        status = function(_POINTER(component), references, ctypes.c_size_t(len(variables)), block, *more)
        self._check(f"Set{access}", status, f" for {variables[0].name}" + ("" if len(variables) == 1 else ", ..."))

    def _call(self, name: str, component: int, types: tuple[Any, ...] = (), *arguments: Any) -> None:
        self._check(name, self._function(name, ctypes.c_int, _POINTER, *types)(component, *arguments))

    def _check(self, name: str, status: int, what: str = "") -> None:
        if status not in (OK, WARNING):
            raise FmuError(f"{status_text(self._prefix + name, status)}{what}{self._last_message()}")

    def _last_message(self) -> str:
        text = self.log.value.decode("utf-8", "replace")
        return f": {text}" if text else ""

    def _function(self, name: str, returns: Any, *arguments: Any) -> Any:
        function = self._loaded[self._prefix + name]  # a new object: its types are this call's
        function.restype = returns
        if arguments:
            function.argtypes = arguments
        return function

    def _on_log_2(
        self, _env: Any, _name: bytes, status: int, _category: bytes, message: bytes | None, value: int | None
    ) -> None:
        if message and value and message.replace(b"%%", b"").partition(b"%")[2][:1] == b"s":
            message = message.replace(b"%s", ctypes.string_at(value), 1)
        self._on_log_3(_env, status, _category, message)

    def _on_log_3(self, _env: Any, status: int, _category: bytes, message: bytes | None) -> None:
        if status not in (OK, PENDING) and message:
            self.log.value = message[: LOG_BYTES - 1]


def status_text(function: str, status: int) -> str:
    """Return a message for a function that failed with ``status``."""
    return f"{function} returned {_STATUS[status] if 0 <= status < len(_STATUS) else status}"


def _binary_name(description: ModelDescription, names: list[str]) -> str:
    """Return the path of the binary for this computer inside the archive. Raises FmuError."""
    folders = platform_folders(description.version)
    for folder in folders:
        for ending in (".so", ".dylib", ".dll"):
            name = f"binaries/{folder}/{description.identifier}{ending}"
            if name in names:
                return name
    others = sorted({name.split("/")[1] for name in names if name.startswith("binaries/") and name.count("/") > 1})
    if others:
        raise FmuError(f"has binaries for {', '.join(others)} only: this computer needs {folders[0]}")
    if any(name.startswith("sources/") for name in names):
        raise FmuError(f"has sources and no binary: compile it for {folders[0]} with the tool that made it")
    raise FmuError(f"has no binary: this computer needs {folders[0]}")
