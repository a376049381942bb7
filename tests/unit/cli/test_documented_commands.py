"""Commands in the documentation have names and options that the command line accepts."""

import re
import shlex
from pathlib import Path

import pytest

from hil.cli.main import app

ROOT = Path(__file__).resolve().parents[3]
PAGES = [
    ROOT / "README.md",
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if "generated" not in page.parts),
]


def commands(page: Path) -> list[str]:
    """Return the ``hil`` commands in the code blocks of ``page``, without prompt, comment and redirection."""
    blocks = re.findall(r"^```(?:sh)?\n(.*?)^```", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    found = [re.match(r"(?:[\w$-]*\$ +)?hil (?P<command>[^#&]+)", line) for line in lines]
    return [match["command"].strip() for match in found if match]


@pytest.mark.parametrize(
    "command", [pytest.param(command, id=f"{page.stem}: {command}") for page in PAGES for command in commands(page)]
)
def test_documented_command_is_accepted(command: str) -> None:
    words = shlex.split(re.sub(r"\[(--.*?)\]", r"\1", command))
    app.parse_args(words, exit_on_error=False, print_error=False)
