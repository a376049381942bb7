"""The commands for a GNC of the user's own: gnc-header and gnc-check."""

from __future__ import annotations

import sys
from typing import Annotated

from cyclopts import App, Parameter

from hil.cli.options import Output, Settings


def add_gnc_commands(app: App) -> None:
    """Make the commands known to ``app``."""
    for command in (gnc_header, gnc_check):
        app.command(command)


def gnc_header(*, folder: Annotated[bool, Parameter(negative=())] = False) -> int:
    """Print hil_gnc.h, the C header of what passes between the bench and a GNC of your own.

    Parameters
    ----------
    folder
        Print the folder that it stands in, for -I of a C compiler.
    """
    from hil.gnc_backends.c_header import HEADER_FILE

    sys.stdout.write(f"{HEADER_FILE.parent}\n" if folder else HEADER_FILE.read_text(encoding="utf-8"))
    return 0


def gnc_check(
    gnc: str,
    /,
    *,
    scenario: str = "scheme-1",
    dial: Annotated[bool, Parameter(negative=())] = False,
    wait: float = 60.0,
    settings: Settings = (),
    json: Output = None,
) -> int:
    """Play a known sequence to a GNC of your own; say what is wrong with time, signs and units of its answers.

    Parameters
    ----------
    gnc
        A shared library (*.so), or HOST:PORT of this computer where a GNC that says hello is waited for.
    scenario
        Gives vehicle, step and Table III.
    dial
        HOST:PORT is where the GNC waits: it is spoken to first.
    wait
        Wall seconds that a GNC is waited for.
    json
        File to write what was found to, - for standard output.
    """
    from hil.cli.gnc_check import gnc_check_command

    return gnc_check_command(gnc, scenario, dial, wait, settings, json)
