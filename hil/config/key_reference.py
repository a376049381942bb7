"""Reference of the keys of configuration files, from the models that validate them.

The meaning of a key is the docstring under its field.
"""

from __future__ import annotations

import ast
import difflib
import fnmatch
import inspect
import json
import re
import textwrap
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, Final, NamedTuple, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.driver_registry import DeviceTable
from hil.config.tables.model import Live
from hil.config.tables.open_table import FileTable
from hil.config.tables.units import UNITS, split
from hil.errors import BadInput

NO_UNIT: Final = re.compile(
    r"(^|_)(sigmas?|scale|factor|fraction|probability|confidence|eccentricity|relative|damping|coupling|specular|diffuse"
    r"|direction|pole|zonal|normal|axis|axes|max|distortion|k|noise|covariance|error|low|high|mean|value|weight|ratio|risk|exponent)$"
)
"""Numbers without unit. New keys need a unit in their name, or one of these words."""
NOTATION: Final = dict.fromkeys(("fx", "fy", "cx", "cy", "f", "width", "height"), "px") | {
    "fps": "1/s",
    "level": "grey levels",
    "sky": "grey levels",
    "read": "grey levels",
    "at_most": "of the column",
    "at_least": "of the column",
}
"""Keys of cameras, scenes and requirements in the notation of their field -> unit."""
UNKNOWN_UNIT: Final = "?"
"""Unit of a number whose name has none: of keys of other packages alone."""


class KeyRow(NamedTuple):
    """One key of a configuration table, as its row in the reference shows it."""

    name: str
    type: str
    unit: str
    allowed: str
    default: str
    meaning: str


class KeyTable(NamedTuple):
    """One table of a configuration file: the places at which it occurs, its model, and its own keys."""

    places: list[str]
    model: type[BaseModel]
    inherits: str
    keys: list[KeyRow]


def tables(root: type[BaseModel]) -> list[KeyTable]:
    """Return the tables of a file in the order of its model; a model that occurs at several places is one table."""
    by_model: dict[type[BaseModel], KeyTable] = {}
    _visit(root, "", by_model)
    return list(by_model.values())


def _visit(model: type[BaseModel], path: str, by_model: dict[type[BaseModel], KeyTable]) -> None:
    base = next((base for base in model.__mro__[1:] if base in by_model), None)
    inherited = set(base.model_fields) if base else set()
    if model in by_model:
        by_model[model].places.append(path)
    else:
        keys = [key for key in own_keys(model) if key.name not in inherited]
        by_model[model] = KeyTable([path], model, f"`[{by_model[base].places[0]}]`" if base else "", keys)
    for name, field in model.model_fields.items():
        if name not in inherited:
            for inner, suffix in _inner_models(field.annotation):
                _visit(inner, f"{path}.{name}{suffix}".lstrip("."), by_model)
    if issubclass(model, DeviceTable) and model is not DeviceTable:
        for name, inner in model.driver_tables().items():
            _visit(inner, f"{path}.{name}", by_model)


def _inner_models(annotation: Any, suffix: str = "") -> Iterator[tuple[type[BaseModel], str]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, suffix
        return
    origin = get_origin(annotation)
    for argument in get_args(annotation):
        yield from _inner_models(argument, ".NAME" if origin is dict else "[]" if origin is tuple else suffix)


def own_keys(model: type[BaseModel]) -> list[KeyRow]:
    schema = model.model_json_schema()
    return [
        _key(model, name, field, schema["properties"][name])
        for name, field in model.model_fields.items()
        if name in meanings(model) or not list(_inner_models(field.annotation))
    ]


def _key(model: type[BaseModel], name: str, field: FieldInfo, schema: dict[str, Any]) -> KeyRow:
    default = "required" if field.is_required() else _shown(schema.get("default"))
    if list(_inner_models(field.annotation)):
        return KeyRow(name, "table", "", "", default, meanings(model)[name])
    options = [option for option in schema.get("anyOf", [schema]) if option.get("type") != "null"]
    option = options[0]
    kind = " or ".join(dict.fromkeys(_type(each) for each in options))
    live = [f"{each.low:g} to {each.high:g} during a run" for each in field.metadata if isinstance(each, Live)]
    allowed = "; ".join(filter(None, (_allowed(option), *live)))
    return KeyRow(name, kind, unit_of(name, kind), allowed, default, meanings(model).get(name, ""))


def unit_of(name: str, kind: str) -> str:
    """Return the unit of a key, "" for a number without one or another type, UNKNOWN_UNIT if its name has none."""
    if name in NOTATION:
        return NOTATION[name]
    if "number" not in kind:
        return ""
    if unit := split(name)[1]:
        return UNITS[unit].text
    return "" if NO_UNIT.search(name) else UNKNOWN_UNIT


def _type(schema: dict[str, Any]) -> str:
    if "prefixItems" in schema:
        return f"{_type(schema['prefixItems'][0])}[{len(schema['prefixItems'])}]"
    if schema.get("type") == "array":
        return f"{_type(schema.get('items', {}))}[]"
    if schema.get("type") == "object":
        return "table"
    names = {"number": "number", "integer": "integer", "string": "text", "boolean": "boolean"}
    return names.get(str(schema.get("type")), "text" if "enum" in schema else "integer" if "const" in schema else "any")


def _allowed(schema: dict[str, Any]) -> str:
    if "enum" in schema:
        return ", ".join(_shown(value) for value in schema["enum"])
    inner = schema.get("prefixItems", [schema.get("items", {})])[0] if schema.get("type") == "array" else schema
    if inner is not schema:
        return _allowed(inner)
    low = _bound("above", schema.get("exclusiveMinimum")) or _bound("from", schema.get("minimum"))
    high = _bound("below", schema.get("exclusiveMaximum")) or _bound("to", schema.get("maximum"))
    return f"{low} {high}".strip()


def _bound(word: str, value: float | None) -> str:
    return "" if value is None else f"{word} {value if isinstance(value, int) else f'{value:g}'}"


def _shown(value: Any) -> str:
    if value is None:
        return "not set"
    text = json.dumps(value, ensure_ascii=False)
    return f"`{text}`" if len(text) <= 60 else "see `configs/`"


@cache
def meanings(model: type[BaseModel]) -> dict[str, str]:
    """Return the docstrings under the fields of a model, inherited ones included, as one line each."""
    texts: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if base is BaseModel or not issubclass(base, BaseModel):
            continue
        (node,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        assert isinstance(node, ast.ClassDef)
        for field, text in zip(node.body, node.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
                assert isinstance(text.value, ast.Constant)
                texts[field.target.id] = " ".join(str(text.value.value).split())
    return texts


class KeyMatch(NamedTuple):
    """A key of scenario or rig files as ``--set`` takes it, and its row in the reference."""

    name: str
    file: str
    row: KeyRow


def all_keys() -> list[KeyMatch]:
    """Return each key of scenario and rig files at each of its places, those of parts included; those of a rig begin
    with ``rig.``."""
    roots: tuple[tuple[str, type[FileTable]], ...] = (("scenario", Scenario), ("rig", Rig))
    return [
        KeyMatch(".".join(filter(None, (root.prefix.rstrip("."), key, path, row.name))), file, row)
        for file, root in roots
        for key, model in ({"": root} | root.added_tables()).items()
        for table in tables(model)
        for path in table.places
        for row in _rows_of(table)
    ]


def _rows_of(table: KeyTable) -> list[KeyRow]:
    return own_keys(table.model) if table.inherits else table.keys


def matching_keys(pattern: str, added: Sequence[KeyMatch] = ()) -> list[KeyMatch]:
    """Return the keys whose name contains ``pattern``, or matches it if it has wildcards; case does not matter.

    added: keys of modules and packages. Raises BadInput if there are none.
    """
    keys = [*all_keys(), *added]
    glob = pattern.lower() if set(pattern) & set("*?[") else f"*{pattern.lower()}*"
    if matches := [key for key in keys if fnmatch.fnmatchcase(key.name.lower(), glob)]:
        return matches
    last = {key.row.name: None for key in keys}
    close = difflib.get_close_matches(pattern.rpartition(".")[2], last, n=3, cutoff=0.5)
    hint = f"; similar: {', '.join(close)}" if close else ""
    raise BadInput.single("hil keys", "", f"{pattern}: no key of scenario or rig has this in its name{hint}")
