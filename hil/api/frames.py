"""Tables of pandas, polars and xarray from records and campaigns; each library is imported when it is asked for."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any, Final

import numpy as np

from hil.core.fields import leaf_fields
from hil.core.messages import CYCLE_FIELDS, Array
from hil.errors import BadInput
from hil.recording.schema import columns, flat_dtype, present_column

_AXES: Final = ("x", "y", "z")
_QUATERNION: Final = ("q1", "q2", "q3", "q0")
_UNITS: Final = {field.name: field for field in leaf_fields(CYCLE_FIELDS)}


def library(name: str) -> Any:
    """Return the module ``name``; raise BadInput if it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        text = f"is not installed: pip install {name}"
        raise BadInput.single(f"to_{name}", name, text) from error


def columns_of(records: np.ndarray) -> dict[str, Array]:
    """Return each number of ``records`` (n,) but the time by its name, ``truth.r_CT_H[0]``, as in ``hil export``."""
    return {name: np.ascontiguousarray(values) for name, values in columns(_flat(records)) if name != "t_s"}


def units_of(names: list[str]) -> dict[str, str]:
    """Return the unit of each column of ``columns_of`` that has one."""
    fields = ((name, _UNITS.get(name.partition("[")[0])) for name in names)
    return {name: field.unit for name, field in fields if field is not None and field.unit not in ("", "1")}


class _Units(dict[str, str]):
    """Units of columns, by their present and their earlier names."""

    def __missing__(self, name: str) -> str:
        if (present := present_column(name)) not in self:
            raise KeyError(name)
        return self[present]


@cache
def _table_class() -> Any:
    """Return the class of a table of pandas whose columns are also found by their earlier names."""
    base = library("pandas").DataFrame

    def present(table: Any, name: Any) -> Any:
        return present_column(name) if isinstance(name, str) and name not in table.columns else name

    def get(table: Any, key: Any) -> Any:
        several = isinstance(key, list)
        return base.__getitem__(table, [present(table, name) for name in key] if several else present(table, key))

    names = {"__getitem__": get, "_constructor": property(lambda _: _table_class()), "__module__": __name__}
    return type("CycleTable", (base,), names)


def __getattr__(name: str) -> Any:
    """Return the class of tables of pandas by its name, which pickled tables have."""
    if name != "CycleTable":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _table_class()


def to_pandas(records: np.ndarray, t_s: Array) -> Any:
    """Return a DataFrame of ``records`` (n,), indexed by time, s; units in ``attrs["units"]``."""
    pandas, columns = library("pandas"), columns_of(records)
    frame = _table_class()(columns, index=pandas.Index(t_s, name="t_s"))
    frame.attrs["units"] = _Units(units_of(list(columns)))
    return frame


def to_polars(records: np.ndarray, t_s: Array) -> Any:
    """Return a polars DataFrame of ``records`` (n,) with the column ``t_s``."""
    return library("polars").DataFrame({"t_s": t_s, **columns_of(records)})


def to_xarray(records: np.ndarray, t_s: Array) -> Any:
    """Return a Dataset of ``records`` (n,): time as index, axes x y z by name, units and frames in the attributes."""
    xarray, variables = library("xarray"), {}
    coordinates: dict[str, Any] = {"t_s": ("t_s", t_s, {"units": "s"})}
    for name, values in _leaves(records).items():
        dimensions = ["t_s"]
        for i, size in enumerate(values.shape[1:]):
            dimension = _dimension(name, size, i)
            dimensions.append(dimension)
            if dimension in ("axis", "component"):
                coordinates[dimension] = list(_AXES if dimension == "axis" else _QUATERNION)
        field = _UNITS.get(name)
        attributes = {} if field is None else {"units": field.unit, "frame": field.frame, "long_name": field.meaning}
        variables[name.replace(".", "_")] = (dimensions, values, attributes)
    return xarray.Dataset(variables, coords=coordinates)


def _leaves(records: np.ndarray) -> dict[str, Array]:
    """Return the plain fields of ``records`` with dotted names, without the time, which is the index."""
    flat = _flat(records)
    return {name: np.ascontiguousarray(flat[name]) for name in flat.dtype.names or () if name != "t_s"}


def _flat(records: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(records).view(flat_dtype(records.dtype))


def _dimension(name: str, size: int, axis: int) -> str:
    if size == 3 and axis == 0:
        return "axis"
    if size == 4 and name.rpartition(".")[2].startswith("q_"):
        return "component"
    return f"n{size}" if axis == 0 else f"m{size}"
