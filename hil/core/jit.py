"""Compilation of the kernels and their cache on disk.

A kernel is a function of numbers that numba compiles. Other kernels inline it; Python may call it too, and only then
is it compiled on its own. An entry is a kernel that other kernels call by its symbol: a change of it compiles it
alone, and entries compile side by side.

numba's own cache checks only the file of the function that is called; a change in a kernel that it calls from another
file goes unnoticed. Here each code has the digest of all that it was compiled from in its name
(``hil.core.kernel_digest``), and a file of its own, so that several processes may compile at once, and several versions
and checkouts share what is equal (``hil.core.kernel_folder``).
"""

from __future__ import annotations

import hashlib
import pickle
import platform
from collections.abc import Callable, Iterable
from functools import cache
from typing import IO, Any, TypeVar, cast

import llvmlite.binding
import numba
import numpy as np
from numba import njit
from numba.core.compiler import CompileResult
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.np import numpy_support

from hil.core.formulas import compile_formulas_by
from hil.core.kernel_digest import OF_IMAGES, NotDigestible, digest_of
from hil.core.kernel_folder import kernel_folder, lock_kernel_file, read_kernel_file, write_kernel_file
from hil.core.kernel_library import EntryCompiler, InlineCompiler, StaleCaller, WrappedCompiler

_numba_config: Any = numba.config
_NOT_INLINED = (
    *OF_IMAGES,
    "hil.parts.console.",
    "hil.gnc.estimation.joint_filter",
    "hil.gnc.estimation.pose_model",
    "hil.gnc.backend_step",
    "hil.maths.elementary",
)
_BASELINES = {"x86_64": ("x86-64-v3", ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"))}
"""Architecture -> name of its baseline and the features that this requires, in the names of LLVM."""

_Function = TypeVar("_Function", bound=Callable[..., Any])


class KernelCache:
    """Codes of one kernel on disk, one file for each signature, in the interface of numba's caches.

    kind: of the code: a kernel that Python calls has another one than the same kernel inside others. A process that
    finds no code of an entry, and another that compiles it, waits for that one.
    """

    def __init__(self, function: Callable[..., Any], kind: str) -> None:
        self._function, self._kind = function, kind
        self._held: dict[str, IO[bytes]] = {}
        self.cache_path = None

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return the code for ``signature``, None if there is none. Raises BadInput if others may have written it."""
        name = self._name(signature, target_context.codegen())
        if name is None:
            return None
        data = read_kernel_file(name)
        if data is None and self._kind == "entry":
            data = self._read_after_others(name)
        if data is None:
            return None
        rtsys.initialize(target_context)
        try:
            return CompileResult._rebuild(target_context, *pickle.loads(data))
        except (StaleCaller, ModuleNotFoundError):  # the latter: of a user's file that was edited or copied since
            return None

    def _read_after_others(self, name: str) -> bytes | None:
        """Return the code that another process is compiling; None if this process is to compile it."""
        held = lock_kernel_file(name)
        data = read_kernel_file(name)
        if held is not None and data is None:
            self._held[name] = held  # until it is saved, or this process ends
        elif held is not None:
            held.close()
        return data

    def save_overload(self, signature: Any, result: Any) -> None:
        """Write the code for ``signature``, if it can be used by other processes."""
        name = self._name(signature, result.codegen)
        if name is None or kernel_folder() is None or result.lifted or result.library.has_dynamic_globals:
            return
        write_kernel_file(name, dumps(result._reduce()))
        if (held := self._held.pop(name, None)) is not None:
            held.close()

    def _name(self, signature: Any, codegen: Any) -> str | None:
        """Return the name of the code for ``signature``; None if the kernel depends on what has no digest."""
        try:
            digest = digest_of(self._function)
        except NotDigestible:
            return None
        types = tuple(getattr(signature, "args", signature))
        key = hashlib.sha256(
            f"{types} {_fields(types)} {codegen.magic_tuple()} {_numba_config.USING_SVML} {self._kind}".encode()
        ).hexdigest()[:16]
        name = self._function.__qualname__.replace("<locals>", "")
        return f"{self._function.__module__}/{name}-{digest}-{key}.nbc"


def _fields(types: Iterable[Any]) -> list[Any]:
    """Return the names of the fields of all named tuples in ``types``, which the names of their types do not hold."""
    tuples: list[Any] = [each for each in types if isinstance(each, numba.types.BaseTuple)]
    return [(getattr(each, "fields", ()), _fields(each.types)) for each in tuples]


def kernel(function: _Function) -> _Function:
    """Compile ``function`` for the loop: no Python inside, no fast-math, cached on disk.

    Other kernels inline it, which makes the loop a third faster; those of the images are large, called once per image,
    and are called as functions inside the entry that holds them, as are those of the filters' covariance and of
    backends elsewhere. All but those of the images are compiled for each integer constant in a call, which makes the
    loop 8 % faster.

    Division by zero gives inf or nan as in numpy, so that a bad number is caught by the
    safety monitor's check for finite values and not by an exception in mid-cycle.
    """
    called = _compiled(function, "wrapped", WrappedCompiler)
    called.inside = cache(lambda: _inside(function))  # half of the kernels of a program are never compiled by it
    of_images = function.__module__.startswith(OF_IMAGES)
    called.get_call_template = lambda types, named: called.inside().get_call_template(
        [_any_integer(each) for each in types] if of_images else types, named
    )
    called.get_overload = lambda types: called.inside().get_overload(types)
    return cast(_Function, called)


def _inside(function: Callable[..., Any]) -> Any:
    """Return ``function`` compiled for other kernels."""
    inlined = not function.__module__.startswith(_NOT_INLINED)
    return _compiled(function, "inline", InlineCompiler, forceinline=inlined, no_cpython_wrapper=True)


def _compile_formula(function: Callable[..., Any]) -> None:
    """Let kernels call a formula by its compiled form."""
    compiled = cast(Any, kernel(function))
    cpu_target.typing_context.insert_global(function, numba.types.Dispatcher(compiled))
    cast(Any, function).compiled = compiled  # numba holds it weakly


def entry(function: _Function) -> _Function:
    """Compile ``function`` as a kernel that other kernels call by its symbol instead of inlining it."""
    compiled = _compiled(function, "entry", EntryCompiler)
    compiled.compiled_on_its_own = True
    return cast(_Function, compiled)


def c_function(function: Callable[..., Any], types: Any) -> int:
    """Return the address of ``function`` compiled as a C function of ``types``; it stays valid for this process."""
    compiled = _compiled(function, "c", WrappedCompiler, no_cfunc_wrapper=False, no_cpython_wrapper=True)
    compiled.compile(types)
    (result,) = compiled.overloads.values()
    _c_functions.append(result)
    address: int = result.library.get_pointer_to_function(result.fndesc.llvm_cfunc_wrapper_name)
    return address


_c_functions: list[Any] = []


def _compiled(function: Callable[..., Any], kind: str, compiler: Any, **options: Any) -> Any:
    decorate: Any = njit
    options = {"no_cfunc_wrapper": True} | options
    compiled = decorate(error_model="numpy", nogil=True, pipeline_class=compiler, **options)(function)
    compiled._cache = KernelCache(function, kind)
    return compiled


def _any_integer(argument: Any) -> Any:
    """Return the type of an argument without the value of an integer constant.

    With it numba compiles a kernel for each value in a call, and for the one that a variable has at first.
    """
    return argument.literal_type if isinstance(argument, numba.types.IntegerLiteral) else argument


def processor() -> str:
    """Return the name of the processor that kernels are compiled for."""
    return str(_numba_config.CPU_NAME or llvmlite.binding.get_host_cpu_name())


_records: dict[int, tuple[np.dtype, Any]] = {}


def _record_once(dtype: np.dtype, of: Callable[[np.dtype], Any] = numpy_support.from_struct_dtype) -> Any:
    """Return the type of a record, once: numba makes it for each array, and for each record inside one."""
    if id(dtype) not in _records:
        _records[id(dtype)] = (dtype, of(dtype))  # with the dtype: its id stays taken
    return _records[id(dtype)][1]


def _compile_for_baseline() -> None:
    """Let this process compile for the baseline of its architecture, if this computer has all features of that.

    Such kernels run on any computer with that baseline, so that a wheel can hold them. A loop that is compiled for one
    processor is hardly faster, and its results have the same bits. Components of a vector are computed together, which
    makes the loop 3 % faster.
    """
    config = _numba_config
    config.SLP_VECTORIZE = 1
    name, features = _BASELINES.get(platform.machine(), ("", ()))
    present = llvmlite.binding.get_host_cpu_features()
    if config.CPU_NAME is None and name and all(present.get(feature, False) for feature in features):
        config.CPU_NAME, config.CPU_FEATURES = name, ""


numpy_support.from_struct_dtype = _record_once
_compile_for_baseline()
compile_formulas_by(_compile_formula)
