"""The examples as programs of their own: at the other end of ``hil dss`` they fly as the library does."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hil.cli.main import execute
from tests.support.external_gnc import C_EXAMPLE, PYTHON_EXAMPLE, c_example, compile_c

pytestmark = pytest.mark.xdist_group("campaign")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def flown_over_udp(folder: Path, language: str, *options: str) -> tuple[int, dict[str, Any]]:
    """Return exit code and numbers of ``hil dss`` in lock-step with an example at the other end."""
    if language == "c":
        sources = [C_EXAMPLE / "gnc_udp.c", C_EXAMPLE / "gnc.c"]
        command = [str(compile_c(sources, folder / "gnc_udp"))]
    else:
        command = [sys.executable, str(PYTHON_EXAMPLE)]
    port, numbers = str(free_port()), folder / f"{language}.json"
    with subprocess.Popen([*command, "127.0.0.1", port]) as program:
        listen = ["--lock-step", "--listen", f"127.0.0.1:{port}", "--json", str(numbers)]
        code = execute(["dss", "scheme-1", *listen, *options])
        assert program.wait(10.0) == 0  # it has heard the goodbye
    return code, json.loads(numbers.read_text())


def test_c_program_in_lock_step_flies_as_the_same_code_in_a_library(tmp_path: Path) -> None:
    _, apart = flown_over_udp(tmp_path, "c", "--duration", "8")
    numbers = tmp_path / "run.json"
    library = ["--set", f"gnc.library={c_example(tmp_path)}"]
    execute(["run", "scheme-1", "--duration", "8", *library, "--json", str(numbers)])
    here = json.loads(numbers.read_text())
    for name in ("navigation", "thrusters", "verdict", "events"):
        assert apart[name] == here[name], name


@pytest.mark.slow
@pytest.mark.parametrize("language", ["c", "python"])
def test_example_flies_scheme_1_through_table_iii_over_udp(tmp_path: Path, language: str) -> None:
    code, summary = flown_over_udp(tmp_path, language)
    assert code == 0
    assert summary["passed"]
