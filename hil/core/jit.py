"""Compilation of the kernels and their cache on disk.

numba's own cache checks only the file of the function that is called; a change in a kernel that it calls from
another file goes unnoticed. A bench must never run yesterday's formula, so each entry carries a digest of every source
that its kernel is compiled from: its own file and all that this imports, directly or not. The folder of a set of
sources starts with the entries of earlier ones that are still valid, so that a change compiles only what depends on it.
The entries do not depend on where the package is installed: two checkouts of the same sources share them.

numba numbers the code of a kernel's signatures as it finds them, so that two processes that compile two signatures at
once can both write number 1, and leave an index that gives one the code of the other. Here every code has a name of its
own, and one process at a time adds to an index.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
import re
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite.binding
import numba
from numba import njit
from numba.core.caching import CacheImpl, FunctionCache, IndexDataCacheFile, _CacheLocator
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen

from hil.errors import BadInput

_numba_config: Any = numba.config
_PACKAGE = Path(__file__).parent.parent
_COMPILED = (b"\n@kernel", b"\n@intrinsic", b"\n@cuda.jit")
_IMPORT = re.compile(rb"^\s*from (hil[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
CYCLE, COMPILED_LOOP = "complete", "complete compiled loop"
"""Groups of kernels: of the cycle in Python, and the loop that is one kernel."""

_OF_IMAGES = ("hil.vmu.", "hil.monitor.")
_NOT_INLINED = (*_OF_IMAGES, "hil.console.", "hil.gnc.joint_filter", "hil.gnc.pose_model")
_KEPT_CACHES = 6
_BASELINES = {"x86_64": ("x86-64-v3", ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"))}
"""Architecture -> name of its baseline and the features that this requires, in the names of LLVM."""

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel_sources(package: Path = _PACKAGE) -> dict[str, bytes]:
    """Return the sources that kernels are compiled from, by their path inside ``package``.

    These are all files that define a kernel, wherever they are, and all modules of the package that those import:
    numba compiles the constants and record layouts of a module into the kernels that use them.
    """
    sources = _python_files(package)
    pending = [name for name, text in sources.items() if any(decorator in text for decorator in _COMPILED)]
    found: set[str] = set()
    while pending:
        name = pending.pop()
        if name not in found and name in sources:
            found.add(name)
            pending += _imports(sources[name])
    return {name: sources[name] for name in sorted(found)}


def _python_files(package: Path) -> dict[str, bytes]:
    """Return the contents of all modules of ``package``, by their path inside it."""
    found, start = {}, len(str(package)) + 1
    for folder, _, names in os.walk(package):
        for path in (f"{folder}{os.sep}{name}" for name in names if name.endswith(".py")):
            with open(path, "rb", buffering=0) as file:
                found[path[start:]] = file.read()
    return found


@cache
def _imports(text: bytes) -> list[str]:
    """Return the files that ``text`` may import: of ``from hil.a import b`` a.py, a/__init__.py and a/b.py."""
    files = []
    for module, names in _IMPORT.findall(text):
        place = "".join(f"{part}/" for part in module.decode().split(".")[1:])
        files += [f"{place[:-1]}.py", f"{place}__init__.py"] if place else []
        files += [f"{place}{name}.py" for name in re.findall(r"\w+", names.decode())]
    return files


def source_digest(sources: Mapping[str, bytes]) -> str:
    """Return a digest of ``sources``, contents by name, and of the compiler; the same in every process."""
    digest = hashlib.sha256(f"numba {numba.__version__}".encode())
    for name in sorted(sources):
        digest.update(f"{name} {len(sources[name])} ".encode())
        digest.update(sources[name])
    return digest.hexdigest()[:16]


def module_digests(sources: Mapping[str, bytes]) -> dict[str, str]:
    """Return ``source_digest`` of each of ``sources`` together with all that it imports, directly or not."""
    imported = {name: {file for file in _imports(text) if file in sources} for name, text in sources.items()}
    own = {name: hashlib.sha256(text).digest() for name, text in sources.items()}
    return {name: source_digest({file: own[file] for file in _reached(name, imported)}) for name in sources}


def _reached(name: str, imported: Mapping[str, set[str]]) -> set[str]:
    """Return ``name`` and the files that it imports, directly or not."""
    found: set[str] = set()
    pending = {name}
    while pending:
        found |= pending
        pending = set().union(*(imported[file] for file in pending)) - found
    return found


@cache
def _own_sources() -> dict[str, bytes]:
    return kernel_sources()


@cache
def kernels_digest() -> str:
    """Return the digest of the kernels that this process runs."""
    return source_digest(_own_sources())


@cache
def _own_module_digests() -> dict[str, str]:
    return module_digests(_own_sources())


def _cache_root() -> Path:
    given = os.environ.get("HIL_CACHE_DIR")
    if given:
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "hil"


def _cache_folder() -> Path:
    """Return the folder of these sources' kernels: that of the wheel, if it has one and no other is asked for."""
    shipped = _PACKAGE / "kernels" / kernels_digest()
    if "HIL_CACHE_DIR" not in os.environ and os.access(shipped, os.W_OK):
        return shipped
    return _cache_root() / "kernels" / kernels_digest()


def prepare_kernel_cache() -> None:
    """Create the folder of the compiled kernels and remove the oldest ones. Raises BadInput if it is not writable."""
    folder = _cache_folder()
    if folder.exists() and os.access(folder, os.W_OK):
        return
    _make_writable(folder)
    siblings = (entry for entry in folder.parent.iterdir() if entry.is_dir() and entry != folder)
    others = sorted(siblings, key=lambda entry: entry.stat().st_mtime)
    for other in reversed(others):  # the newest first: its index counts
        _reuse_entries(other, folder)
    for old in others[: 1 - _KEPT_CACHES]:
        shutil.rmtree(old, ignore_errors=True)


def _reuse_entries(old: Path, folder: Path) -> None:
    """Link the entries of ``old`` whose sources are those of today into ``folder``."""
    current = set(_own_module_digests().values())
    for path in old.rglob("*.nb[ic]"):
        if not current.isdisjoint(re.findall(r"-(\w{16})\.", path.name)):
            place = folder / path.relative_to(old)
            place.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError, FileNotFoundError):  # another process does the same, or removes ``old``
                os.link(path, place)


def _make_writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise BadInput.single(
            "kernel cache",
            str(_cache_root()),
            f"cannot be written ({error.strerror}); set HIL_CACHE_DIR to a folder that can",
        ) from error


def kernels_are_cached(group: str = CYCLE) -> bool:
    """Return whether an earlier start left the kernels of ``group``, compiled for these very sources and processor."""
    marker = _cache_folder() / group
    return marker.exists() and marker.read_text() == _processor()


def mark_kernels_cached(group: str = CYCLE) -> None:
    """Record that every kernel of ``group`` has been compiled once for these sources."""
    prepare_kernel_cache()
    (_cache_folder() / group).write_text(_processor())


@contextmanager
def only_one_process(group: str) -> Iterator[bool]:
    """Give whether this process is the only one that compiles ``group``, as long as this lasts."""
    prepare_kernel_cache()
    with (_cache_folder() / f"{group} lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True


class KernelCacheLocator(_CacheLocator):
    """Place of a kernel in the cache: by its path inside the package, created when the first one is written."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._py_file = py_file  # named in numba's warning about a function that cannot be cached
        self._line = py_func.__code__.co_firstlineno
        place = Path(py_file).relative_to(_PACKAGE)
        self._place = place.parent
        self._digest = _own_module_digests()[str(place)]

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> KernelCacheLocator | None:
        return cls(py_func, py_file) if py_file.startswith(f"{_PACKAGE}{os.sep}") else None

    def get_cache_path(self) -> str:
        return str(_cache_folder() / self._place)

    def ensure_cache_path(self) -> None:
        prepare_kernel_cache()
        _make_writable(_cache_folder() / self._place)

    def get_source_stamp(self) -> str:
        return self._digest

    def get_disambiguator(self) -> str:
        return f"{self._line}-{self._digest}"  # part of the names of the files, which ``_reuse_entries`` looks at


CacheImpl._locator_classes.insert(0, KernelCacheLocator)


class KernelCacheFile(IndexDataCacheFile):
    """Index and codes of one kernel on disk, which several processes may extend at once."""

    def save(self, key: Any, data: Any) -> None:
        """Write ``data`` of the signature ``key``, unless another process was first, under a name that no other has."""
        with Path(self._cache_path, "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            index = self._load_index()
            if key in index and Path(self._data_path(index[key])).exists():
                return
            name = f"{Path(self._index_name).stem}.{uuid.uuid4().hex}.nbc"
            self._save_data(name, data)
            self._save_index({**index, key: name})


class _KernelCache(FunctionCache):
    """Cache of one kernel, in a ``KernelCacheFile``."""

    def __init__(self, py_func: Callable[..., Any]) -> None:
        super().__init__(py_func)
        locator = self._impl.locator
        self._cache_file = KernelCacheFile(self._cache_path, self._impl.filename_base, locator.get_source_stamp())


class _KernelLibrary(JITCodeLibrary):
    """Code of one kernel; from the cache its bitcode is parsed only when another kernel is linked with it.

    That of the loop is 5 MB, and parsing it took a sixth of the start of a run, and 55 MB of memory.
    """

    _bitcode: bytes | None = None

    def serialize_using_object_code(self) -> tuple[Any, ...]:
        name, kind, data = super().serialize_using_object_code()
        module = self._get_module_for_linking()
        symbols = (*module.functions, *module.global_variables)
        return name, kind, (*data, [symbol.name for symbol in symbols if not symbol.is_declaration])

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[Any, ...]) -> Any:
        name, _, (code, bitcode, symbols) = state
        library = codegen.create_library(name)
        library.enable_object_caching()
        library._set_compiled_object(code)
        library._bitcode = bitcode
        library._finalize_final_module()
        codegen._engine._defined_symbols.update(symbols)
        return library

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None and self._bitcode is not None:
            self._shared_module = llvmlite.binding.parse_bitcode(self._bitcode)
        return super()._get_module_for_linking()


JITCPUCodegen._library_class = _KernelLibrary


def kernel(function: _Function) -> _Function:
    """Compile ``function`` for the loop: no Python inside, no fast-math, cached on disk.

    Those of the loop are inlined where they are called, which makes it a third faster; those of the images are
    large, called once per image, and would compile for minutes; so are those of the filters' covariance. All but
    those of the images are compiled for each integer constant in a call, which makes the loop 8 % faster.

    Division by zero gives inf or nan as in numpy, so that a bad number is caught by the
    safety monitor's check for finite values and not by an exception in mid-cycle.
    """
    inlined = not function.__module__.startswith(_NOT_INLINED)
    options: dict[str, Any] = {"forceinline": inlined, "no_cfunc_wrapper": True}
    compiled = njit(error_model="numpy", nogil=True, **options)(function)
    compiled._cache = _KernelCache(function)
    if function.__module__.startswith(_OF_IMAGES):
        call_template = compiled.get_call_template
        compiled.get_call_template = lambda types, named: call_template([_any_integer(a) for a in types], named)
    return cast(_Function, compiled)


def _any_integer(argument: Any) -> Any:
    """Return the type of an argument without the value of an integer constant.

    With it numba compiles a kernel for each value in a call, and for the one that a variable has at first.
    """
    return argument.literal_type if isinstance(argument, numba.types.IntegerLiteral) else argument


def _processor() -> str:
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
