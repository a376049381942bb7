"""Two kinds of compiled kernels: those that are only inlined, and entries.

numba optimises each function that it compiles, emits machine code and a wrapper for Python, and links its bitcode, to
be optimised again, into every caller. Of the kernels of a loop hardly any is called from Python. An ``InlineLibrary``
is therefore bitcode alone, optimised function by function: no machine code, no wrapper. An ``EntryLibrary`` is compiled
whole: the bitcode of the inlined kernels that it reaches is linked and optimised once. It calls other entries by their
symbols.

The classes override methods of numba's libraries and of its compiler; tests/unit/core/test_numba_hooks.py has a test
for each, which names the version of numba that it was written for.
"""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Callable
from typing import Any

import llvmlite.binding
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import Compiler
from numba.core.types import Record

from hil.core.kernel_digest import NotDigestible, allocates, digest_of

Origin = tuple[str, str, tuple[Any, ...]]
"""Module and qualified name of an entry, and the types of its arguments."""
Called = tuple[str, str, tuple[Any, ...], Any, str]
"""The same of an entry that is called, with the type that it returned and its symbol when its caller was compiled."""


class StaleCaller(Exception):
    """An entry no longer has the symbol, or returns the type, that its caller was compiled for."""


def compiled_entry(module: str, name: str, types: tuple[Any, ...]) -> Any:
    """Return the result of the compilation of an entry, compiled or from the cache."""
    dispatcher = getattr(importlib.import_module(module), name)
    dispatcher.compile(types)
    return dispatcher.overloads[types]


def check_entries(called: dict[str, Called]) -> None:
    """Load the entries that a cached kernel calls. Raises StaleCaller if one has another symbol or type than before."""
    for module, name, types, returned, symbol in called.values():
        result = compiled_entry(module, name, types)
        if (result.signature.return_type, result.fndesc.llvm_func_name) != (returned, symbol):
            raise StaleCaller(name)


class _NoEngine:
    """Stands in for the code generator where numba registers what is not executed by itself."""

    @staticmethod
    def set_env(_name: str, _environment: Any) -> None:
        """Do nothing: the environment belongs to the entry into which the kernel is inlined."""


class _KernelLibrary(JITCodeLibrary):
    """Compiled code of a kernel. entries: of other kernels that this code calls by their symbols."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.entries: dict[str, Called] = {}

    def add_linking_library(self, library: Any) -> None:
        if isinstance(library, EntryLibrary) and library.origin is not None:
            library._ensure_finalized()
            result = compiled_entry(*library.origin)
            called = (*library.origin, result.signature.return_type, result.fndesc.llvm_func_name)
            self.entries[f"{library.name} {library.origin[2]}"] = called
            return
        if isinstance(library, _KernelLibrary):
            library._ensure_finalized()
            self.entries.update(library.entries)
        super().add_linking_library(library)

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[Any, ...]) -> Any:
        name, kind, data = state
        if kind not in ("inline", "entry"):  # a function of numba's own
            return JITCodeLibrary._unserialize.__func__(JITCodeLibrary, codegen, state)  # type: ignore[attr-defined]
        library: InlineLibrary | EntryLibrary
        library = (InlineLibrary if kind == "inline" else EntryLibrary)(codegen, name)
        library.restore(*data)
        return library


class InlineLibrary(_KernelLibrary):
    """A kernel that exists only inside others: its bitcode with that of the kernels that it calls."""

    @property
    def codegen(self) -> Any:
        return _NoEngine

    def finalize(self) -> None:
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0

    def serialize_using_object_code(self) -> tuple[Any, ...]:
        return self.name, "inline", (self._get_module_for_linking().as_bitcode(), self.entries)

    def restore(self, bitcode: bytes, entries: dict[str, Called]) -> None:
        """Take over what was serialised. Raises StaleCaller."""
        check_entries(entries)
        self._final_module = self._shared_module = llvmlite.binding.parse_bitcode(bitcode)
        self.entries = entries
        self._finalized = True


class EntryLibrary(_KernelLibrary):
    """A kernel with machine code of its own; its bitcode is parsed only when another is linked with it.

    That of the loop is 5 MB, and parsing it took a sixth of the start of a run, and 55 MB of memory. origin: None for a
    kernel that is inlined where other kernels call it.
    """

    origin: Origin | None = None
    _bitcode: bytes | None = None

    def serialize_using_object_code(self) -> tuple[Any, ...]:
        name, _, data = super().serialize_using_object_code()
        module = self._get_module_for_linking()
        symbols = [s.name for s in (*module.functions, *module.global_variables) if not s.is_declaration]
        return name, "entry", (*data, symbols, self.entries, self.origin)

    def restore(
        self, code: bytes, bitcode: bytes, symbols: list[str], entries: dict[str, Called], origin: Origin | None
    ) -> None:
        """Take over what was serialised, after the entries that it calls. Raises StaleCaller."""
        check_entries(entries)
        self.entries, self.origin, self._bitcode = entries, origin, bitcode
        self.enable_object_caching()
        self._set_compiled_object(code)
        self._finalize_final_module()
        self._codegen._engine._defined_symbols.update(symbols)

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None and self._bitcode is not None:
            self._shared_module = llvmlite.binding.parse_bitcode(self._bitcode)
        return super()._get_module_for_linking()


def whole_module(library: Any) -> Any:
    """Return a module of LLVM with the code of ``library`` and of all entries that it reaches."""
    module, pending, linked = library._get_module_for_linking().clone(), dict(library.entries), set[str]()
    while pending:
        name, (place, function, types, *_) = pending.popitem()
        if name not in linked:
            linked.add(name)
            called = compiled_entry(place, function, types).library
            module.link_in(called._get_module_for_linking(), preserve=True)
            pending |= called.entries
    return module


class _Compiler(Compiler):
    """Compiles a kernel into a library of a given kind, under a name that only its digest determines.

    numba numbers the functions of a process, so that the names in the code of two processes differ. The name of an
    entry does not depend on what is in it: its callers are not compiled again when that changes.
    """

    library: type[_KernelLibrary]

    def _compile_bytecode(self) -> Any:
        identity = self.state.func_id
        if not allocates(identity.func):  # counting references was a tenth of a cycle
            self.state.flags.nrt = self.state.targetctx.enable_nrt = False
        try:
            identity.unique_id = self.number_of(identity.func)
        except NotDigestible:
            pass  # numba's own number, and no cache
        else:
            identity.unique_name = f"{identity.func_qualname}${identity.unique_id}"
        library = self.library(self.state.targetctx.codegen(), identity.func_qualname)
        library.enable_object_caching()
        self.set_origin(library, identity.func)
        self.state.library = library
        return super()._compile_bytecode()

    def number_of(self, func: Callable[..., Any]) -> int:
        """Return the number that is a part of the kernel's name. Raises NotDigestible."""
        return int(digest_of(func)[:12], 16)

    def set_origin(self, library: Any, func: Callable[..., Any]) -> None:
        """Note in ``library`` where callers in other processes find the kernel, if they call it by its symbol."""


class InlineCompiler(_Compiler):
    """Compiles a kernel that is only inlined."""

    library = InlineLibrary


class WrappedCompiler(_Compiler):
    """Compiles a kernel that Python calls, and that is inlined where other kernels call it."""

    library = EntryLibrary


class EntryCompiler(_Compiler):
    """Compiles a kernel that Python and other kernels call."""

    library = EntryLibrary

    def number_of(self, func: Callable[..., Any]) -> int:
        digest_of(func)
        return int(hashlib.sha256(f"{func.__module__}.{func.__qualname__}".encode()).hexdigest()[:12], 16)

    def set_origin(self, library: Any, func: Callable[..., Any]) -> None:
        library.origin = (func.__module__, func.__qualname__, self.state.args)


def _mangled_record(record: Any) -> tuple[str, tuple[int, ...]]:
    """Return the parts of a record's name in symbols: by its layout, where numba has a number of the process."""
    return "Record", (int(hashlib.sha256(record.name.encode()).hexdigest()[:12], 16),)


setattr(Record, "mangling_args", property(_mangled_record))  # noqa: B010  # numba's types declare a method
JITCPUCodegen._library_class = _KernelLibrary
