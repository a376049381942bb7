"""Structure of the package: folders, unique names, short signatures."""

from __future__ import annotations

import ast
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import hil
from tests.support import structure

PACKAGE = Path(hil.__file__).parent
ROOT = PACKAGE.parent
LOOSE = {"__init__.py", "__main__.py", "errors.py"}
LAYERS_MOST = 12
PARAMETERS_MOST = 8
KERNELS = {"kernel", "entry"}


def contracts() -> list[dict[str, Any]]:
    """Return the import contracts."""
    found: list[dict[str, Any]] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
        "contracts"
    ]
    return found


def layers() -> list[set[str]]:
    """Return the packages of each layer of the import contract, from the top."""
    contract = contracts()[0]
    assert contract["exhaustive"]
    return [set(re.split(r"\s*[|:]\s*", layer)) for layer in contract["layers"]]


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """Return the syntax trees of the package's modules."""
    return {str(path.relative_to(PACKAGE)): ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")}


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield the functions and methods of a module that are not kernels."""
    for node in ast.walk(tree):
        is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if is_function and KERNELS.isdisjoint(ast.unparse(decorator) for decorator in node.decorator_list):
            yield node


def test_only_three_modules_are_loose() -> None:
    assert {path.name for path in PACKAGE.glob("*.py")} == LOOSE


def test_layers_are_few() -> None:
    assert len(layers()) <= LAYERS_MOST


def test_core_imports_no_part() -> None:
    assert structure.core_imports() == []


def test_contract_of_the_core_names_every_part() -> None:
    (contract,) = [each for each in contracts() if each["name"] == "the core imports no part"]
    assert {*contract["importers"], *contract["forbidden"]} == {part.name for part in structure.PARTS}


def test_parts_are_made_of_modules_that_exist() -> None:
    named = {name for part in structure.PARTS for name in part.modules}
    assert named <= set(structure.modules())


@pytest.mark.parametrize("inner", ["config/tables", "gnc/estimation"])
def test_an_inner_package_imports_none_of_its_outer_one(inner: str, trees: dict[str, ast.Module]) -> None:
    outer = f"hil.{inner.split('/')[0]}"
    own = f"hil.{inner.replace('/', '.')}"
    imported = {
        name
        for module, tree in trees.items()
        if module.startswith(f"{inner}/")
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        for name in [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    }
    assert imported
    assert [name for name in imported if name.startswith(f"{outer}.") and not name.startswith(own)] == []


def test_class_names_are_unique(trees: dict[str, ast.Module]) -> None:
    names = Counter(node.name for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    assert [name for name, count in names.items() if count > 1] == []


def test_long_parameter_lists_are_records(trees: dict[str, ast.Module]) -> None:
    counts = {
        f"{module}: {function.name}": sum(
            len(kind) for kind in (function.args.posonlyargs, function.args.args, function.args.kwonlyargs)
        )
        for module, tree in trees.items()
        for function in functions(tree)
    }
    assert {name: count for name, count in counts.items() if count > PARAMETERS_MOST} == {}


def test_types_are_optional_in_modules_with_kernels_alone() -> None:
    overrides = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]["overrides"]
    (patterns,) = [override["module"] for override in overrides if "disallow_untyped_defs" in override]
    for pattern in patterns:
        paths = ROOT.glob(pattern.replace(".*", ".**.*").replace(".", "/") + ".py")
        assert any(re.search(r"hil\.core\.jit|numba|SensorModule", path.read_text()) for path in paths), pattern
