"""pytest in a process of its own, with the plugin of test campaigns."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import tempfile
import threading
from functools import cache
from pathlib import Path

PLUGIN = "hil.parts.campaigns.pytest_plugin.plugin"
ROOT = Path(__file__).resolve().parents[2]


def pytest_command(*options: str) -> list[str]:
    """Return the command of a pytest run that loads no other plugin."""
    return [sys.executable, "-m", "pytest", *_with_plugin(options)]


def _with_plugin(options: tuple[str, ...]) -> list[str]:
    return ["-p", PLUGIN, "-p", "no:cacheprovider", *options]


def environment() -> dict[str, str]:
    """Return the environment of such a run."""
    return os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(ROOT), "COLUMNS": "200"}


def pytest_run(folder: Path, *options: str, fresh: bool = False) -> subprocess.CompletedProcess[str]:
    """Return the result of pytest in ``folder``. fresh: in a process that has imported nothing before."""
    if fresh:
        command = pytest_command(*options)
        return subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    server = _server()
    assert server.stdin is not None
    assert server.stdout is not None
    with tempfile.TemporaryDirectory() as outputs:
        files = [Path(outputs, name) for name in ("out", "err")]
        request = {"folder": str(folder), "options": _with_plugin(options), "files": list(map(str, files))}
        request["environment"] = {"HIL_TEST_CONTEXT": os.environ.get("HIL_TEST_CONTEXT", "")}  # of coverage_contexts.py
        server.stdin.write(json.dumps(request) + "\n")
        server.stdin.flush()
        code = int(server.stdout.readline())
        out, err = (file.read_text() for file in files)
    return subprocess.CompletedProcess(list(options), code, out, err)


@cache
def _server() -> subprocess.Popen[str]:
    """Return a process that has loaded what campaigns use, and runs each request in a fork; it ends with this one."""
    command = [sys.executable, "-m", "tests.support.pytest_runs"]
    return subprocess.Popen(
        command, cwd=ROOT, env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def _serve() -> None:
    import pytest

    import hil.parts.campaigns.placement
    import hil.parts.campaigns.pytest_plugin.campaign_session
    import hil.report.page

    hil.run("scheme-1", duration_s=0.1)  # loads the kernels
    assert threading.active_count() == 1  # a fork has no other
    gc.collect()
    gc.freeze()  # no fork collects what it has not made
    for line in sys.stdin:
        request = json.loads(line)
        if (child := os.fork()) == 0:
            for number, file in enumerate(request["files"], start=1):
                os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT), number)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.environ.update(request["environment"])
            os.chdir(request["folder"])
            sys.path[0] = ""
            sys.argv = ["pytest", *request["options"]]
            code = pytest.main(request["options"])
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)  # the exit of an interpreter that has loaded kernels takes longer than most requests
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)  # noqa: T201


if __name__ == "__main__":
    _serve()
