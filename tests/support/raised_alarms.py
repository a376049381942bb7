"""Quantities of all alarms that the program can raise, found in its source, for the table of hazards."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from hil.config.load import load_scenario
from hil.core.gnc_records import GncHealth
from hil.loop.motion_sequences import _PLACE_NAMES
from hil.safety.alarms import _KINDS, AlarmLog
from hil.safety.condition_alarms import HealthAlarms

PACKAGE: Final = Path(__file__).resolve().parents[2] / "hil"
_QUANTITY: Final = {"SafetyTrip": 1, "Alarm": 2, "FilterCondition": 0}
"""Class -> place of the quantity among its arguments."""
_COPIES: Final = {"self", "error", "check"}
"""Names from which an alarm is copied: it was raised elsewhere."""


def quantities() -> dict[str, str]:
    """Return each quantity, with * for a part that varies, and the file that raises it first."""
    texts_of = {path: path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
    sources = {path: ast.parse(text) for path, text in texts_of.items()}
    public = {name: text for tree in sources.values() for name, text in _constants(tree) if not name.startswith("_")}
    callers = [(tree, texts_of[path]) for path, tree in sources.items()]
    found = {quantity: "safety/alarms.py" for quantity, _ in _KINDS.values()}
    for path, tree in sources.items():
        if any(f"{name}(" in texts_of[path] for name in _QUANTITY):
            for quantity in _Source(tree, public | dict(_constants(tree)), callers).raised():
                found.setdefault(quantity, str(path.relative_to(PACKAGE)))
    for expression, texts in varying().items():
        place = found.pop(expression)
        found |= {text: place for text in texts if text not in found}
    return found


def _constants(tree: ast.Module) -> Iterator[tuple[str, str]]:
    for node in tree.body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        yield from _texts_of(target, getattr(node, "value", None))


def _texts_of(target: ast.expr | None, value: ast.expr | None) -> Iterator[tuple[str, str]]:
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        for inner, part in zip(target.elts, value.elts, strict=True):
            yield from _texts_of(inner, part)
    elif isinstance(target, ast.Name) and isinstance(value, ast.Constant) and isinstance(value.value, str):
        yield target.id, value.value


class _Source:
    """One file. constants: texts by their names; everything: all files, parsed and as text."""

    def __init__(self, tree: ast.Module, constants: dict[str, str], everything: list[tuple[ast.Module, str]]) -> None:
        self._tree, self._constants, self._everything = tree, constants, everything

    def raised(self) -> Iterator[str]:
        """Yield the quantities of the alarms that are raised here."""
        for function in [node for node in ast.walk(self._tree) if isinstance(node, ast.FunctionDef)]:
            for call in [node for node in ast.walk(function) if isinstance(node, ast.Call)]:
                name = call.func.id if isinstance(call.func, ast.Name) else ""
                if name in _QUANTITY and len(call.args) > _QUANTITY[name]:
                    yield from self._texts(call.args[_QUANTITY[name]], function)

    def _texts(self, node: ast.expr, function: ast.FunctionDef) -> Iterator[str]:
        """Yield the texts that ``node`` can have in ``function``; "" is the quantity of a copy."""
        match node:
            case ast.Constant(value=str(text)):
                yield from [text] if text else []
            case ast.JoinedStr(values=parts):
                yield "".join(next(self._texts(part, function), "*") for part in parts)
            case ast.FormattedValue(value=inner):
                known = isinstance(inner, ast.Name) and inner.id in self._constants
                yield self._constants[inner.id] if known and isinstance(inner, ast.Name) else "*"
            case ast.IfExp(body=one, orelse=other):
                yield from (text for each in (one, other) for text in self._texts(each, function))
            case ast.Name(id=name) if name in self._constants:
                yield self._constants[name]
            case ast.Name(id=name):
                yield from self._values(name, function)
            case ast.Attribute(value=ast.Name(id=name)) if name in _COPIES:
                return
            case _:
                yield f"<{ast.unparse(node)}>"

    def _values(self, name: str, function: ast.FunctionDef) -> Iterator[str]:
        """Yield the texts that are assigned to ``name`` in ``function``, or given to it by callers."""
        for each in ast.walk(function):
            if isinstance(each, ast.Assign):
                for target in each.targets:
                    yield from self._assigned(name, target, each.value, function)
        names = [argument.arg for argument in function.args.args]
        if name not in names:
            return
        defaults = dict(zip(reversed(names), reversed(function.args.defaults), strict=False))
        if name in defaults:
            yield from self._texts(defaults[name], function)
        for tree in [tree for tree, text in self._everything if f"{function.name}(" in text]:
            local = _Source(tree, self._constants | dict(_constants(tree)), [])
            for call in [node for node in ast.walk(tree) if isinstance(node, ast.Call)]:
                if isinstance(call.func, ast.Name) and call.func.id == function.name:
                    given = {keyword.arg: keyword.value for keyword in call.keywords} | dict(
                        zip(names, call.args, strict=False)
                    )
                    if name in given:
                        yield from local._texts(given[name], function)

    def _assigned(self, name: str, target: ast.expr, value: ast.expr, function: ast.FunctionDef) -> Iterator[str]:
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            for inner, part in zip(target.elts, value.elts, strict=True):
                yield from self._assigned(name, inner, part, function)
        elif isinstance(target, ast.Name) and target.id == name:
            yield from self._texts(value, function)
        elif isinstance(target, ast.Tuple) and any(isinstance(e, ast.Name) and e.id == name for e in target.elts):
            yield f"<{ast.unparse(value)}>"


def varying() -> dict[str, list[str]]:
    """Return the quantities behind the expressions that ``quantities`` cannot resolve in the source."""
    health = HealthAlarms(AlarmLog(), load_scenario("scheme-1").value)
    return {
        "<_KINDS.get(type(error), ('device', 'no error'))>": ["device"],
        "<_PLACE_NAMES[mode]>": [*_PLACE_NAMES.values()],
        "<self._of(bit)>": [health._of(bit)[1] for bit in GncHealth if bit],
    }
