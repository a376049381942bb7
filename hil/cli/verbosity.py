"""Options of every command, anywhere on its line: ``--quiet``, ``--verbose`` and ``--log-file``."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, NamedTuple, TextIO, cast

from hil.cli.output import QUIET
from hil.core.clock import utc_text
from hil.errors import BadInput

HELP: Final = (
    "Of every command: -q, --quiet: results and errors alone, no progress, no notices. -v, --verbose: log what is "
    "started. --log-file FILE: append notices and errors to FILE, with their times."
)
_QUIET: Final = ("-q", "--quiet")
_VERBOSE: Final = ("-v", "--verbose")
_LOG_FILE: Final = "--log-file"


class Verbosity(NamedTuple):
    """What a command prints in addition to its results."""

    quiet: bool = False
    verbose: bool = False
    log_file: str = ""


def taken(arguments: Sequence[str]) -> tuple[list[str], Verbosity]:
    """Return the other arguments, and the options of every command. Raises BadInput."""
    rest, chosen, given = [], Verbosity(), iter(arguments)
    for each in given:
        if each == "--":
            rest += [each, *given]
        elif each in (*_QUIET, *_VERBOSE):
            chosen = chosen._replace(quiet=chosen.quiet or each in _QUIET, verbose=chosen.verbose or each in _VERBOSE)
        elif each.partition("=")[0] == _LOG_FILE:
            file = each.partition("=")[2] or next(given, "")
            if not file:
                raise BadInput.single(_LOG_FILE, "", "give the name of a file")
            chosen = chosen._replace(log_file=file)
        else:
            rest.append(each)
    if chosen.quiet and chosen.verbose:
        raise BadInput.single("--quiet", "", "not together with --verbose")
    return rest, chosen


class _Copied:
    """Stream whose lines are appended to ``file`` as well, each with its time."""

    def __init__(self, stream: TextIO, file: TextIO) -> None:
        self._stream, self._file = stream, file
        self._at_start = True

    def __getattr__(self, name: str) -> object:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write ``text``; return its length."""
        for line in text.splitlines(keepends=True):
            self._file.write(f"{utc_text()} {line}" if self._at_start else line)
            self._at_start = line.endswith("\n")
        self._file.flush()
        return self._stream.write(text)


@contextmanager
def applied(verbosity: Verbosity, arguments: Sequence[str]) -> Iterator[None]:
    """Log as asked for while a command runs. Raises BadInput for a file that cannot be written."""
    log, stream = logging.getLogger("hil"), sys.stderr
    handler: Any = logging.StreamHandler()
    file = open(verbosity.log_file, "a", encoding="utf-8") if verbosity.log_file else None  # noqa: SIM115
    quiet = QUIET.set(verbosity.quiet)
    try:
        if file is not None:
            print(utc_text(), "hil", *arguments, file=file, flush=True)
            sys.stderr = cast(TextIO, _Copied(stream, file))
            handler.setStream(sys.stderr if verbosity.verbose else file)
        if verbosity.verbose or file is not None:
            log.addHandler(handler)
        log.setLevel(logging.INFO if log.handlers else logging.ERROR if verbosity.quiet else logging.NOTSET)
        yield
    finally:
        QUIET.reset(quiet)
        sys.stderr = stream
        log.removeHandler(handler)
        log.setLevel(logging.NOTSET)
        if file is not None:
            file.close()
