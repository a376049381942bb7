"""The commands for a loop in two processes: dss and gnc."""

from __future__ import annotations

from typing import Annotated

from cyclopts import App, Parameter

from hil.cli.options import Output, Settings, Whole


def add_two_computer_commands(app: App) -> None:
    """Make the commands known to ``app``."""
    for command in (dss, gnc):
        app.command(command)


def dss(
    scenario: str,
    /,
    *,
    rig: str = "mock",
    seed: Whole = 0,
    duration: float | None = None,
    settings: Settings = (),
    speed: float = 1.0,
    listen: str | None = None,
    gnc: str | None = None,
    lock_step: Annotated[bool, Parameter(negative=())] = False,
    wait: float = 60.0,
    json: Output = None,
    record: str | None = None,
) -> int:
    """Run the bench, with dynamics and vision unit, for a GNC in another process or on another computer.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file.
    rig
        mock, emulated, or the path of a rig file; gnc_link in it says what is done when answers fail.
    seed
        Of all random numbers.
    duration
        Seconds to run, instead of the scenario's.
    speed
        Bench seconds a wall second, on an emulated rig or a mock rig that runs free.
    listen
        Address and port where a GNC is waited for; 127.0.0.1:24500 unless --gnc is given.
    gnc
        Address and port of the GNC, the only one that is spoken with; instead of --listen.
    lock_step
        Each cycle waits for its answer; on a mock rig the trajectory is that of hil run.
    wait
        Wall seconds that a GNC is waited for.
    json
        File to write the numbers of the run to, - for standard output.
    record
        Folder to record the run in, with its catalogue; see hil runs.
    """
    from hil.cli.two_computers import dss_command

    return dss_command(scenario, rig, seed, duration, settings, speed, listen, gnc, lock_step, wait, json, record)


def gnc(
    scenario: str,
    /,
    *,
    dss: str | None = None,
    listen: str | None = None,
    settings: Settings = (),
    wait: float = 60.0,
    json: Output = None,
) -> int:
    """Run the GNC of a scenario for a bench in another process or on another computer, until that says goodbye.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file.
    dss
        Address and port of the bench; 127.0.0.1:24500 unless --listen is given.
    listen
        Address and port where a bench is waited for (hil dss --gnc), instead of --dss.
    wait
        Wall seconds that a bench is waited for, at first and when it has fallen silent.
    json
        File to write the numbers of the GNC to, - for standard output.
    """
    from hil.cli.two_computers import gnc_command

    return gnc_command(scenario, dss, listen, settings, wait, json)
