"""Names in the reference of the Python interface exist, and each type in a signature has a page or is ignored."""

from __future__ import annotations

import inspect
import re
import runpy
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

import hil

DOCS = Path(__file__).resolve().parents[2] / "docs"
DIRECTIVE = re.compile(
    r"^\.\. (currentmodule|(?:auto)?(?:class|function|module|exception)):: ([\w.]+)(.*(?:\n   :.*)*)$", re.MULTILINE
)


def directives() -> list[tuple[str, str, str]]:
    """Return kind, full name and options of each object that a page documents."""
    found = []
    for page in DOCS.rglob("*.md"):
        module = "hil"
        for kind, name, rest in DIRECTIVE.findall(page.read_text(encoding="utf-8")):
            if kind == "currentmodule":
                module = name
            else:
                found.append((kind, name if name.startswith("hil.") else f"{module}.{name}", rest))
    return sorted(set(found))


def resolved(name: str) -> Any:
    """Return the object of a dotted name."""
    module, parts = name, []
    while True:
        try:
            value: Any = import_module(module)
            break
        except ModuleNotFoundError:
            module, _, last = module.rpartition(".")
            parts.insert(0, last)
    for part in parts:
        value = getattr(value, part)
    return value


@pytest.mark.parametrize(("kind", "name"), [each[:2] for each in directives()])
def test_documented_name_exists(kind: str, name: str) -> None:
    assert inspect.ismodule(resolved(name)) == ("module" in kind)


def types_in(hint: Any) -> Iterator[type]:
    """Yield the classes of this package in a type."""
    if inspect.isclass(hint) and hint.__module__.startswith("hil."):
        yield hint
    for inner in get_args(hint):
        yield from types_in(inner)


def signatures(kind: str, value: Any, rest: str) -> Iterator[Any]:
    """Yield the functions whose signatures the page of an object shows. rest: of its directive."""
    if inspect.isfunction(value):
        yield value
    if kind != "autoclass":
        return
    if not rest.startswith("("):
        yield value.__init__
    for name, member in vars(value).items() if ":members:" in rest else ():
        member = member.fget if isinstance(member, property) else member
        if inspect.isfunction(member) and not name.startswith("_") and member.__doc__:
            yield member


def test_types_in_signatures_have_a_page_or_are_ignored() -> None:
    found = [(kind, resolved(name), rest) for kind, name, rest in directives() if "module" not in kind]
    documented = [value for _, value, _ in found] + [
        each for each in vars(hil.errors).values() if inspect.isclass(each)
    ]
    ignored = [pattern for _, pattern in runpy.run_path(str(DOCS / "conf.py"))["nitpick_ignore_regex"]]
    missing = set()
    for function in (each for values in found for each in signatures(*values)):
        try:
            hints = get_type_hints(function)
        except NameError:  # of type checkers alone: the site shows the names as they are written
            continue
        shown = {*inspect.signature(function).parameters, "return"}
        for kind in (each for name, hint in hints.items() if name in shown for each in types_in(hint)):
            name = f"{kind.__module__}.{kind.__qualname__}"
            if kind not in documented and not any(re.fullmatch(p, name) for p in ignored):
                missing.add(f"{name} in {function.__qualname__}")
    assert missing == set()


def test_each_public_name_is_in_the_reference() -> None:
    documented = {name.rpartition(".")[2] for _, name, _ in directives()}
    text = "\n".join(page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md"))
    assert {name for name in hil.__all__ if name not in documented and f"hil.{name}" not in text} <= {"__version__"}
