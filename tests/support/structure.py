"""Structure of the package by its imports: which module is of the core and which of a part, and what the core imports.

    python -m tests.support.structure

prints the imports of the core into parts, the import closure of the cycle, and what a run on the mock rig loads.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

import hil
from hil.parts.declarations import CORE, PARTS

PACKAGE: Final = Path(hil.__file__).parent
CYCLE: Final = ("hil.loop.cycle", "hil.loop.compiled.run_cycles")
"""Modules of the cycle, in Python and compiled."""
ABOVE: Final = "hil.parts.declarations"
"""List of the parts, of none of them."""
_RUN: Final = "import sys, hil; hil.run('scheme-1', duration_s=2.0); print(*sys.modules)"


class Import(NamedTuple):
    """An import of a module of the core from a part."""

    part: str
    module: str
    imported: str


@cache
def modules() -> dict[str, Path]:
    """Return the files of the package by the names of their modules."""
    paths = {path.relative_to(PACKAGE.parent).with_suffix(""): path for path in PACKAGE.rglob("*.py")}
    return {".".join(each.parts).removesuffix(".__init__"): path for each, path in paths.items()}


def lines(names: Iterable[str]) -> int:
    """Return the lines of the modules ``names``."""
    return sum(len(modules()[name].read_text().splitlines()) for name in names)


@cache
def part_of(module: str) -> str:
    """Return the name of the part that ``module`` is of: that with its longest prefix, otherwise the core."""
    owners = {prefix: part.name for part in PARTS for prefix in (f"hil.parts.{part.name}", *part.modules)}
    prefixes = [module.rsplit(".", n)[0] for n in range(module.count(".") + 1)]
    return next((owners[prefix] for prefix in prefixes if prefix in owners), CORE.name)


@cache
def imports(module: str, inside_functions: bool = True) -> frozenset[str]:
    """Return the modules of the package that ``module`` imports, except for the type checker alone."""
    found = set()

    def visit(node: ast.AST) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef) and not inside_functions:
                continue
            if isinstance(child, ast.Import):
                found.update(alias.name for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                inner = [f"{child.module}.{alias.name}" for alias in child.names]
                found.update(name if name in modules() else str(child.module) for name in inner)
            visit(child)

    visit(ast.parse(modules()[module].read_text()))
    return frozenset(name for name in found if name in modules() and name != "hil")


def core_imports() -> list[Import]:
    """Return the imports of the core from parts, those inside functions included."""
    core = [name for name in modules() if part_of(name) == CORE.name and name != ABOVE]
    found = [Import(part_of(each), name, each) for name in core for each in imports(name)]
    return sorted(each for each in found if each.part != CORE.name)


def closure(begin: Iterable[str] = CYCLE) -> set[str]:
    """Return the modules that ``begin`` and what it imports import, with their packages."""
    found: set[str] = set()
    pending = [*begin]
    while pending:
        name = pending.pop()
        if name not in found:
            found.add(name)
            parent = name.rpartition(".")[0]
            pending += [*imports(name, inside_functions=False), *([parent] if parent in modules() else [])]
    return found - {"hil"}


def loaded_by_a_run() -> set[str]:
    """Return the modules of the package that ``hil.run`` has loaded after 2 s of scheme 1 on the mock rig."""
    run = subprocess.run([sys.executable, "-c", _RUN], capture_output=True, text=True, check=True)
    return {name for name in run.stdout.split() if name in modules()}


def report() -> Iterator[str]:
    """Yield the lines of the report."""
    found = core_imports()
    yield f"imports of the core from parts: {len(found)}"
    yield from (f"    {each.part:14}{each.module} -> {each.imported}" for each in found)
    for what, names in (("the cycle imports", closure()), ("hil.run on the mock rig loads", loaded_by_a_run())):
        yield f"{what}: {len(names)} modules, {lines(names)} lines"
        for part in PARTS[1:]:
            if own := sorted(name for name in names if part_of(name) == part.name):
                yield f"    {part.name:14}{lines(own):6} lines: {', '.join(own)}"
    yield "lines of each part:"
    yield from (f"    {part.name:14}{lines(n for n in modules() if part_of(n) == part.name):6}" for part in PARTS)


if __name__ == "__main__":
    print("\n".join(report()))  # noqa: T201
