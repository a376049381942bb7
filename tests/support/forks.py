"""Python code in a fork of a process that has made the imports: a tenth of the time of a start.

The code meets a process that has loaded the program and its kernels, but neither executed a command nor loaded code of
a user; or one that has imported numba alone.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parents[2]


def forked(
    code: str, folder: Path | None = None, *, loaded: str = "program", **environment: str
) -> subprocess.CompletedProcess[str]:
    """Return the result of ``code``, executed in ``folder`` (default: this process's) without standard input.

    loaded: "program" or "numba".
    """
    server = _server(loaded)
    assert server.stdin is not None
    assert server.stdout is not None
    with tempfile.TemporaryDirectory() as outputs:
        files = [Path(outputs, name) for name in ("out", "err")]
        request = {"code": code, "folder": str(folder or Path.cwd()), "files": list(map(str, files))}
        server.stdin.write(json.dumps(request | {"environment": os.environ | environment}) + "\n")
        server.stdin.flush()
        status = int(server.stdout.readline())
        out, err = (file.read_text() for file in files)
    return subprocess.CompletedProcess([code], status, out, err)


def hil(*arguments: str, before: str = "") -> subprocess.CompletedProcess[str]:
    """Return the result of a command of ``hil``. before: code that is executed before it."""
    return forked(f"{before}\nfrom hil.cli.main import main\nmain({list(arguments)})")


@cache
def _server(loaded: str) -> subprocess.Popen[str]:
    """Return the process that forks; it ends with this one."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", __name__, loaded]
    return subprocess.Popen(
        command, cwd=ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def _load_program() -> None:
    import pytest  # noqa: F401

    import hil.cli.main
    import hil.parts.campaigns.placement
    import hil.parts.campaigns.pytest_plugin.campaign_session
    import hil.report.page

    hil.run("scheme-1", duration_s=0.1)  # loads the kernels


def _load_numba() -> None:
    import numba  # noqa: F401


def _serve(loaded: str) -> None:
    {"program": _load_program, "numba": _load_numba}[loaded]()
    assert threading.active_count() == 1  # a fork has no other
    gc.collect()
    gc.freeze()  # no fork collects what it has not made
    for line in sys.stdin:
        if (child := os.fork()) == 0:
            _execute(json.loads(line))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)  # noqa: T201


def _execute(request: Mapping[str, Any]) -> NoReturn:
    code = 1
    try:
        for number, file in enumerate(request["files"], start=1):
            os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT), number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.environ.clear()
        os.environ.update(request["environment"])
        os.chdir(request["folder"])
        sys.path[0] = ""
        exec(request["code"], {"__name__": "__main__"})
        code = 0
    except SystemExit as error:
        code = int(error.code or 0)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)  # the exit of an interpreter that has loaded kernels takes longer than most requests


if __name__ == "__main__":
    _serve(sys.argv[1])
