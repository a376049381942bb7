"""``hil``: one command line for everything. Exit codes: 0 done and passed, 1 done but the verdict is
fail, 2 bad input, 3 safe-stopped by a fault or by the operator, 4 a defect of this program."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Sequence
from types import FrameType
from typing import Annotated, Literal

import cyclopts
from cyclopts import App, Parameter

from hil import __version__
from hil.errors import BadInput, BenchError

PASSED, FAILED, BAD_INPUT, SAFE_STOPPED, DEFECT = range(5)

app = App(
    name="hil",
    help="Hardware-in-the-loop bench controller for spacecraft rendezvous and docking.",
    version=__version__,
    suppress_keyboard_interrupt=False,  # Ctrl-C has the exit code of a safe stop
)

Settings = Annotated[
    tuple[str, ...],
    Parameter(name="--set", negative=(), help="Override a key: gnc.control.deadband_m=0.004 or rig.vmu.timeout_s=0.5."),
]


def _whole_number(_type: object, tokens: Sequence[cyclopts.Token]) -> int:
    """Return a whole number; cyclopts by itself would cut 1.5 to 1."""
    return int(tokens[0].value)


Whole = Annotated[int, Parameter(converter=_whole_number)]
Output = Annotated[str | None, Parameter(allow_leading_hyphen=True)]


@app.command
def run(
    scenario: str,
    /,
    *,
    rig: str = "mock",
    seed: Whole = 0,
    duration: float | None = None,
    settings: Settings = (),
    speed: float = 1.0,
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
    duration
        Seconds to run, instead of the scenario's.
    speed
        Bench seconds a wall second, on an emulated rig.
    json
        File to write the numbers of the run to, - for standard output.
    """
    from hil.cli.run import run_command

    return run_command(scenario, rig, seed, duration, settings, speed, json)


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
def monitor(
    video: str,
    /,
    *,
    scene: str,
    out: Output,
    screen: Output = None,
    json: Output = None,
    frames: Output = None,
    roi: str | None = None,
    target: Literal["basic", "reserve"] = "basic",
    calculation: Literal["exact", "paper"] = "exact",
    motion: Literal["corrected", "printed"] = "corrected",
    q: float = 0.5,
) -> int:
    """Watch an approach on a video: range, rate and angles, each with its standard deviation.

    Parameters
    ----------
    video
        Video file, folder of images, or the number of a camera.
    scene
        Camera and target: atv, bright-cross, or the path of a scene file (JSON or TOML).
    out
        CSV file to write, a row a portion of 10 frames, - for standard output.
    screen
        Video (.mp4, .mkv, .avi) or picture (.png) of the operator's screen.
    json
        File to write a summary to, - for standard output.
    frames
        CSV file with a row a frame: used or not, why not, and its own pose.
    roi
        Where to look first: u,v,width,height in px.
    target
        The scene's basic or its reserve target.
    calculation
        The exact projection, or the paper's relations for small angles.
    motion
        The paper's portions as mended, or as printed.
    q
        Weight of the portion before, 0 to 1.
    """
    from hil.cli.monitor import monitor_command

    assert out is not None
    return monitor_command(video, scene, out, screen, json, roi, target, calculation, motion, q, frames)


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
def vmu(
    folder: str,
    /,
    *,
    geometry: str,
    out: str,
    rate_hz: float = 6.25,
    overlay: Output = None,
    start_frame: Whole | None = None,
    start_pose: Annotated[tuple[float, float, float, float, float, float] | None, Parameter(negative=())] = None,
    json: Output = None,
    rs422: str | None = None,
    baud: int = 460_800,
    fast: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Turn LED images (left/NNNN.png, right/NNNN.png) into poses with status and sigma, a row a frame.

    Parameters
    ----------
    folder
        Holds the folders left and right; or two videos, left.mkv,right.mkv; or two cameras, camera:0,1.
    geometry
        File of LED layout and cameras, JSON or TOML (docs/vmu.md).
    out
        CSV to write.
    rate_hz
        Frames a second: the time of a frame is its number over this.
    overlay
        Folder to write a picture a frame to: spots, identities, reprojected LEDs, pose.
    start_frame
        The first frame to look at.
    start_pose
        Where the target is at first, x y z in m and rotation vector in deg: tells symmetric LEDs apart.
    json
        File to write the counts to, - for standard output.
    rs422
        Serial port to send each frame's pose to, as the vision unit does: a frame when its time has come.
    baud
        Of that port.
    fast
        Send each frame as soon as it is solved.
    """
    from hil.cli.vmu import vmu_command

    return vmu_command(folder, geometry, out, rate_hz, overlay, start_frame, start_pose, json, rs422, baud, fast)


@app.command
def calibrate(
    views: str,
    /,
    *,
    check: str | None = None,
    board: str | None = None,
    square_mm: float | None = None,
    rig: str = "mock",
    geometry: str | None = None,
    keep: Annotated[tuple[str, ...], Parameter(negative=())] = (),
    moved: Annotated[bool, Parameter(negative=())] = False,
    out: Output = None,
    rig_out: Output = None,
    json: Output = None,
    figure: str | None = None,
    id: str | None = None,
    date: str | None = None,
    rail_sigma_mm: float = 0.05,
    gimbal_sigma_deg: float = 0.005,
    led_sigma_mm: float = 1.0,
    square_sigma_percent: float = 0.1,
    max_rms_px: float = 0.3,
    max_error_mm: float = 2.0,
    range_m: float = 2.0,
    max_mounting_mm: float = 1.0,
    max_mounting_deg: float = 0.05,
    max_square_percent: float = 0.3,
    max_drift_px: float = 0.03,
    alarm: float = 1e-3,
    settings: Settings = (),
) -> int:
    """Calibrate the vision unit from views at known places of the bench, or check a calibration of an earlier day.

    Parameters
    ----------
    views
        Folder with views.csv and the images (docs/calibration.md), or the path of such a CSV file.
    check
        Geometry file that hil calibrate wrote: has anything moved since? Takes a few views.
    board
        The target is a chessboard with so many inner corners, 11x8; without it the LEDs are.
    square_mm
        Side of a square of the board.
    rig
        mock, emulated, or the path of a rig file: lever arm, gimbals, and mounting and LEDs on paper.
    geometry
        Cameras and LEDs to begin with, instead of the rig file's.
    keep
        left, right, stereo, mounting or leds: held as the files have it; may be given more than once.
    moved
        With --check: the LED ring was taken off and put back since.
    out
        Geometry file (*.toml) to write.
    rig_out
        Rig file (*.toml) to write: it extends this rig by the mounting that was found.
    json
        File to write the numbers to, - for standard output.
    figure
        Picture of residuals, views and millimetres over range (PNG, PDF or SVG).
    id
        Name of the calibration.
    date
        Of the calibration, 2026-03-01; today where it is left away.
    rail_sigma_mm
        How far a rail may be off its encoder, 1 sigma.
    gimbal_sigma_deg
        How far a gimbal may be off its encoder, 1 sigma.
    led_sigma_mm
        How far the LEDs may be off their places on paper, 1 sigma.
    square_sigma_percent
        How far the squares may be off their told size, 1 sigma.
    max_rms_px
        Limit of the residuals, RMS.
    max_error_mm
        Limit of what the calibration leaves uncertain of a point's place at --range-m, 1 sigma.
    range_m
        Working range that is judged.
    max_mounting_mm
        Limit of the standard deviation of the camera's station.
    max_mounting_deg
        Limit of the standard deviation of the camera's axes.
    max_square_percent
        Limit of the difference between the board's told size and the one that the rails say.
    max_drift_px
        With --check: a drift below this is let pass, RMS over all pixels.
    alarm
        With --check: a drift is one when chance alone would make it look so less often than this.
    """
    from hil.cli.calibrate import Options, calibrate_command

    chosen = Options(
        views=views,
        check=check,
        board=board,
        square_mm=square_mm,
        rig=rig,
        geometry=geometry,
        keep=keep,
        moved=moved,
        out=out,
        rig_out=rig_out,
        json=json,
        figure=figure,
        id=id,
        date=date,
        rail_sigma_mm=rail_sigma_mm,
        gimbal_sigma_deg=gimbal_sigma_deg,
        led_sigma_mm=led_sigma_mm,
        square_sigma_percent=square_sigma_percent,
        max_rms_px=max_rms_px,
        max_error_mm=max_error_mm,
        range_m=range_m,
        max_mounting_mm=max_mounting_mm,
        max_mounting_deg=max_mounting_deg,
        max_square_percent=max_square_percent,
        max_drift_px=max_drift_px,
        alarm=alarm,
        settings=settings,
    )
    return calibrate_command(chosen)


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
        result = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
    except BadInput as error:
        return _say(str(error), BAD_INPUT)
    except cyclopts.CycloptsError as error:
        return _say(" ".join(str(error).split()), BAD_INPUT)
    except BenchError as error:
        return _say(str(error), SAFE_STOPPED)
    except KeyboardInterrupt:
        return _say("stopped by the operator", SAFE_STOPPED)
    except Exception:
        traceback.print_exc()
        return _say("this is a defect of hil: please report it with the lines above", DEFECT)
    return result if isinstance(result, int) else PASSED


def _say(text: str, code: int) -> int:
    print(text, file=sys.stderr)  # noqa: T201
    return code


def _as_ctrl_c(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
