"""The commands for what was recorded: runs, replay, recover, export, report."""

from __future__ import annotations

from typing import Annotated, Literal

from cyclopts import App, Parameter

from hil.cli.options import Output, Settings

_Flag = Annotated[bool, Parameter(negative=())]


def add_recording_commands(app: App) -> None:
    """Make the commands known to ``app``."""
    for command in (runs, replay, recover, export, report):
        app.command(command)


def runs(
    folder: Annotated[str | None, Parameter(name=("--record", "--folder"))] = None,
    *,
    failed: _Flag = False,
    passed: _Flag = False,
    scenario: str | None = None,
    since: str | None = None,
    json: Output = None,
) -> int:
    """List recorded runs: the catalogue of a folder given to hil run --record.

    Parameters
    ----------
    folder
        With the catalogue; left away: the folder "recordings" here, or else this folder.
    failed
        Only runs without a pass: verdict fail, safe-stopped, broken off.
    passed
        Only runs that passed.
    scenario
        Only runs of the scenario of this name.
    since
        Only runs begun then or later: 2026-11-01, or 2026-11-01T14:30, UTC.
    json
        File to write the entries to, - for standard output.
    """
    from hil.cli.runs import runs_command

    return runs_command(folder, failed, passed, scenario, since, json)


def replay(
    recording: str,
    /,
    *,
    gnc: str | None = None,
    settings: Settings = (),
    vmu: _Flag = False,
    geometry: str | None = None,
    monitor: _Flag = False,
    scene: str | None = None,
    json: Output = None,
) -> int:
    """Feed recorded inputs through today's GNC and compare with what was recorded, bit by bit.

    With --vmu or --monitor: recorded pictures through today's vision unit or docking monitor instead.

    Exit code 0: identical, or other settings were asked for; 1: differs though nothing was changed.

    Parameters
    ----------
    recording
        File that hil run --record wrote.
    gnc
        TOML file with other [gnc...] tables, or a scenario whose GNC is to be taken.
    vmu
        Find the poses of the recorded stereo pairs again.
    geometry
        With --vmu: geometry file (hil calibrate) instead of the recorded one.
    monitor
        Find the docking monitor's numbers of its recorded frames again.
    scene
        With --monitor: scene, shipped or a file, instead of the recorded one.
    json
        File to write what differs to, - for standard output.
    """
    if vmu or monitor or geometry is not None or scene is not None:
        from hil.cli.replay_images import replay_pictures_command

        other_gnc = "--gnc" if gnc is not None else "--set" if settings else None
        return replay_pictures_command(recording, vmu, geometry, monitor, scene, other_gnc, json)
    from hil.cli.replay import replay_command

    return replay_command(recording, gnc, settings, json)


def recover(recording: str, /, *, out: Annotated[str | None, Parameter(name=("--out", "-o"))] = None) -> int:
    """Make a recording that broke off whole again; the file itself stays as it is.

    Parameters
    ----------
    recording
        File whose recorder was killed, or whose disk was full.
    out
        File to write; left away: NAME.recovered.mcap beside it.
    """
    from hil.cli.recover import recover_command

    return recover_command(recording, out)


def export(
    recording: str,
    /,
    *,
    form: Annotated[Literal["parquet", "csv"], Parameter(name="--format")] = "csv",
    out: Annotated[str | None, Parameter(name=("--out", "-o"))] = None,
    pictures: str | None = None,
) -> int:
    """Write the numbers of a recording as Parquet or CSV, one row a cycle; frames and log go beside it.

    With --pictures: its pictures instead, in folders that hil vmu and hil monitor take.

    Parameters
    ----------
    recording
        File that hil run --record wrote, of any version.
    form
        parquet needs the extra of that name: pip install 'hil-bench[parquet]'.
    out
        File to write; left away: the recording's name with the format's ending.
    pictures
        Folder to write the pictures to, with their times and what the cameras were taken for.
    """
    from hil.cli.export import export_command, export_pictures_command

    if pictures is not None:
        return export_pictures_command(recording, pictures, out)
    return export_command(recording, form, out)


def report(
    recordings: Annotated[list[str], Parameter(negative=())],
    /,
    *,
    out: Annotated[str, Parameter(name=("--out", "-o"))],
) -> int:
    """Write one page (HTML, nothing loaded from elsewhere) about a run, or that compares several.

    Parameters
    ----------
    recordings
        Files that hil run --record wrote.
    out
        File to write, *.html.
    """
    from hil.cli.report import report_command

    return report_command(recordings, out)
