"""Settings that an operator may change during a run, and their ranges.

Each cycle reads the keys again that are declared ``Live``. All others determine the initial state (vehicle, step,
geometry, plan, filters) or the verdict (requirements): they are fixed for the whole run.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

from pydantic import BaseModel

from hil.config.tables.model import Live

BACKEND_SETTINGS: Final = ("gnc.navigation.settings.", "gnc.control.settings.")
"""Beginnings of the keys that backends declare; each may change, within the range that its backend declares."""


@cache
def live_ranges(model: type[BaseModel], prefix: str = "") -> dict[str, Live]:
    """Return the ranges during a run by the dotted keys of ``model``, those that are declared ``Live``."""
    ranges: dict[str, Live] = {}
    for name, field in model.model_fields.items():
        key = f"{prefix}.{name}".lstrip(".")
        for each in field.metadata:
            if isinstance(each, Live):
                ranges[key] = each
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            ranges |= live_ranges(inner, key)
    return ranges


@cache
def range_of(model: type[BaseModel], key: str) -> dict[str, Any]:
    """Return the limits of the number at the dotted ``key`` of ``model``, during a run if it is ``Live``.

    low, high: None if unlimited. low_open, high_open: the limit itself is excluded. words: the range as text.
    """
    live = live_ranges(model).get(key)
    *tables, last = key.split(".")
    for table in tables:
        inner = model.model_fields[table].annotation
        assert isinstance(inner, type)
        assert issubclass(inner, BaseModel)
        model = inner
    schema = model.model_json_schema()["properties"][last]
    low, low_open = schema.get("exclusiveMinimum", schema.get("minimum")), "exclusiveMinimum" in schema
    high, high_open = schema.get("exclusiveMaximum", schema.get("maximum")), "exclusiveMaximum" in schema
    if live is not None:
        if low is None or live.low > low:
            low, low_open = live.low, False
        if high is None or live.high < high:
            high, high_open = live.high, False
    if low is not None and high is not None:
        words = f"{'above ' if low_open else ''}{low:g} to {'below ' if high_open else ''}{high:g}"
    elif low is not None:
        words = f"above {low:g}" if low_open else f"{low:g} or more"
    elif high is not None:
        words = f"below {high:g}" if high_open else f"{high:g} or less"
    else:
        words = "any number"
    return {"low": low, "high": high, "low_open": low_open, "high_open": high_open, "words": words}


def within(allowed: dict[str, Any], value: float) -> bool:
    """Return whether ``value`` is in a range of ``range_of``."""
    low, high = allowed["low"], allowed["high"]
    too_low = low is not None and (value < low or (value == low and allowed["low_open"]))
    too_high = high is not None and (value > high or (value == high and allowed["high_open"]))
    return not (too_low or too_high)


def value_of(table: BaseModel, key: str) -> float:
    """Return the number at the dotted ``key`` of ``table``."""
    node: Any = table
    for name in key.split("."):
        node = node[name] if isinstance(node, dict) else getattr(node, name)
    return float(node)
