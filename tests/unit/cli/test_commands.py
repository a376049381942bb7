"""The command line: each command is declared once, and imported when it is called."""

from __future__ import annotations

import dataclasses
import importlib.util
import inspect
import subprocess
import sys

import pytest

from hil.cli import warm_up
from hil.cli.main import COMMANDS, execute
from hil.core.part import imported
from tests.support import structure

HEAVY = ("numba", "numpy", "pydantic", "hil.config", "hil.core.messages")


@pytest.mark.parametrize("name", [name for name, command in COMMANDS.items() if not command.path.endswith(":app")])
def test_summary_of_each_command_is_that_of_its_function(name: str) -> None:
    function = imported(COMMANDS[name].path)
    assert function.__name__ == name.replace("-", "_")
    text = inspect.getdoc(function)
    assert text is not None
    assert " ".join(text.split("\n\n")[0].split()) == COMMANDS[name].summary


def test_help_of_a_command_loads_nothing_that_its_run_needs() -> None:
    script = f"""
import sys
from hil.cli.main import execute

for name in {[*COMMANDS]}:
    execute([name, "--help"])
    print("loads", name, *(module for module in {HEAVY} if module in sys.modules))
"""
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    for name in COMMANDS:
        assert f"Usage: hil {name}" in found
        assert f"loads {name}\n" in found, found  # of several, the first is at fault


def test_list_of_commands_has_each_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["--help"]) == 0
    listed = {line[2:].split()[0] for line in capsys.readouterr().out.splitlines() if line[:2] == "\u2502 "}
    assert listed >= {*COMMANDS}


@pytest.mark.parametrize("given", [None, "3"])
def test_commands_have_one_blas_thread_by_default(monkeypatch: pytest.MonkeyPatch, given: str | None) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    if given is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
    script = "import sys; from hil.cli import main; assert 'numpy' not in sys.modules; main.execute(['--help']); "
    script += "import os; print(os.environ['OPENBLAS_NUM_THREADS'])"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert found.stdout.splitlines()[-1] == (given or "1")


def test_gnc_of_a_scenario_is_accepted_like_the_commands_of_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["gnc", "scheme-9"]) == 2
    assert "scheme-9: unknown scenario" in capsys.readouterr().err


def test_no_function_of_the_command_line_has_nine_parameters() -> None:
    names = {
        name for name in structure.modules() if {"cli", "commands"} & {*name.split(".")} and name != "hil.cli.main"
    }
    assert {command.path.partition(":")[0] for command in COMMANDS.values()} <= names
    for name in sorted(names):
        module = importlib.import_module(name)
        for found in vars(module).values():
            if inspect.isfunction(found) and found.__module__ == module.__name__:
                assert len(inspect.signature(found).parameters) < 9, found
            if dataclasses.is_dataclass(found) and found.__module__ == module.__name__:
                assert len(dataclasses.fields(found)) < 10, found


def test_unknown_group_of_kernels_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["warm-up", "loop", "laop"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "laop: unknown group, allowed gnc, stages, loop" in line


def test_kernels_that_need_opencv_are_left_out_where_it_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found: list[str] = []
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(warm_up, "_compile_groups", found.extend)
    assert execute(["warm-up"]) == 0
    assert found == ["gnc", "stages", "loop", "verdict", "fusion"]
    assert "monitor      left out: needs OpenCV: pip install 'hil-bench[vision]'" in capsys.readouterr().out
    assert execute(["warm-up", "vmu"]) == 2
    assert capsys.readouterr().err == "warm-up: vmu: needs OpenCV: pip install 'hil-bench[vision]'\n"


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("run scheme-1 extra more", "extra more: more than hil run takes, see hil run --help"),
        ("run scheme-1 --seed abc", "--seed: abc: must be an integer"),
        ("run scheme-1 --speed fast", "--speed: fast: must be a number"),
        ("run scheme-1 --lock-step=7", "--lock-step: 7: must be true or false"),
        ("run scheme-1 --seed 1 --seed 2", "--seed: given more than once"),
        ("run scheme-1 --seed", "--seed: needs a value"),
        ("geometry plan", "hil geometry plan: needs --out, see hil geometry plan --help"),
    ],
)
def test_line_that_cannot_be_parsed_is_answered_with_option_value_and_what_is_allowed(
    line: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(line.split()) == 2
    assert capsys.readouterr().err == f"{text}\n"
