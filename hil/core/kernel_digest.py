"""Digest of all that a kernel's machine code depends on.

A bench must never run yesterday's formula, and an edit should compile no more than what it changes. The digest of a
kernel therefore covers its bytecode and, by value, every global that the bytecode names: constants, layouts of records,
and the digests of the kernels and functions that it calls. Comments, docstrings and code that the kernel does not reach
are not in it. A kernel that is compiled on its own (``hil.core.jit.entry``) is called by its symbol: of such a one its
callers contain the name alone.
"""

from __future__ import annotations

import enum
import hashlib
import opcode
import platform
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Final

import llvmlite
import numba
import numpy as np
from numba.core.extending import _Intrinsic

_LENGTH: Final = 16
_LOADS: Final = re.compile(
    rb"((?:%c.)*)%c(.)|.." % (opcode.opmap["EXTENDED_ARG"], opcode.opmap["LOAD_GLOBAL"]), re.DOTALL
)
_COMPILER: Final = ("numpy", "numba", "llvmlite")  # packages whose versions are in every digest
_SOURCES: Final = ("jit.py", "kernel_library.py", "kernel_digest.py")
_PLAIN: Final = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis), range, slice)
OF_IMAGES: Final = ("hil.vmu.", "hil.parts.monitor.")
_MAKERS: Final = frozenset({"array", "asarray", "carray", "copy", "empty", "full", "isfinite", "ones", "zeros"})


class NotDigestible(TypeError):
    """A kernel names a global of a kind whose value has no digest."""


@cache
def _compiler() -> str:
    """Return what every digest depends on: versions of the compiler, and the sources of its adaptation."""
    versions = f"{numba.__version__} {llvmlite.__version__} {platform.python_version_tuple()[:2]} {np.__version__}"
    sources = b"".join((Path(__file__).with_name(name)).read_bytes() for name in _SOURCES)
    return f"{versions} {hashlib.sha256(sources).hexdigest()}"


_known: dict[Any, str] = {}


def digest_of(kernel: Any) -> str:
    """Return the digest of ``kernel``, a compiled function or the function itself. Raises NotDigestible."""
    function = getattr(kernel, "py_func", kernel)
    if function not in _known:
        _known[function] = "being computed"  # a kernel that calls itself
        try:
            text = f"{_compiler()} {_function(function)}"
        except BaseException:
            del _known[function]
            raise
        _known[function] = hashlib.sha256(text.encode()).hexdigest()[:_LENGTH]
    return _known[function]


_allocating: dict[Any, bool] = {}


def allocates(kernel: Any) -> bool:
    """Return whether ``kernel``, or one that it inlines, may make arrays; a user's may in ways that are not seen here.

    The others work on memory that their caller holds: numba need not count the references to it.
    """
    function = getattr(kernel, "py_func", kernel)
    if function not in _allocating:
        _allocating[function] = False  # of a kernel that calls itself
        is_ours = function.__module__.startswith("hil.") and function.__closure__ is None
        is_plain = is_ours and not function.__module__.startswith(OF_IMAGES)
        makes = not (is_plain and _names(function.__code__).isdisjoint(_MAKERS))
        _allocating[function] = makes or any(map(allocates, _inlined(function)))
    return _allocating[function]


def _inlined(function: FunctionType) -> Iterator[Any]:
    """Yield the kernels that ``function`` calls and that are not compiled on their own."""
    names = _names(function.__code__)
    for name in _globals(function.__code__) & function.__globals__.keys():
        value = function.__globals__[name]
        members = vars(value) if isinstance(value, ModuleType) else {}
        for each in (value, *(members[inner] for inner in names & members.keys())):
            is_kernel = hasattr(each, "py_func") or hasattr(each, "compiled")
            if is_kernel and not getattr(each, "compiled_on_its_own", False):
                yield each


def _function(function: FunctionType) -> str:
    names, parts = _names(function.__code__), [_code(function.__code__, function.__doc__)]
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    parts += [f"{name}={_value(cell.cell_contents, names)}" for name, cell in cells]
    parts.append(repr([_value(value, names) for value in function.__defaults__ or ()]))
    for name in sorted(_globals(function.__code__)):
        if name in function.__globals__:
            parts.append(f"{name}={_value(function.__globals__[name], names)}")
    return "\n".join(parts)


def _globals(code: CodeType) -> set[str]:
    """Return the names of globals in ``code`` and the functions inside it: an attribute may have the same name."""
    loads = (int.from_bytes(extended[1::2] + last) for extended, last in _LOADS.findall(code.co_code) if last)
    names = {code.co_names[number >> 1] for number in loads}  # the last bit: whether it is called at once
    return names.union(*(_globals(constant) for constant in code.co_consts if isinstance(constant, CodeType)))


def _names(code: CodeType) -> set[str]:
    """Return the names of globals and attributes in ``code`` and the functions inside it."""
    inner = (_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


def _code(code: CodeType, doc: str | None) -> str:
    constants = [
        _code(constant, None) if isinstance(constant, CodeType) else repr(constant)
        for constant in code.co_consts
        if constant is not doc
    ]
    parts = (code.co_argcount, code.co_varnames, code.co_names, code.co_freevars, code.co_code.hex(), constants)
    return repr(parts)


def _value(value: Any, names: set[str]) -> str:
    """Return a text that differs if ``value``, a global or a part of one, differs. names: of the bytecode."""
    if isinstance(value, enum.Enum):
        return f"{type(value).__name__}.{value.name}={value.value!r}"
    if isinstance(value, (*_PLAIN, np.generic)):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, ModuleType):
        return _module(value, names)
    if getattr(value, "compiled_on_its_own", False):
        return f"entry {value.py_func.__module__}.{value.py_func.__qualname__}"
    if isinstance(value, FunctionType) and value.__module__.partition(".")[0] in _COMPILER:
        return f"{value.__module__}.{value.__qualname__}"
    if hasattr(value, "py_func") or isinstance(value, FunctionType):
        return digest_of(value)
    if isinstance(value, _Intrinsic):
        return digest_of(value._defn)
    return _composite(value, names)


def _composite(value: Any, names: set[str]) -> str:
    if isinstance(value, np.dtype):
        return _layout(value)
    if isinstance(value, tuple | list):
        return repr([_value(item, names) for item in value])
    if isinstance(value, dict):
        return repr([(_value(key, names), _value(item, names)) for key, item in value.items()])
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, enum.EnumMeta):
        members: Any = value
        return repr([(member.name, member.value) for member in members])
    if isinstance(value, type | BuiltinFunctionType | np.ufunc):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', value)}"
    if isinstance(value, numba.types.Type):
        return str(value)
    if type(value).__module__.partition(".")[0] in ("typing", *_COMPILER):
        return f"{type(value).__module__}.{type(value).__qualname__}"
    raise NotDigestible(f"no digest for {type(value).__name__}")


def _module(module: ModuleType, names: set[str]) -> str:
    """Return the digest of the attributes of ``module`` that are among ``names``; other packages by their name."""
    if module.__name__.partition(".")[0] in ("math", *_COMPILER):
        return module.__name__
    members = vars(module)
    return repr([(name, _value(members[name], names)) for name in sorted(names & members.keys())])


_layouts: dict[int, tuple[np.dtype, str]] = {}


def _layout(dtype: np.dtype) -> str:
    """Return the layout of a record: names, types, offsets."""
    if id(dtype) not in _layouts:
        if dtype.fields is None:
            inner = _layout(dtype.base) if dtype.subdtype else dtype.str
            text = f"{inner}{dtype.shape}"
        else:
            fields = [(name, field[1], _layout(field[0])) for name, field in dtype.fields.items()]
            text = f"{hashlib.sha256(repr(fields).encode()).hexdigest()} {dtype.itemsize}"
        _layouts[id(dtype)] = (dtype, text)  # with the dtype: its id stays taken
    return _layouts[id(dtype)][1]
