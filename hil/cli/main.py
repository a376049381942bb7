"""``hil``: one command line for everything. Exit codes: 0 done and passed, 1 done but the verdict is
fail, 2 bad input, 3 safe-stopped by a fault or by the operator, 4 a defect of this program."""

from __future__ import annotations

import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Annotated, Any, Literal

import cyclopts
from cyclopts import App, Parameter

from hil import __version__
from hil.cli.gnc_commands import add_gnc_commands
from hil.cli.options import MaybeWhole, Output, Settings, Whole
from hil.cli.recording_commands import add_recording_commands
from hil.cli.two_computer_commands import add_two_computer_commands
from hil.cli.vision_commands import add_vision_commands
from hil.errors import BadInput, BenchError, CampaignStopped, RenamedKey

PASSED, FAILED, BAD_INPUT, SAFE_STOPPED, DEFECT = range(5)

app = App(
    name="hil",
    help="Hardware-in-the-loop bench controller for spacecraft rendezvous and docking.",
    version=__version__,
    suppress_keyboard_interrupt=False,  # Ctrl-C has the exit code of a safe stop
)


@app.command
def run(
    scenario: str,
    /,
    *,
    rig: str = "mock",
    seed: Whole = 0,
    case: MaybeWhole = None,
    duration: float | None = None,
    settings: Settings = (),
    speed: float = 1.0,
    record: str | None = None,
    json: Output = None,
) -> int:
    """Run one closed loop and print its verdict.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file.
    rig
        mock, emulated, or the path of a rig file.
    seed
        Of all random numbers: the same seed gives the same run on the mock rig.
    case
        Number of a case of the campaign of this scenario and seed, to be run in full detail.
    duration
        Seconds to run, instead of the scenario's.
    speed
        Bench seconds a wall second, on an emulated rig.
    record
        Folder to record the run in, with its catalogue; see hil runs.
    json
        File to write the numbers of the run to, - for standard output.
    """
    from hil.cli.run import run_command

    return run_command(scenario, rig, seed, case, duration, settings, speed, json, record)


@app.command
def fusion(
    *,
    vmu_noise: Literal["swapped", "printed"] = "swapped",
    runs: Whole = 100,
    seed: Whole = 0,
    settings: Settings = (),
    workers: Whole = 0,
    json: Output = None,
    figure: str | None = None,
) -> int:
    """Simulate the fusion filters over many runs (bench paper IV.A): errors, bound, ratio, NEES.

    Parameters
    ----------
    vmu_noise
        Table I's rows of the vision unit as the text needs them (swapped) or as printed.
    runs
        How many, each with its own noise and initial errors.
    seed
        Of all random numbers, whatever the number of workers.
    workers
        Processes; 0 takes one a core.
    json
        File to write the numbers to, - for standard output.
    figure
        Picture of one run's errors with their 3-sigma band, as the paper's Fig. 5 (PNG, PDF or SVG).
    """
    from hil.cli.fusion import fusion_command

    return fusion_command(vmu_noise, runs, seed, settings, workers, json, figure)


@app.command
def campaign(
    scenario: str,
    /,
    *,
    runs: Whole,
    out: Output,
    seed: Whole = 0,
    workers: Whole = 0,
    scheduler: str | None = None,
    against: str | None = None,
    sweep: str | None = None,
    duration: float | None = None,
    settings: Settings = (),
    json: Output = None,
) -> int:
    """Fly many cases of a scenario with its dispersions, on the mock rig: pass rates, worst cases, what they hang on.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file; what is dispersed stands in [dispersions].
    runs
        Cases, numbered from 0. A case depends on its number and the seed alone.
    out
        Folder for the results; one that holds a part of this campaign is gone on with.
    seed
        Of the whole campaign.
    workers
        Processes of this computer; 0 takes one a core.
    scheduler
        Address of a Dask scheduler, tcp://host:8786, whose workers fly instead.
    against
        A second scenario, flown with the same seeds: differences with intervals.
    sweep
        key=low:high:n, as gnc.control.deadband_m=0.002:0.02:10: the campaign once for each value.
    duration
        Seconds a run, instead of the scenario's.
    json
        File to write the summary to, - for standard output.
    """
    from hil.cli.campaign import campaign_command

    return campaign_command(
        scenario, runs, seed, workers, scheduler, out or "", against, sweep, duration, settings, json
    )


@app.command
def emulate(rig: str = "emulated", *, scenario: str = "scheme-1", settings: Settings = (), speed: float = 1.0) -> int:
    """Start the emulated devices of a rig, say where each one listens, and stay until Ctrl-C.

    Parameters
    ----------
    rig
        emulated, or the path of a rig file.
    scenario
        Gives the noise of the emulated vision unit.
    speed
        Bench seconds a wall second.
    """
    from hil.cli.emulate import emulate_command

    return emulate_command(rig, scenario, settings, speed)


@app.command
def preflight(
    *,
    rig: str = "mock",
    scenario: str = "scheme-1",
    settings: Settings = (),
    json: Output = None,
    devices: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Check whether this host and a rig can run in real time and reach a scenario; exit code 0 or 1.

    Parameters
    ----------
    rig
        mock, emulated, or the path of a rig file.
    scenario
        Gives the rate and the plan that the rig has to follow.
    json
        File to write what was found to, - for standard output.
    devices
        Also open rails and turntable of a hardware rig: their drives are enabled and hold where they stand.
    """
    from hil.cli.preflight import preflight_command

    return preflight_command(rig, scenario, settings, json, devices)


@app.command
def identify(
    rig: str = "emulated",
    *,
    axis: Annotated[tuple[str, ...], Parameter(negative=())] = (),
    out: Output = None,
    json: Output = None,
    yes: Annotated[bool, Parameter(negative=())] = False,
    scenario: str = "scheme-1",
    settings: Settings = (),
    speed: float = 1.0,
) -> int:
    """Move one axis at a time, a few millimetres or tenths of a degree, and measure its delay and bandwidth.

    Parameters
    ----------
    rig
        mock, emulated, or the path of a rig file.
    axis
        rails.x, turntable.yaw ...; may be given more than once. Without it all six, one after the other.
    out
        Rig file (*.toml) to write: it extends this rig by the leads that make up for the delays.
    json
        File to write the numbers to, - for standard output.
    yes
        The bench is clear: needed for a rig of hardware.
    scenario
        Gives its step, which is the cycle of the bench, and where a mock rig stands.
    speed
        Bench seconds a wall second, on an emulated rig.
    """
    from hil.cli.identify import identify_command

    return identify_command(rig, axis, out, json, yes, scenario, settings, speed)


@app.command
def commission(
    rig: str = "emulated",
    *,
    axis: Annotated[tuple[str, ...], Parameter(negative=())] = (),
    out: Output = None,
    by: str | None = None,
    date: str | None = None,
    limits: Annotated[bool, Parameter(negative=())] = False,
    yes: Annotated[bool, Parameter(negative=())] = False,
    scenario: str = "scheme-1",
    settings: Settings = (),
    speed: float = 1.0,
) -> int:
    """Take a rig from its emergency stop, one axis at a time, to a slow dry run, and sign it off.

    Parameters
    ----------
    rig
        emulated, or the path of a rig file.
    axis
        rails.x, turntable.yaw ...; may be given more than once. Without it all six, one after the other.
    out
        Rig file (*.toml) to write: it extends this rig by the sign-off that a run on hardware needs.
    by
        Who looks at the bench; asked for where it is left away.
    date
        Of the sign-off, 2026-03-01; today where it is left away.
    limits
        Also approach both ends of each axis' travel.
    yes
        Answer every question with yes: for emulated rigs alone.
    scenario
        Gives the cycle of the bench and the start pose of the dry run.
    speed
        Bench seconds a wall second, on an emulated rig.
    """
    from hil.cli.commission import commission_command

    return commission_command(rig, axis, out, by, date, limits, yes, scenario, settings, speed)


@app.command
def console(
    *,
    host: str = "127.0.0.1",
    port: Whole = 8765,
    token_file: str | None = None,
    rig: str = "emulated",
    scenario: str = "scheme-1",
    seed: Whole = 0,
    duration: float | None = None,
    settings: Settings = (),
    speed: float = 1.0,
    on_loss: Literal["hold", "continue", "stop"] | None = None,
    record: str = "recordings",
    no_record: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Serve the page from which a session at the bench is seen and commanded, until Ctrl-C.

    Parameters
    ----------
    host
        Address to listen on. Any but this computer's own needs a token.
    port
        0 takes any that is free.
    token_file
        File with the token that a page must know, readable by its owner alone.
    rig
        mock, emulated, or the path of a rig file: what is offered first.
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file: what is offered first.
    seed
        Of all random numbers.
    duration
        Seconds to run, instead of the scenario's.
    speed
        Bench seconds a wall second, on a mock or emulated rig.
    on_loss
        What the loop does when the operator's page is lost while the bench moves, instead of the rig's console.on_loss.
    record
        Folder to record each session into, one file a session, and to enter it into the catalogue there.
    no_record
        Record nothing.
    """
    from hil.cli.console import console_command

    folder = None if no_record else record
    return console_command(host, port, token_file, rig, scenario, seed, duration, speed, settings, on_loss, folder)


add_gnc_commands(app)
add_vision_commands(app)
add_recording_commands(app)
add_two_computer_commands(app)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    # also where a shell started this with Ctrl-C ignored: a bench must always be stoppable
    signal.signal(signal.SIGINT, _as_ctrl_c)
    signal.signal(signal.SIGTERM, _as_ctrl_c)
    code = execute(sys.argv[1:] if arguments is None else arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    # everything is closed by now; the interpreter's own way out takes longer than stopping the bench
    os._exit(code)


def execute(arguments: Sequence[str]) -> int:
    """Run one command; return its exit code. Errors go to standard error, a line each."""
    try:
        with _renamed_keys_on_stderr():
            result = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
    except BadInput as error:
        return _say(str(error), BAD_INPUT)
    except cyclopts.CycloptsError as error:
        return _say(" ".join(str(error).split()), BAD_INPUT)
    except (BenchError, CampaignStopped) as error:
        return _say(str(error), SAFE_STOPPED)
    except KeyboardInterrupt:
        return _say("stopped by the operator", SAFE_STOPPED)
    except Exception:
        traceback.print_exc()
        return _say("this is a defect of hil: please report it with the lines above", DEFECT)
    return result if isinstance(result, int) else PASSED


@contextmanager
def _renamed_keys_on_stderr() -> Iterator[None]:
    """Print each warning of a renamed key once, as one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("default", RenamedKey)
        otherwise: Callable[..., None] = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, RenamedKey):
                print(message, file=sys.stderr)  # noqa: T201
            else:
                otherwise(message, category, *place, **more)

        setattr(warnings, "showwarning", show)  # noqa: B010 (restored by catch_warnings)
        yield


def _say(text: str, code: int) -> int:
    print(text, file=sys.stderr)  # noqa: T201
    return code


def _as_ctrl_c(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
