"""Backends as kernels: plain functions that numba compiles to the C interface of a backend.

The machine code is kept in the cache of the bench's kernels, under the digest of the function's file, of the bench's
kernels and of the version of the records: an edit of the file compiles it again, and nothing else.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import marshal
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numba import njit
from numba.core.errors import NumbaError

from hil.core.backend_records import BACKEND_PROTOCOL, INPUTS, OUTPUTS
from hil.core.jit import own_kernels_folder
from hil.errors import BadInput, one_line
from hil.gnc_backends.backend import BackendInstance, Setting, checked_settings

_ARGUMENTS: Final = ("settings", "inp", "out", "memory")
_STEP: Final = '''\
"""Step of a kernel as a C function, made by hil."""
from numba import carray, cfunc, types


@cfunc(types.int32(types.voidptr, types.voidptr, types.voidptr), cache=True)
def step(given, output, instance):
    own = carray(instance, (1,), INSTANCE)[0]
    KERNEL(own.settings, carray(given, (1,), INPUT)[0], carray(output, (1,), OUTPUT)[0], own.memory)
    return 0
'''


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
    ``memory`` is a record of the dtype ``memory``, zeroed at the start of each run.

    Raises ValueError for a declaration that contradicts itself.
    """
    checked = checked_settings(settings)
    layout = None if memory is None else np.dtype(memory, align=True)

    def decorate(function: Callable[..., None]) -> KernelBackend:
        return KernelBackend(function, checked, layout)

    return decorate


class CompiledKernel:
    """``kernel`` compiled as a backend of ``part``. source, key, shown: name it in messages. Raises BadInput."""

    def __init__(self, kernel: KernelBackend, part: str, refuse: Callable[[str], BadInput]) -> None:
        self.name, self.settings = kernel.name, kernel.settings
        parameters = inspect.signature(kernel.function).parameters
        if len(parameters) != len(_ARGUMENTS):
            text = f"{kernel.name}({', '.join(parameters)}): a kernel takes ({', '.join(_ARGUMENTS)})"
            raise refuse(text)
        values = np.dtype([(setting.name, "f8") for setting in kernel.settings] or [("none", "f8")], align=True)
        memory = np.dtype([("none", "f8")], align=True) if kernel.memory is None else kernel.memory
        self._instance = np.dtype([("settings", values), ("memory", memory)], align=True)
        try:
            self._step: Any = self._compiled(kernel, part)
        except NumbaError as error:
            raise refuse(f"{kernel.name} does not compile: {compile_error(error)}") from error
        except KeyError as error:  # numba's for a field that a record does not have
            place = _line_with(kernel.function, f".{error.args[0]}")
            raise refuse(f"{kernel.name} does not compile: a record has no field {error}{place}") from error

    def _compiled(self, kernel: KernelBackend, part: str) -> Any:
        """Return the step as a C function, from the cache if it is there."""
        digest = hashlib.sha256(
            f"{digest_of_kernel(kernel)} {part} {kernel.name} {self._instance}".encode()
        ).hexdigest()[:16]
        path = own_kernels_folder(digest) / "step.py"
        if not path.exists():
            path.write_text(_STEP)
        found = importlib.util.spec_from_file_location(f"hil_own_{digest}", path)
        assert found is not None
        assert found.loader is not None
        module: Any = importlib.util.module_from_spec(found)
        sys.modules[module.__name__] = module  # where numba looks for it when it takes the step from the cache
        module.INPUT, module.OUTPUT, module.INSTANCE = INPUTS[part], OUTPUTS[part], self._instance
        module.KERNEL = njit(error_model="numpy", nogil=True)(kernel.function)
        found.loader.exec_module(module)
        return module.step

    def check(self, setup: np.record) -> None:
        """Accept any setup: it is compiled."""

    def open(self, setup: np.record, values: np.ndarray) -> _KernelInstance:
        """Return an instance with memory of its own."""
        return _KernelInstance(self._step, self._instance, values)


class _KernelInstance(BackendInstance):
    def __init__(self, step: Any, layout: np.dtype, values: np.ndarray) -> None:
        self._block = np.zeros(1, layout)
        super().__init__(step.address, self._block.ctypes.data)
        self._n = len(values)
        self._step = step
        self.set_settings(values)

    def set_settings(self, values: np.ndarray) -> None:
        """Write the settings, which are the first numbers of the block."""
        self._block.view(np.uint8)[: 8 * self._n] = np.ascontiguousarray(values, float).view(np.uint8)


def digest_of_kernel(kernel: KernelBackend) -> str:
    """Return the digest of the file of a kernel, or of its code if it has none, and of the records."""
    path = Path(kernel.function.__code__.co_filename)
    text = path.read_bytes() if path.is_file() else marshal.dumps(kernel.function.__code__)
    return hashlib.sha256(f"records {BACKEND_PROTOCOL} ".encode() + text).hexdigest()[:16]


def compile_error(error: NumbaError) -> str:
    """Return the reason of a failed compilation as one line: numba's own has dozens."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    reasons = [
        line for line in lines if re.match(r"Unknown attribute|Invalid use|No implementation|Cannot|Use of", line)
    ]
    reason = re.sub(r"(of type )?Record\(.*", "of a record", (reasons or lines[-1:])[-1])
    places = re.findall(r'File "[^"]*", line (\d+)', str(error)) or re.findall(r"\((\d+)\)", str(error))
    return one_line(reason, 200) + (f" (line {places[-1]})" if places else "")


def _line_with(function: Callable[..., None], text: str) -> str:
    """Return the number of the first line of ``function`` with ``text`` as an addition to a message."""
    try:
        lines, first = inspect.getsourcelines(function)
    except (OSError, TypeError):
        return ""
    return next((f" (line {first + i})" for i, line in enumerate(lines) if text in line), "")
