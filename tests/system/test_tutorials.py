"""The tutorials are executed as they stand: files are saved, commands run, outputs found in what is printed."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from hil.cli.main import execute

TUTORIALS = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)

pytestmark = pytest.mark.xdist_group("campaign")


def words_of(line: str) -> list[str]:
    """Return the words of a command, with the name of the one recording for RUN."""
    command = line.split(" # ")[0]
    if "RUN.mcap" in command:
        (recording,) = Path("recordings").glob("*.mcap")
        command = command.replace("recordings/RUN.mcap", str(recording))
    return shlex.split(command)


def run_commands(block: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Run the commands of ``block``; return what they print."""
    printed = ""
    for line in block.splitlines():
        program, *arguments = words_of(line)
        assert program == "hil", line
        stated = re.search(r"# exit code (\d)(?: or (\d))?", line)
        allowed = {int(code) for code in stated.groups() if code} if stated else {0}
        assert execute(arguments) in allowed, line
        captured = capsys.readouterr()
        printed += captured.out + captured.err
    return printed


def is_printed(line: str, printed: str) -> bool:
    """Return whether ``line`` is among the lines of ``printed``; ``...`` stands for any text."""
    pattern = ".*".join(re.escape(part.strip()) for part in line.split("..."))
    return re.search(rf"^\s*{pattern}\s*$", printed, re.MULTILINE) is not None


@pytest.mark.parametrize(
    "page",
    ["first-measurement", "first-law", "reading-a-recording", pytest.param("first-rig", marks=pytest.mark.slow)],
)
def test_tutorial_works_as_written(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")
    names: dict[str, object] = {}
    printed, commands = "", 0
    for language, block in _BLOCK.findall((TUTORIALS / f"{page}.md").read_text(encoding="utf-8")):
        saved = re.match(r"# ([\w.-]+\.(?:py|toml))\n", block)
        if saved is not None:
            Path(saved[1]).write_text(block, encoding="utf-8")
        elif language == "sh":
            printed = run_commands(block, capsys)
            commands += 1
        elif language == "python":
            exec(compile(block, f"{page}.md", "exec"), names)
        elif language == "":
            missing = [line for line in block.splitlines() if line.strip() != "..." and not is_printed(line, printed)]
            assert not missing, printed
    assert commands >= 4
