"""Backends of navigation, of control, or of both: what each declares, and an open one behind its address.

Kinds: a kernel (``kernel_backend``), a Python class or object (``python_backend``), a shared library
(``shared_library``), an FMU (``fmu``). ``backend_registry`` finds the one that a scenario names.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple, Protocol, Self

import numpy as np

from hil.core.plug_ins import raised_text
from hil.core.settings import Setting
from hil.errors import DeviceError, PlugInError, ProtocolError
from hil.gnc import backend_outputs
from hil.gnc_backends.output_texts import fault_text, reported_fault, step_failed, whole_text

PARTS: Final = ("navigation", "control")
"""Parts of the GNC that a backend replaces, in the order of the rows of GNC_PARAMS.settings."""
WHOLE: Final = "gnc"
"""Part of a backend that replaces both by one call."""
ANY_PART: Final = (*PARTS, WHOLE)
"""All, in the order of their numbers in the records, from 1."""


NO_SETTINGS: Final = np.zeros(0)
C_STEP: Final = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
"""Type of a step in C, with which a Python function becomes one."""


def address_of(function: object) -> int:
    """Return the address of a C function of ctypes."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0  # type: ignore[arg-type]


class BackendInstance:
    """Base class of an open backend: in a campaign one per case.

    step_address: of ``int step(input, output, instance)``, of a whole GNC ``int step(instance, input, output)``.
    address: that argument of the step, 0 once it is closed.
    block: memory that begins with the values of the settings; None if they are elsewhere. free: ends ``address``.
    """

    error: BaseException | None = None
    """What a Python object has raised in its step."""

    def __init__(
        self,
        step_address: int,
        address: int,
        block: np.ndarray | None = None,
        free: Callable[[int], object] = lambda _: None,
    ) -> None:
        self.step_address, self.address = step_address, address
        self._block, self._free = block, free

    @property
    def message(self) -> bytes:
        """Whole text of a failed step, of which its output may have the beginning alone; b"" for none."""
        return b""

    def error_of(self, _given: np.void, _output: np.void) -> BaseException | None:
        """Return what its failed step has raised, by its records of input and output; None if it raised nothing."""
        return self.error

    def set_settings(self, values: np.ndarray) -> None:
        """Take over other values of the settings, (n,), between two cycles."""
        if self._block is not None:
            self._block.view(np.uint8)[: 8 * len(values)] = np.ascontiguousarray(values, float).view(np.uint8)

    def close(self) -> None:
        """End it; may be called more than once."""
        address, self.address = self.address, 0
        if address:
            self._free(address)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Backend(Protocol):
    """A backend as loaded, from which instances are opened."""

    name: str
    settings: tuple[Setting, ...]
    receives_measurements: bool
    """Whether it can receive measurements of further sensors."""

    def check(self, setup: np.record) -> None:
        """Raise BadInput if it cannot be flown with ``setup`` (GNC_SETUP)."""

    def open(self, setup: np.record, values: np.ndarray = NO_SETTINGS) -> BackendInstance:
        """Return a new instance. values: of the settings, (n,). Raises BadInput or DeviceError."""


class OwnBackends(NamedTuple):
    """Backends that the caller gives as Python objects: classes, instances or kernels; None for the scenario's.

    gnc: a whole GNC, an object.
    """

    navigation: object | None = None
    control: object | None = None
    gnc: object | None = None


Backends = Mapping[str, Backend]
"""Backends that are not built in, by their part."""


def failure_of(
    name: str, backends: np.record, n_thrusters: int, error: BaseException | None, message: bytes = b""
) -> DeviceError:
    """Return the error of the backend ``name`` that has failed.

    backends: BACKENDS. error: raised by its object. message: whole text of a failed step, b"" for that of the output.
    """
    if isinstance(error, ProtocolError):
        return error
    if error is not None:
        failed = PlugInError(name, raised_text("step", error))
        failed.__cause__ = error
        return failed
    part = ANY_PART[int(backends["failed"]) - 1]
    output, fault = backends[f"{part}_output"], int(backends["fault"])
    text = bytes(backends[part]["text"])
    if fault == backend_outputs.RETURNED:
        return step_failed(name, int(backends["code"]), whole_text(text, message))
    if fault == backend_outputs.REPORTED:
        return reported_fault(name, text)
    cycle = int(backends["gnc_input"]["cycle"])
    return ProtocolError(name, fault_text(output, fault, int(backends["place"]), n_thrusters, cycle))
