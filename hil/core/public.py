"""Arguments of the public Python API, checked by their annotations: a wrong call is answered by one line."""

from __future__ import annotations

import functools
import inspect
import math
import os
import types
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import (
    Annotated,
    Any,
    Final,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    Unpack,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from hil.errors import BadInput, Problem, did_you_mean, missing_package

_F = TypeVar("_F", bound=Callable[..., Any])


class _Allowed(NamedTuple):
    """What an argument may be. names: in messages; one that has none may be anything."""

    accepts: Callable[[Any], bool]
    names: tuple[str, ...]


def _is_integer(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool | np.bool_)


def _from(least: int, name: str) -> _Allowed:
    return _Allowed(lambda value: _is_integer(value) and value >= least, (name,))


_ANYTHING: Final = _Allowed(lambda _: True, ())
_POSITIVE: Final = _Allowed(lambda v: _is_number(v) and math.isfinite(v) and v > 0.0, ("a number above 0",))
_BY_NAME: Final[Mapping[str, _Allowed]] = {
    "seed": _from(0, "an integer, not negative"),
    "case": _from(0, "an integer, not negative"),
    "runs": _from(1, "an integer, at least 1"),
    "rows": _from(1, "an integer, at least 1"),
    "sobol": _from(1, "an integer, at least 1"),
    "workers": _from(0, "an integer, at least 0"),
    "duration_s": _POSITIVE,
    "speed": _POSITIVE,
}
"""Arguments that mean the same in each function, with their bounds."""
_OF_TYPE: Final[Mapping[Any, _Allowed]] = {
    bool: _Allowed(lambda value: isinstance(value, bool | np.bool_), ("True or False",)),
    int: _Allowed(_is_integer, ("an integer",)),
    float: _Allowed(_is_number, ("a number",)),
    str: _Allowed(lambda value: isinstance(value, str), ("a name",)),
    np.ndarray: _Allowed(lambda value: isinstance(value, np.ndarray), ("a numpy array",)),
}
_SEVERAL: Final = {"an integer": "integers", "a number": "numbers", "a dict": "tables", "a name": "texts"}


def public(function: _F) -> _F:
    """Return ``function``, a method, or a class, whose arguments are checked before it is called.

    An argument that is unknown, missing, or not of the type of its annotation raises BadInput, which names it with its
    value and what is allowed; so does a package of an extra that is not installed.
    """
    if isinstance(function, type):
        made: Any = function
        made.__init__ = _checked(made.__init__, function.__name__)
        return function
    return cast(_F, _checked(function, function.__name__))


def _checked(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        signature = _signature(function)
        try:
            bound = signature.bind(*arguments, **named)
        except TypeError as error:
            raise BadInput([_problem_of_call(signature, name, arguments, named, error)]) from None
        rules = _rules(function)
        problems = [
            _problem(signature, name, key, f"{value!r:.60}: must be {_joined(rules[key].names)}")
            for key, value in bound.arguments.items()
            if key in rules and not rules[key].accepts(value)
        ]
        if problems:
            raise BadInput(problems)
        try:
            return function(*arguments, **named)
        except ModuleNotFoundError as error:
            if text := missing_package(error):
                raise BadInput.single(name, "", text) from error
            raise

    made: Any = call
    made.__signature__ = _signature(function)
    return call


@functools.cache
def _signature(function: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of ``function`` with each of the options that a table of types declares."""
    signature = inspect.signature(function)
    parameters = []
    for parameter in signature.parameters.values():
        table = _evaluated(parameter.annotation, function) if parameter.kind is parameter.VAR_KEYWORD else None
        if get_origin(table) is not Unpack:
            parameters.append(parameter)
            continue
        for name, kind in get_type_hints(get_args(table)[0], include_extras=True).items():
            default = None
            if get_origin(kind) is Annotated:  # with its default
                kind, default = get_args(kind)
            parameters.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind))
    return signature.replace(parameters=parameters)


def _problem(signature: inspect.Signature, name: str, key: str, text: str) -> Problem:
    """Return a problem of an argument; that of a method also names the method."""
    is_method = "self" in signature.parameters and not name[0].isupper()
    return Problem(name, key, text) if is_method else Problem(key, "", text)


def _problem_of_call(
    signature: inspect.Signature, name: str, arguments: Sequence[Any], named: Mapping[str, Any], error: TypeError
) -> Problem:
    """Return what is wrong with the names or the number of the arguments."""
    known = {key: each for key, each in signature.parameters.items() if key != "self"}
    for key in named:
        if key not in known:
            text = f"unknown argument: {did_you_mean(key, known)}known here: {', '.join(known)}"
            return Problem(name, key, text)
    given = {*named, *list(signature.parameters)[: len(arguments)]}
    missing = [key for key, each in known.items() if each.default is each.empty and key not in given]
    return Problem(name, ", ".join(missing), "is missing" if missing else str(error))


@functools.cache
def _rules(function: Callable[..., Any]) -> dict[str, _Allowed]:
    """Return what each argument of ``function`` may be; one that may be anything is left out."""
    rules = {}
    for name, parameter in _signature(function).parameters.items():
        allowed = _allowed(_evaluated(parameter.annotation, function))
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD) or not allowed.names:
            continue
        by_name = _BY_NAME.get(name)
        optional = allowed.accepts(None)
        rules[name] = allowed if by_name is None else _optional(by_name) if optional else by_name
    return rules


def _optional(allowed: _Allowed) -> _Allowed:
    return _Allowed(lambda value: value is None or allowed.accepts(value), allowed.names)


def _evaluated(annotation: Any, function: Any) -> Any:
    """Return the type that ``annotation`` names, Any if it is imported for type checkers alone."""
    if not isinstance(annotation, str):
        return annotation
    try:
        return eval(annotation, function.__globals__)
    except NameError:
        return Any


def _allowed(kind: Any) -> _Allowed:
    """Return what an argument of type ``kind`` may be."""
    origin, inner = get_origin(kind), get_args(kind)
    if kind in (Any, object, inspect.Parameter.empty):
        return _ANYTHING
    if origin in (Union, types.UnionType):
        return _one_of([_allowed(each) for each in inner])
    if kind is None or kind is types.NoneType:
        return _Allowed(lambda value: value is None, ("None",))
    if origin is Literal:
        return _Allowed(lambda value: isinstance(value, str) and value in inner, tuple(f'"{each}"' for each in inner))
    base = origin or kind
    if base in _OF_TYPE:
        return _OF_TYPE[base]
    if base is Callable:
        return _Allowed(callable, ("a function",))
    if not isinstance(base, type) or (getattr(base, "_is_protocol", False) and base.__module__ != Sequence.__module__):
        return _ANYTHING
    if issubclass(base, os.PathLike):
        return _Allowed(lambda value: isinstance(value, os.PathLike), ("a path",))
    if issubclass(base, Mapping):
        return _Allowed(lambda value: isinstance(value, Mapping), ("a dict",))
    if base in (Sequence, list, tuple):
        return _list_of(_allowed(inner[0]) if inner else _ANYTHING)
    return _Allowed(lambda value: isinstance(value, base), (f"a {base.__name__} object",))


def _one_of(allowed: Sequence[_Allowed]) -> _Allowed:
    if not all(each.names for each in allowed):
        return _ANYTHING
    names = tuple(name for each in allowed for name in each.names if name != "None")
    if set(names) == {"a name", "a path"}:
        names = ("a path",)
    return _Allowed(lambda value: any(each.accepts(value) for each in allowed), names)


def _list_of(inner: _Allowed) -> _Allowed:
    def accepts(value: Any) -> bool:
        is_list = isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes)
        return is_list and all(inner.accepts(each) for each in value)

    several = " or ".join(_SEVERAL.get(name, name) for name in inner.names)
    return _Allowed(accepts, (f"a list of {several}" if several else "a list",))


def _joined(names: Sequence[str]) -> str:
    return " or ".join(filter(None, (", ".join(names[:-1]), names[-1])))
