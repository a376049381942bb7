"""Context of each measured line and each called kernel: the test, or the fixture, that a process runs for.

A plugin of coverage in every process of a measured run (``tests.support.line_tests``), and of pytest in those that run
tests. The context is in the environment, which children inherit and fork servers pass on with each child; a change of
the environment switches the context of the process. Numba calls compiled kernels without a line of Python: the first
call of each in a context is written to a file.

PYTEST_DONT_REWRITE: coverage imports this module before pytest.
"""

from __future__ import annotations

import importlib.abc
import importlib.util
import json
import multiprocessing.spawn
import os
import sys
from collections.abc import Generator, Iterable, Iterator
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final

import coverage
import pytest

from hil.core import child_process

FOLDER: Final = Path(__file__).resolve().parents[2] / "build" / "line_tests"
CALLS, USES = FOLDER / "calls.jsonl", FOLDER / "uses.jsonl"
_CONTEXT: Final = "HIL_TEST_CONTEXT"
_SAVE_WALL_S: Final = 20.0  # allowed for a child to write its data when it ends


class _Contexts(coverage.CoveragePlugin):
    """Static context of a process: the test that started it."""

    def configure(self, config: Any) -> None:
        config.set_option("run:context", os.environ.get(_CONTEXT) or None)


def coverage_init(registry: Any, _options: Any) -> None:
    """Register the plugin of coverage; a forked process registers it again, with the hooks of its parent."""
    registry.add_configurer(_Contexts())
    if not any(isinstance(finder, _NumbaImport) for finder in sys.meta_path):
        _add_hooks()


def _add_hooks() -> None:
    sys.meta_path.insert(0, _NumbaImport())
    sys.addaudithook(_on_event)
    spawn: Any = multiprocessing.spawn
    data_of, prepare = spawn.get_preparation_data, spawn.prepare
    spawn.get_preparation_data = lambda name: data_of(name) | {_CONTEXT: os.environ.get(_CONTEXT, "")}
    spawn.prepare = lambda data: (os.environ.update({_CONTEXT: data.pop(_CONTEXT)}), prepare(data))
    child_process._EXIT_WALL_S = _SAVE_WALL_S  # type: ignore[misc]
    child_process.ChildProcess.close.__defaults__ = (_SAVE_WALL_S,)


def _on_event(event: str, arguments: tuple[Any, ...]) -> None:
    """Switch the context of this process when the environment names another one."""
    if event == "os.putenv" and arguments[0] == _CONTEXT.encode() and (measured := coverage.Coverage.current()):
        measured.switch_context(arguments[1].decode())


class _NumbaImport(importlib.abc.MetaPathFinder):
    """Lets numba's dispatchers write their calls once numba is imported."""

    def __init__(self) -> None:
        self._searching = False

    def find_spec(self, name: str, _path: Any, _target: ModuleType | None = None) -> ModuleSpec | None:
        if name != "numba.core.registry" or self._searching:
            return None
        self._searching = True
        spec = importlib.util.find_spec(name)
        assert spec is not None
        loader: Any = spec.loader
        execute = loader.exec_module
        loader.exec_module = lambda module: (execute(module), _write_calls(module.CPUDispatcher))
        return spec


def _write_calls(dispatcher: Any) -> None:
    call, compiled = dispatcher.__call__, dispatcher.compile
    written = set[tuple[str, FunctionType]]()

    def note(function: FunctionType) -> None:
        key = (os.environ.get(_CONTEXT, ""), function)
        if key in written:
            return
        written.add(key)
        for importable in _importable(function):
            _append(CALLS, [key[0], importable.__module__, importable.__qualname__])

    def noted_call(self: Any, *arguments: Any, **named: Any) -> Any:
        note(self.py_func)
        return call(self, *arguments, **named)

    def noted_compile(self: Any, types: Any) -> Any:
        if "<locals>" in self.py_func.__qualname__:  # a C function, called without the dispatcher
            note(self.py_func)
        return compiled(self, types)

    dispatcher.__call__, dispatcher.compile = noted_call, noted_compile


def _importable(function: FunctionType) -> Iterator[FunctionType]:
    """Yield ``function``, or those of modules that it calls if it is made in another function."""
    if "<locals>" not in function.__qualname__:
        yield function
        return
    for called in called_by(function):
        yield from _importable(called)


def called_by(kernel: Any) -> Iterator[FunctionType]:
    """Yield the functions of this program that ``kernel`` names: those of its digest, and entries as well."""
    from numba.core.extending import _Intrinsic

    from hil.core.kernel_digest import _globals, _names

    function: FunctionType = getattr(kernel, "py_func", kernel)
    names = _names(function.__code__)
    values: list[Any] = [cell.cell_contents for cell in function.__closure__ or ()]
    values += [function.__globals__[name] for name in _globals(function.__code__) & function.__globals__.keys()]
    for value in values:  # grows
        if isinstance(value, ModuleType) and value.__name__.startswith("hil."):
            values += [vars(value)[name] for name in names & vars(value).keys()]
        elif isinstance(value, tuple | list):
            values += value
        elif isinstance(value, dict):
            values += value.values()
        named: Any = value._defn if isinstance(value, _Intrinsic) else getattr(value, "py_func", value)
        if isinstance(named, FunctionType) and not named.__module__.startswith(("numba", "numpy")):
            yield named


def _append(path: Path, row: Iterable[str]) -> None:
    with path.open("a") as file:  # no descriptor stays open, which children of tests would count
        file.write(json.dumps(list(row)) + "\n")


def _name(node_id: str) -> str:
    return node_id.partition("[")[0].partition("@")[0]  # xdist appends the group


def _shared(item: pytest.Item) -> list[str]:
    """Return the contexts of the fixtures of ``item`` that other tests share."""
    known: Any = getattr(item, "_fixtureinfo", None)
    definitions = [found[-1] for found in known.name2fixturedefs.values() if found] if known else []
    return [_fixture(definition) for definition in definitions if definition.scope != "function"]


def _fixture(definition: Any) -> str:
    return f"fixture {definition.baseid}::{definition.argname}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """Name the test in the environment while it runs."""
    _append(USES, [_name(item.nodeid), *_shared(item)])
    return (yield from _in_context(_name(item.nodeid)))


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Generator[None, Any, Any]:
    """Name a fixture that tests share while it is set up."""
    if fixturedef.scope == "function":
        return (yield)
    return (yield from _in_context(_fixture(fixturedef)))


def _in_context(context: str) -> Generator[None, Any, Any]:
    before = os.environ.get(_CONTEXT, "")
    os.environ[_CONTEXT] = context
    try:
        return (yield)
    finally:
        os.environ[_CONTEXT] = before


def pytest_sessionfinish() -> None:
    """Write the data of this process, which pytest-xdist may kill."""
    if measured := coverage.Coverage.current():
        measured.save()
