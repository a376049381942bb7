"""Help of the command line: groups in the order of a user's day, an example for each command, options of all."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from hil.cli.main import _GROUPS, BAD_INPUT, COMMANDS, PASSED, app, execute
from hil.cli.verbosity import Verbosity, taken
from hil.errors import BadInput


def test_help_lists_each_command_in_its_group(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["--help"]) == PASSED
    text = capsys.readouterr().out
    places = [text.index(title) for title in _GROUPS]
    assert places == sorted(places)
    assert {name for names in _GROUPS.values() for name in names} == {name for name in COMMANDS if " " not in name}
    assert "--quiet" in text


@pytest.mark.parametrize("name", COMMANDS)
def test_example_of_a_command_is_one_that_it_takes(name: str) -> None:
    program, *arguments = shlex.split(COMMANDS[name].example)
    assert (program, arguments[: len(name.split())]) == ("hil", name.split())
    app.parse_args(arguments, exit_on_error=False, print_error=False)


def test_help_of_a_command_ends_with_its_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["margins", "--help"]) == PASSED
    assert "Example: hil margins scheme-1 --runs 20" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "rest", "found"),
    [
        (["run", "scheme-1", "-q"], ["run", "scheme-1"], Verbosity(quiet=True)),
        (["-v", "list", "--log-file", "a.log"], ["list"], Verbosity(verbose=True, log_file="a.log")),
        (["--log-file=a.log", "list"], ["list"], Verbosity(log_file="a.log")),
        (["list", "--", "-q"], ["list", "--", "-q"], Verbosity()),
    ],
)
def test_options_of_every_command_may_stand_anywhere(arguments: list[str], rest: list[str], found: Verbosity) -> None:
    assert taken(arguments) == (rest, found)


@pytest.mark.parametrize("arguments", [["list", "--log-file"], ["-q", "list", "-v"]])
def test_options_that_contradict_are_refused(arguments: list[str]) -> None:
    with pytest.raises(BadInput):
        taken(arguments)


def test_notices_and_errors_are_appended_to_the_log_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "hil.log"
    for _ in range(2):
        assert execute(["--log-file", str(file), "list", "planets"]) == BAD_INPUT
    lines = [line.partition(" ")[2] for line in file.read_text().splitlines()]
    assert lines[0] == f"hil --log-file {file} list planets"
    assert lines[1].startswith("hil list: planets: ")
    assert len(lines) == 4
    assert "planets" in capsys.readouterr().err
    assert execute(["--log-file", str(tmp_path / "none" / "hil.log"), "list"]) == BAD_INPUT


def test_quiet_command_prints_its_results_alone(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", "scheme-1", "--duration", "0.1"]
    execute([*command, "--set", "gnc.abort.at_s=100", "-q"])
    printed = capsys.readouterr()
    assert "FAIL scheme-1" in printed.out
    assert printed.err == ""


def test_verdict_is_explained_line_by_line(capsys: pytest.CaptureFixture[str]) -> None:
    execute(["run", "scheme-1", "--duration", "0.1", "--explain"])
    lines = capsys.readouterr().out.splitlines()
    (at,) = [i for i, line in enumerate(lines) if line.startswith("Navigation")]
    assert "Bound: Cramér-Rao bound" in " ".join(" ".join(lines[at + 1 : at + 4]).split())
