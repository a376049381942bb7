"""Errors of the parser of the command line as those of the program: option, value, and what is allowed."""

from __future__ import annotations

from typing import Any, Final, get_args

import cyclopts

_NAMES: Final = {bool: "true or false", int: "an integer", float: "a number"}


def text_of(error: cyclopts.CycloptsError) -> str:
    """Return the line for ``error``."""
    argument, command = error.argument, " ".join(("hil", *(error.command_chain or ())))
    token = getattr(error, "token", None)
    option = (token and token.keyword) or (argument.name if argument else "")
    if isinstance(error, cyclopts.UnusedCliTokensError):
        return f"{' '.join(error.unused_tokens or ())}: more than {command} takes, see {command} --help"
    if isinstance(error, cyclopts.RepeatArgumentError):
        return f"{option}: given more than once"
    if isinstance(error, cyclopts.MissingArgumentError) and argument and argument.token_count()[0] == 1:
        keyword = error.keyword or next((each.keyword for each in argument.tokens if each.keyword), None)
        return f"{keyword}: needs a value" if keyword else f"{command}: needs {option}, see {command} --help"
    if isinstance(error, cyclopts.CoercionError) and token and argument and (allowed := _allowed(argument.hint)):
        return f"{option}: {token.value:.60}: must be {allowed}"
    return " ".join(str(error).split())


def _allowed(hint: Any) -> str:
    """Return what a value of the type ``hint`` can be, "" if no number or flag."""
    kinds = get_args(hint) or (hint,)
    return next((name for kind, name in _NAMES.items() if kind in kinds), "")
