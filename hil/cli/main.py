"""``hil``: the command line. Exit codes: 0 done and passed, 1 done but the verdict is fail, 2 invalid input,
3 safe-stopped by a fault or by the operator, 4 internal error, 5 done with what could be read of a recording.

Each command is declared by its part, see ``hil.core.part``; its module is imported only when it is called.
"""

from __future__ import annotations

import faulthandler
import gc
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterable, Sequence
from contextlib import suppress
from types import FrameType
from typing import Any, Final, TextIO, cast, get_args

import cyclopts
from cyclopts import App, Group

from hil.cli import verbosity
from hil.cli.options import declared_problems, refuse
from hil.core.build_info import version_text
from hil.core.incomplete import INCOMPLETE, take_incomplete
from hil.core.operator_commands import STOP_SIGNALS
from hil.core.part import commands_of, parts
from hil.core.surroundings import (
    GARBAGE_THRESHOLD,
    host_limit,
    leave_process,
    remove_temporary_folders,
    settle_matplotlib,
)
from hil.errors import BadInput, BenchError, CampaignStopped, missing_package

PASSED, FAILED, BAD_INPUT, SAFE_STOPPED, DEFECT = range(5)

_DELIVERED: Final = (PASSED, FAILED, INCOMPLETE)
"""Codes by which a reader of the exit code alone would take the results as delivered."""
_PIXELS_MAX: Final = 1 << 27
"""Pixels of an image at most, for OpenCV, which reads this once, from its environment."""
_AGAIN_WALL_S: Final = 0.02
_STOPPED: Final = threading.Event()
"""Whether a signal has stopped the program: what is raised from then on is a consequence."""

COMMANDS: Final = commands_of()
_KINDS: Final = {bool: "true or false", int: "an integer", float: "a number"}

_GROUPS: Final = {
    "Start": ("run", "init", "list", "keys", "preflight", "warm-up"),
    "Look at a run": ("report", "explain", "replay", "export", "recordings", "recover"),
    "Many runs": ("campaign", "margins", "benchmark", "fusion", "ci"),
    "Vehicle, sensors and GNC of your own": ("vehicle", "sensors", "gnc", "dss", "fmu-export"),
    "Work at the bench": ("console", "operators", "emulate", "identify", "commission", "geometry"),
    "Images": ("vmu", "monitor", "cameras", "calibrate", "targets"),
}
"""Title -> commands, in the order of a user's day; others are of parts of other packages."""
_OF_PARTS: Final = Group("Of installed parts", sort_key=len(_GROUPS))
_MADE: Final = [Group(title, sort_key=i) for i, title in enumerate(_GROUPS)]
_GROUP_OF: Final = {name: group for group, names in zip(_MADE, _GROUPS.values(), strict=True) for name in names}

app = App(
    name="hil",
    group_commands=Group("Help and completion", sort_key=len(_GROUPS) + 1),
    help="Hardware-in-the-loop bench controller for spacecraft rendezvous and docking.",
    help_epilogue=verbosity.HELP,
    version=version_text,
    suppress_keyboard_interrupt=False,  # Ctrl-C has the exit code of a safe stop
)
for _order, _name in enumerate(sorted(COMMANDS, key=lambda name: [*_GROUP_OF, name].index(name))):
    _command = COMMANDS[_name]
    app.command(
        _command.path,
        name=_name,
        help="\n\n".join(filter(None, (_command.summary, _command.example and f"Example: {_command.example}"))),
        group=_GROUP_OF.get(_name, _OF_PARTS),
        sort_key=_order,
    )
app.register_install_completion_command(name="--install-completion", help="Install completion for this shell.")


@app.command(name="--show-completion", help='Print the completion for this shell, for eval "$(hil --show-completion)".')
def _show_completion() -> None:
    print(app.generate_completion())  # noqa: T201


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    gc.set_threshold(GARBAGE_THRESHOLD)
    with suppress(AttributeError, OSError, ValueError):  # a stream that was closed from the start
        faulthandler.enable()  # a library of the user's that crashes is named by the stack
    # even if the shell ignores Ctrl-C for this process: a bench must always be stoppable
    for number in STOP_SIGNALS:
        signal.signal(number, _as_ctrl_c)
    sys.unraisablehook = _unraisable
    out, err = (_Output(sys.stdout), _Output(sys.stderr))
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, err)
    for problem in parts().problems:
        print(problem, file=sys.stderr)  # noqa: T201
    remove_temporary_folders()  # of processes that were killed
    settle_matplotlib()
    code = execute(sys.argv[1:] if arguments is None else arguments)
    out.flush()
    if out.reader_left:  # as for a program that SIGPIPE ends: ``hil ... | head``
        code = 128 + signal.SIGPIPE if code in _DELIVERED else code
    elif out.problem and code in _DELIVERED:
        code = _fail(f"standard output: cannot be written: {out.problem}", BAD_INPUT)
    err.flush()
    # everything is closed; the interpreter's own exit takes longer than stopping the bench
    leave_process(code)


class _Output:
    """Stream whose reader may be gone: what cannot be written is dropped, and the run continues.

    problem: the first reason, "" if there is none; reader_left: it is a pipe without a reader. A stream that was closed
    from the start takes everything.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream if stream is not None else open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
        self.problem, self.reader_left = "", False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write ``text``; return its length. Characters that the stream cannot encode are escaped."""
        try:
            self._stream.write(text)
        except UnicodeEncodeError as error:
            self._stream.write(text.encode(error.encoding, "backslashreplace").decode(error.encoding))
        except OSError as error:
            self._fail(error)
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write each of ``lines``."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Flush the stream."""
        try:
            self._stream.flush()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.reader_left = self.reader_left or isinstance(error, BrokenPipeError)
        self.problem = self.problem or error.strerror or str(error)
        self._stream = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115


def execute(arguments: Sequence[str]) -> int:
    """Run one command; return its exit code. Errors are printed to standard error, one line each."""
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(_PIXELS_MAX))
    # before numpy: matrices are small here, and idle BLAS threads take the time of the others
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    take_incomplete()
    try:
        rest, chosen = verbosity.taken(arguments)
        with verbosity.applied(chosen, arguments):
            return _execute(rest)
    except BadInput as error:
        return _fail(str(error), BAD_INPUT)
    except OSError as error:  # of the log file
        return _fail(str(BadInput.single(str(error.filename), "", error.strerror or str(error))), BAD_INPUT)


def _execute(arguments: Sequence[str]) -> int:
    try:
        command, given, _ = app.parse_args(arguments, exit_on_error=False, print_error=False)
        if command.__module__.startswith("hil."):
            refuse(declared_problems(command, given.arguments))
        result = command(*given.args, **given.kwargs)
    except BadInput as error:
        return _fail(str(error), BAD_INPUT)
    except cyclopts.CycloptsError as error:
        return _fail(_text_of(error), BAD_INPUT)
    except (BenchError, CampaignStopped) as error:
        return _fail(str(error), SAFE_STOPPED)
    except KeyboardInterrupt:
        return _fail("stopped by the operator", SAFE_STOPPED)
    except Exception as error:
        if _STOPPED.is_set():
            logging.getLogger(__name__).debug("raised after the stop", exc_info=error)
            return _fail("stopped by the operator", SAFE_STOPPED)
        if isinstance(error, OSError) and error.filename is not None:  # a file or folder of the user
            return _fail(str(BadInput.single(str(error.filename), "", error.strerror or str(error))), BAD_INPUT)
        if isinstance(error, ModuleNotFoundError) and (text := missing_package(error)):
            return _fail(f"hil {arguments[0]}: {text}", BAD_INPUT)
        if limit := host_limit(error):
            return _fail(limit, BAD_INPUT)
        traceback.print_exc()
        return _fail("internal error: please report it with the traceback above", DEFECT)
    code = result if isinstance(result, int) else PASSED
    return INCOMPLETE if code == PASSED and take_incomplete() else code


def _text_of(error: cyclopts.CycloptsError) -> str:
    """Return the line for an error of the parser: option, value, and what is allowed."""
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
    if isinstance(error, cyclopts.CoercionError) and token and argument and (allowed := _allowed_by(argument.hint)):
        return f"{option}: {token.value:.60}: must be {allowed}"
    return " ".join(str(error).split())


def _allowed_by(hint: Any) -> str:
    """Return what a value of the type ``hint`` can be, "" if no number or flag."""
    kinds = get_args(hint) or (hint,)
    return next((name for kind, name in _KINDS.items() if kind in kinds), "")


def _fail(text: str, code: int) -> int:
    print(text, file=sys.stderr)  # noqa: T201
    return code


def _as_ctrl_c(_number: int, _frame: FrameType | None) -> None:
    _STOPPED.set()
    raise KeyboardInterrupt


def _unraisable(dropped: sys.UnraisableHookArgs) -> None:
    """Interrupt once more if an interruption was dropped, as callbacks of the compiler do, which then continues."""
    if dropped.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(dropped)
        return
    again = threading.Timer(_AGAIN_WALL_S, os.kill, (os.getpid(), signal.SIGINT))
    again.daemon = True
    again.start()
