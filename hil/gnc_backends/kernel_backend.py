"""Backends as kernels: plain functions that numba compiles to the C interface of a backend.

The machine code is kept in the cache of the bench's kernels, under the digest of the function, of all that it names and
of the layouts of the records: an edit of the law compiles it again, and nothing else.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numba import types
from numba.core.errors import NumbaError
from numba.np.numpy_support import carray

from hil.core.foreign_call import RAISED, own_kernel, raised_by
from hil.core.gnc_records import INPUTS, OUTPUTS
from hil.core.jit import c_function
from hil.core.own_code import compile_error
from hil.core.settings import Setting, checked_settings
from hil.errors import BadInput
from hil.gnc_backends.backend import NO_SETTINGS, BackendInstance

_ARGUMENTS: Final = ("settings", "inp", "out", "memory")


class KernelBackend:
    """A kernel that flies as navigation or control; made by the decorator ``hil.kernel_backend``."""

    def __init__(self, function: Callable[..., None], settings: tuple[Setting, ...], memory: np.dtype | None) -> None:
        self.function = function
        self.name = function.__name__
        self.settings = settings
        self.memory = memory

    def __call__(self, *arguments: Any) -> None:
        """Call the plain function, for tests of the law."""
        return self.function(*arguments)


def kernel_backend(
    settings: Sequence[Setting] = (), memory: Any = None
) -> Callable[[Callable[..., None]], KernelBackend]:
    """Return a decorator for a function that flies as a backend of navigation or of control.

    The function, ``law(settings, inp, out, memory)``, is compiled by numba. ``settings`` has the declared settings as
    attributes. ``inp`` and ``out`` are the records of ``hil_backends.h``; ``out`` is preset: no estimate, no demands.
    ``memory`` is a record of the dtype ``memory``, zeroed at the start of each run. What the function raises ends the
    run, as does an index outside an array or a value of another shape.

    Raises ValueError for a declaration that contradicts itself.
    """
    if callable(settings):
        raise BadInput.single("kernel_backend", "", "is a decorator with parentheses: @hil.kernel_backend()")
    checked = checked_settings(settings)
    layout = None if memory is None else np.dtype(memory, align=True)

    def decorate(function: Callable[..., None]) -> KernelBackend:
        return KernelBackend(function, checked, layout)

    return decorate


class CompiledKernel:
    """``backend`` compiled as a backend of ``part``. source, key, shown: name it in messages. Raises BadInput."""

    receives_measurements = True

    def __init__(self, backend: KernelBackend, part: str, refuse: Callable[[str], BadInput]) -> None:
        self.name, self.settings, self._function = backend.name, backend.settings, backend.function
        parameters = inspect.signature(backend.function).parameters
        if len(parameters) != len(_ARGUMENTS):
            text = f"{backend.name}({', '.join(parameters)}): a kernel takes ({', '.join(_ARGUMENTS)})"
            raise refuse(text)
        values = np.dtype([(setting.name, "f8") for setting in backend.settings] or [("none", "f8")], align=True)
        memory = np.dtype([("none", "f8")], align=True) if backend.memory is None else backend.memory
        self._instance = np.dtype([("settings", values), ("memory", memory)], align=True)
        try:
            self._step = _step_address(backend.function, part, self._instance)
        except (NumbaError, KeyError) as error:
            reason = compile_error(error, backend.function, values, memory, INPUTS[part], OUTPUTS[part])
            raise refuse(f"{backend.name} does not compile: {reason}") from error

    def check(self, setup: np.record) -> None:
        """Accept any setup: it is compiled."""

    def open(self, setup: np.record, values: np.ndarray = NO_SETTINGS) -> BackendInstance:
        """Return an instance with memory of its own."""
        block = np.zeros(1, self._instance)
        instance = KernelInstance(self._step, block.ctypes.data, block)
        instance.function, instance.records = self._function, block
        instance.set_settings(values)
        return instance


class KernelInstance(BackendInstance):
    """A kernel in flight. function: the plain one. records: (1,), its settings and its memory."""

    function: Callable[..., None]
    records: np.ndarray

    def error_of(self, given: np.void, output: np.void) -> BaseException:
        """Return what the kernel has raised."""
        own = self.records[0]
        return raised_by(self.function, own["settings"], given, output, own["memory"])


def _step_address(function: Callable[..., None], part: str, layout: np.dtype) -> int:
    """Return the address of ``function`` as the step of a backend of ``part``. layout: of an instance."""
    law, given_layout, output_layout = own_kernel(function), INPUTS[part], OUTPUTS[part]

    def step(given, output, instance):  # type: ignore[no-untyped-def]
        own, code = carray(instance, (1,), layout)[0], 0
        try:
            law(own.settings, carray(given, (1,), given_layout)[0], carray(output, (1,), output_layout)[0], own.memory)
        except Exception:
            code = RAISED
        return code

    return c_function(step, types.int32(types.voidptr, types.voidptr, types.voidptr))
