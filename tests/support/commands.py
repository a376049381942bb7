"""Commands of ``hil`` in one process of their own, which has other packages installed than this one.

    python -m tests.support.commands '[["list", "parts"]]'

prints a JSON list with exit code, standard output and error of each.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[2]


class Done(NamedTuple):
    """Outcome of a command."""

    code: int
    out: str
    err: str


def run(site: Path, commands: Sequence[Sequence[str | Path]]) -> list[Done]:
    """Return the outcomes of ``commands`` with the packages in the folder ``site`` installed."""
    command = [sys.executable, "-m", "tests.support.commands", json.dumps(commands, default=str)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(site), *sys.path, str(ROOT)))}
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return [Done(*each) for each in json.loads(done.stdout)]


def main() -> None:
    """Execute the commands of the first argument. Pages have no figures, which take longer than short flights."""
    import hil.report.page as page
    from hil.cli.main import execute
    from hil.core.surroundings import leave_process
    from tests.support.run_settings import without_figures

    page.figures = lambda *_: iter(())  # type: ignore[assignment]

    outcomes = []
    for command in json.loads(sys.argv[1]):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), without_figures():
            code = execute(command)
        outcomes.append((code, out.getvalue(), err.getvalue()))
    print(json.dumps(outcomes), flush=True)  # noqa: T201
    leave_process(0)  # workers of a campaign stay as long as their parent


if __name__ == "__main__":
    main()
