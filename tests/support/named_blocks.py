"""Blocks of a module: functions, methods, and statements outside of them; and which tests and functions name those."""

from __future__ import annotations

import ast
import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, TypeVar

_User = TypeVar("_User")
_FUNCTIONS: Final = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Block:
    """Lines ``first`` to ``last`` of ``file``.

    body: lines that run when a function is called, () for a statement. binds: names that a statement binds.
    """

    file: str
    name: str
    first: int
    last: int
    digest: str
    body: tuple[int, ...]
    binds: tuple[str, ...]

    @property
    def is_field(self) -> bool:
        """Whether it is a statement in the body of a class."""
        return not self.body and "." in self.name


def blocks_of(path: Path, root: Path) -> list[Block]:
    """Return the blocks of a source file, in order; without imports and docstrings."""
    text = path.read_text()
    names = Counter[str]()
    blocks = []
    for block in _blocks(ast.parse(text).body, "", text.splitlines(), str(path.relative_to(root))):
        names[block.name] += 1
        number = names[block.name]
        blocks.append(block if number == 1 else replace(block, name=f"{block.name} {number}"))
    return blocks


def _blocks(statements: list[ast.stmt], inside: str, text: list[str], file: str) -> Iterator[Block]:
    for node in statements:
        first = min([node.lineno, *(item.lineno for item in getattr(node, "decorator_list", ()))])
        last = node.end_lineno or first
        if isinstance(node, ast.Import | ast.ImportFrom) or _is_docstring(node):
            continue
        if isinstance(node, ast.ClassDef):
            head = node.body[0].lineno - 1
            yield _block(file, f"{inside}{node.name}", first, head, text, (), (node.name,))
            yield from _blocks(node.body, f"{inside}{node.name}.", text, file)
        elif isinstance(node, _FUNCTIONS):
            start = node.body[1 if _is_docstring(node.body[0]) and len(node.body) > 1 else 0].lineno
            yield _block(file, f"{inside}{node.name}", first, last, text, tuple(range(start, last + 1)), (node.name,))
        else:
            names = tuple(_bound(node))
            name = names[0] if names else ast.unparse(node).partition("\n")[0][:40]
            yield _block(file, inside + name, first, last, text, (), names)


def _block(
    file: str, name: str, first: int, last: int, text: list[str], body: tuple[int, ...], binds: tuple[str, ...]
) -> Block:
    digest = hashlib.sha256("\n".join(text[first - 1 : last]).encode()).hexdigest()[:8]
    return Block(file, name, first, last, digest, body, binds)


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _bound(node: ast.AST) -> Iterator[str]:
    """Yield the names that a statement binds, in the order of its text."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.Name) and isinstance(inner.ctx, ast.Store):
            yield inner.id
        elif isinstance(inner, (*_FUNCTIONS, ast.ClassDef)):
            yield inner.name


_Key = tuple[str, str]
_Users = Mapping[_Key, set[_User]]


@dataclass
class _Module:
    """Names of a module: where those that it imports are defined, and what its blocks and tests name."""

    tree: ast.Module
    imported: dict[str, tuple[str, str]]  # name here -> module, name there ("" for the module itself)

    def named(self, tree: ast.AST, module: str) -> Iterator[tuple[int, tuple[str, str]]]:
        """Yield line, module and name of each name in ``tree``, with module "" of each attribute and keyword."""
        for node in ast.walk(tree):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
                yield node.lineno, self.imported.get(node.id, (module, node.id))
            elif isinstance(node, ast.Attribute):
                yield node.lineno, ("", node.attr)
                if isinstance(node.value, ast.Name) and node.value.id in self.imported:
                    there, name = self.imported[node.value.id]
                    yield node.lineno, (f"{there}.{name}" if name else there, node.attr)
            elif isinstance(node, ast.keyword) and node.arg:
                yield node.lineno, ("", node.arg)


def _read(path: Path) -> _Module:
    tree = ast.parse(path.read_text())
    imported = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            imported |= {alias.asname or alias.name: (node.module, alias.name) for alias in node.names}
        elif isinstance(node, ast.Import):
            imported |= {alias.asname: (alias.name, "") for alias in node.names if alias.asname}
    return _Module(tree, imported)


class Names:
    """Which tests, functions and statements name what."""

    def __init__(self, root: Path) -> None:
        self._root = root

    @cached_property
    def _index(self) -> tuple[_Users[Block], _Users[str]]:
        """Blocks, and tests, by the module and name that they name."""
        blocks, tests = defaultdict[_Key, set[Block]](set), defaultdict[_Key, set[str]](set)
        for path in sorted((self._root / "hil").rglob("*.py")):
            read, at_line = _read(path), {}
            for block in blocks_of(path, self._root):
                at_line |= dict.fromkeys(range(block.first, block.last + 1), block)
            for line, key in read.named(read.tree, _dotted(path, self._root)):
                if line in at_line:
                    blocks[key].add(at_line[line])
        for path in sorted((self._root / "tests").rglob("test_*.py")):
            read = _read(path)
            for node in read.tree.body:
                if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                    for _, key in read.named(node, ""):
                        tests[key].add(f"{path.relative_to(self._root)}::{node.name}")
        return blocks, tests

    def users(self, block: Block) -> tuple[set[str], set[Block]]:
        """Return the tests that name a statement, and the functions that do, over other statements as well.

        If none does, all functions of its module.
        """
        blocks, tests = self._index
        pending, users = [block], {block}
        for statement in pending:  # grows
            new = {user for key in self._keys(statement) for user in blocks.get(key, ())} - users
            users |= new
            pending += [user for user in new if not user.body]
        functions = {user for user in users if user.body} or self.functions(block.file)
        return {test for key in self._keys(block) for test in tests.get(key, ())}, functions

    def functions(self, file: str) -> set[Block]:
        """Return the functions of a module."""
        return {block for block in blocks_of(self._root / file, self._root) if block.body}

    def _keys(self, block: Block) -> list[_Key]:
        """Return module and name of what a statement binds; that of a field is named as an attribute."""
        module = "" if block.is_field else _dotted(self._root / block.file, self._root)
        return [(module, name) for name in block.binds]


def _dotted(path: Path, root: Path) -> str:
    name = ".".join(path.relative_to(root).with_suffix("").parts)
    return name.removesuffix(".__init__")
