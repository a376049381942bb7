"""The commands for pictures: the vision unit, its calibration, the docking monitor."""

from __future__ import annotations

from typing import Annotated, Literal

from cyclopts import App, Parameter

from hil.cli.options import Output, Settings, Whole

_Flag = Annotated[bool, Parameter(negative=())]


def add_vision_commands(app: App) -> None:
    """Make the commands known to ``app``."""
    for command in (vmu, calibrate, monitor):
        app.command(command)


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
    fast: _Flag = False,
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
    moved: _Flag = False,
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
    target: Literal["basic", "backup", "reserve"] = "basic",
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
        The scene's basic or its backup target.
    calculation
        The exact projection, or the paper's relations for small angles.
    motion
        The paper's portions as mended, or as printed.
    q
        Weight of the portion before, 0 to 1.
    """
    from hil.cli.monitor import monitor_command

    assert out is not None
    which: Literal["basic", "backup"] = "basic" if target == "basic" else "backup"
    return monitor_command(video, scene, out, screen, json, roi, which, calculation, motion, q, frames)
