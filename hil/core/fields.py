"""Field tables of the records: one definition of name, type, shape, unit, frame and meaning.

The numpy dtype of a record, its schema in a recording, the C header and the reference tables of the documentation are
derived from its table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a record.

    type: type code as in numpy, or the table of a nested record. shape: () for a scalar. unit: "1" for a number
    without unit, "" for text. frame: "" for none (``docs/explanation/frames.md``). absent: value in rows of a recording
    that lacks the field.
    """

    name: str
    type: str | Fields
    shape: int | tuple[int, ...] = ()
    unit: str = "1"
    frame: str = ""
    meaning: str = ""
    absent: float = 0.0


def number(name: str, unit: str, meaning: str, absent: float = 0.0) -> Field:
    """Return the field of a number without a frame."""
    return Field(name, "f8", (), unit, "", meaning, absent)


def whole(name: str, meaning: str) -> Field:
    """Return the field of a whole number."""
    return Field(name, "i8", (), "1", "", meaning)


Fields = tuple[Field, ...]
"""Table of a record: its fields in the order of the memory layout."""


def record_dtype(fields: Fields, text: str = "S") -> np.dtype:
    """Return the layout of a record, aligned as a C compiler for x86-64 or ARM64 aligns it.

    text: "u1" for texts as arrays of bytes, as kernels need them.
    """
    formats: list[tuple[str, Any, Any]] = []
    for field in fields:
        if not isinstance(field.type, str):
            formats.append((field.name, record_dtype(field.type, text), field.shape))
        elif field.type.startswith("S") and text == "u1":
            formats.append((field.name, text, int(field.type[1:])))
        else:
            formats.append((field.name, field.type, field.shape))
    return np.dtype(formats, align=True)


def record_class(name: str, fields: Fields, meaning: str) -> np.dtype:
    """Return the layout of a record whose Python objects have the fields as attributes with units in their help.

    The class of the objects is ``type`` of the result; those of nested records are its attributes' own.
    """
    formats = []
    for field in fields:
        inner: Any = field.type
        if not isinstance(inner, str):
            inner = record_class(f"{name}.{field.name}", inner, field.meaning)
        formats.append((field.name, inner, field.shape))
    attributes = {field.name: property(_reader(field.name), doc=described(field)) for field in fields}
    lines = [meaning, "", *(f"{field.name}: {described(field)}" for field in fields)]
    kind: Any = type(name, (np.record,), {"__doc__": "\n".join(lines), "__slots__": (), **attributes})
    return np.dtype((kind, np.dtype(formats, align=True)))


def _reader(name: str) -> Callable[[np.record], Any]:
    def read(record: np.record) -> Any:
        return record[name]

    return read


def described(field: Field) -> str:
    """Return meaning, unit and frame of a field as one phrase."""
    unit = field.unit if field.unit != "1" else ""
    where = f"in {field.frame}" if field.frame and " " not in field.frame else field.frame
    return "; ".join(part for part in (field.meaning, ", ".join(part for part in (unit, where) if part)) if part)


def leaf_fields(fields: Fields, prefix: str = "") -> Iterator[Field]:
    """Yield the plain fields of a record with dotted names; nested records are expanded."""
    for field in fields:
        name = f"{prefix}{field.name}"
        if isinstance(field.type, str):
            yield replace(field, name=name)
        else:
            yield from leaf_fields(field.type, f"{name}.")


def field_of(dtype: np.dtype, name: str) -> tuple[np.dtype, int]:
    """Return type and offset, bytes, of a field; ``name``: dotted for one of a nested record."""
    offset = 0
    for part in name.split("."):
        assert dtype.fields is not None
        dtype, at = dtype.fields[part][:2]
        offset += at
    return dtype, offset


def offset_of(dtype: np.dtype, name: str) -> int:
    """Return the offset of a field, bytes."""
    return field_of(dtype, name)[1]
