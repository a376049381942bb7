"""Compilation of the kernels and their cache on disk.

A kernel is a function of numbers that numba compiles. Other kernels inline it; Python may call it too, and only then
is it compiled on its own. An entry is a kernel that other kernels call by its symbol: a change of it compiles it
alone, and entries compile side by side.

numba's own cache checks only the file of the function that is called; a change in a kernel that it calls from another
file goes unnoticed. Here each code has the digest of all that it was compiled from in its name
(``hil.core.kernel_digest``), and a file of its own, so that several processes may compile at once, and several versions
and checkouts share what is equal. What was not used for months is removed.

The files are pickles, code that this process runs: a folder or a file that another user owns or may write is refused.
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib
import os
import pickle
import platform
import stat
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any, Final, TypeVar, cast

import llvmlite.binding
import numba
from numba import njit
from numba.core.compiler import CompileResult
from numba.core.registry import cpu_target
from numba.core.serialize import dumps

from hil.core.formulas import compile_formulas_by
from hil.core.kernel_digest import NotDigestible, digest_of
from hil.core.kernel_library import EntryCompiler, InlineCompiler, StaleCaller, WrappedCompiler
from hil.errors import BadInput

_numba_config: Any = numba.config
_PACKAGE = Path(__file__).parent.parent
_OF_IMAGES = ("hil.vmu.", "hil.monitor.")
_NOT_INLINED = (
    *_OF_IMAGES,
    "hil.console.",
    "hil.gnc.estimation.joint_filter",
    "hil.gnc.estimation.pose_model",
    "hil.gnc.backend_step",
    "hil.maths.elementary",
)
_UNUSED_MAX_S: Final = 60 * 86_400.0
_BASELINES = {"x86_64": ("x86-64-v3", ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"))}
"""Architecture -> name of its baseline and the features that this requires, in the names of LLVM."""

_Function = TypeVar("_Function", bound=Callable[..., Any])


def _cache_root() -> Path:
    given = os.environ.get("HIL_CACHE_DIR")
    if given:
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "hil"


def kernel_cache_folder() -> Path:
    """Return the folder of the kernels: that of the wheel, if it has one and no other is asked for."""
    shipped = _PACKAGE / "kernels"
    if "HIL_CACHE_DIR" not in os.environ and os.access(shipped, os.W_OK):
        return shipped
    return _cache_root() / "kernels"


def prepare_kernel_cache() -> None:
    """Create the folder of the compiled kernels. Raises BadInput if it is not writable, or if others may write it."""
    folder = kernel_cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o755)
        _check_owner(folder, os.stat(folder))
        if not os.access(folder, os.W_OK):
            raise PermissionError(None, "Permission denied")
    except OSError as error:
        raise _refusal(f"cannot be written ({error.strerror})") from error


def _check_owner(path: Path, found: os.stat_result) -> None:
    """Raise BadInput if another user than this one or root owns ``path``, or may write it."""
    if found.st_uid not in (os.geteuid(), 0):
        raise _refusal(f"{path.name} belongs to another user (uid {found.st_uid}), whose code it would run")
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        mode = stat.S_IMODE(found.st_mode)
        raise _refusal(f"{path.name} can be written by other users (mode {mode:o}), whose code it would run")


def _refusal(reason: str) -> BadInput:
    text = f"{reason}; set HIL_CACHE_DIR to a folder of your own"
    return BadInput.single("kernel cache", str(_cache_root()), text)


def remove_unused_kernels() -> None:
    """Remove the kernels that no process has loaded for months."""
    oldest_s = time.time() - _UNUSED_MAX_S
    for path in kernel_cache_folder().rglob("*-*.*"):
        with suppress(FileNotFoundError):
            if path.stat().st_mtime < oldest_s:
                path.unlink()


def mark_of(kernel: Any) -> Path:
    """Return the file that marks ``kernel``, and what is used with it, as compiled; its text is ``processor()``."""
    return kernel_cache_folder() / f"{kernel.py_func.__name__}-{digest_of(kernel)}"


class KernelCache:
    """Codes of one kernel on disk, one file for each signature, in the interface of numba's caches.

    kind: of the code: a kernel that Python calls has another one than the same kernel inside others. A process that
    finds no code of an entry, and another that compiles it, waits for that one.
    """

    def __init__(self, function: Callable[..., Any], kind: str) -> None:
        self._function, self._kind = function, kind
        self._compiling: dict[Path, IO[bytes]] = {}
        self.cache_path = None

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return the code for ``signature``, None if there is none. Raises BadInput if others may have written it."""
        path = self._path(signature, target_context.codegen())
        if path is None:
            return None
        data = self._read(path)
        if data is None and self._kind == "entry":
            data = self._read_after_others(path)
        if data is None:
            return None
        _prepare(target_context)
        try:
            return CompileResult._rebuild(target_context, *pickle.loads(data))
        except (StaleCaller, ModuleNotFoundError):  # the latter: of a user's file that was edited or copied since
            return None

    def _read(self, path: Path) -> bytes | None:
        try:
            with path.open("rb") as file:
                _check_owner(path, os.fstat(file.fileno()))
                with suppress(OSError):  # a file of root
                    os.utime(file.fileno())
                return file.read()
        except (FileNotFoundError, NotADirectoryError):
            return None

    def _read_after_others(self, path: Path) -> bytes | None:
        """Return the code that another process is compiling; None if this process is to compile it."""
        self._make_folder(path)
        lock = path.with_suffix(".lock").open("wb")
        fcntl.flock(lock, fcntl.LOCK_EX)
        data = self._read(path)
        if data is None:
            self._compiling[path] = lock  # until it is saved, or this process ends
        else:
            lock.close()
        return data

    def _make_folder(self, path: Path) -> None:
        prepare_kernel_cache()
        try:
            path.parent.mkdir(exist_ok=True, mode=0o755)
        except OSError as error:
            raise _refusal(f"cannot be written ({error.strerror})") from error

    def save_overload(self, signature: Any, result: Any) -> None:
        """Write the code for ``signature``, if it can be used by other processes."""
        path = self._path(signature, result.codegen)
        if path is None or result.lifted or result.library.has_dynamic_globals:
            return
        data = dumps(result._reduce())
        self._make_folder(path)
        written = path.with_suffix(f".{uuid.uuid4().hex}")
        try:
            written.write_bytes(data)
            written.chmod(0o644)
            written.replace(path)
        except OSError as error:
            written.unlink(missing_ok=True)
            raise _refusal(f"cannot be written ({error.strerror})") from error
        if (lock := self._compiling.pop(path, None)) is not None:
            lock.close()

    def _path(self, signature: Any, codegen: Any) -> Path | None:
        """Return the file of the code for ``signature``; None if the kernel depends on what has no digest."""
        try:
            digest = digest_of(self._function)
        except NotDigestible:
            return None
        types = tuple(getattr(signature, "args", signature))
        key = hashlib.sha256(
            f"{types} {codegen.magic_tuple()} {_numba_config.USING_SVML} {self._kind}".encode()
        ).hexdigest()[:16]
        name = self._function.__qualname__.replace("<locals>", "")
        return kernel_cache_folder() / self._function.__module__ / f"{name}-{digest}-{key}.nbc"


@cache
def _prepare(target_context: Any) -> None:
    """Let ``target_context`` load kernels, without scipy.linalg: numba imports it for BLAS, which no kernel here calls.

    A kernel of a user's that calls BLAS imports it when it is compiled.
    """
    linalg: Any = importlib.import_module("numba.np.linalg")
    ensure_blas, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = ensure_blas
    target_context.refresh()


def kernel(function: _Function) -> _Function:
    """Compile ``function`` for the loop: no Python inside, no fast-math, cached on disk.

    Other kernels inline it, which makes the loop a third faster; those of the images are large, called once per image,
    and are called as functions inside the entry that holds them, as are those of the filters' covariance and of
    backends elsewhere. All but those of the images are compiled for each integer constant in a call, which makes the
    loop 8 % faster.

    Division by zero gives inf or nan as in numpy, so that a bad number is caught by the
    safety monitor's check for finite values and not by an exception in mid-cycle.
    """
    inlined = not function.__module__.startswith(_NOT_INLINED)
    called = _compiled(function, "wrapped", WrappedCompiler)
    inside = _compiled(function, "inline", InlineCompiler, forceinline=inlined, no_cpython_wrapper=True)
    call_template = inside.get_call_template
    if function.__module__.startswith(_OF_IMAGES):
        called.get_call_template = lambda types, named: call_template([_any_integer(a) for a in types], named)
    else:
        called.get_call_template = call_template
    called.get_overload = inside.get_overload
    called.inside = inside
    return cast(_Function, called)


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


def _compile_for_baseline() -> None:
    """Let this process compile for the baseline of its architecture, if this computer has all features of that.

    Such kernels run on any computer with that baseline, so that a wheel can hold them. A loop that is compiled for one
    processor is not faster, and its results have the same bits.
    """
    config = _numba_config
    name, features = _BASELINES.get(platform.machine(), ("", ()))
    present = llvmlite.binding.get_host_cpu_features()
    if config.CPU_NAME is None and name and all(present.get(feature, False) for feature in features):
        config.CPU_NAME, config.CPU_FEATURES = name, ""


_compile_for_baseline()
compile_formulas_by(_compile_formula)
