"""``hil calibrate``: cameras, stereo, mounting and LED layout from views at known bench positions; drift check."""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from cyclopts import Parameter
from rich.console import Console

from hil.cli.options import (
    Check,
    Figure,
    File,
    Flag,
    Group,
    Integer,
    Names,
    Positive,
    Settings,
    TomlFile,
    bounded,
    refuse,
    refuse_wires_in_use,
)
from hil.cli.output import base_of, deliver, notices, say, write_json
from hil.cli.progress import ProgressBar
from hil.core.files import write_text
from hil.errors import BadInput, Problem

if TYPE_CHECKING:
    from hil.config.camera_identity import CameraIdentity
    from hil.vmu.calibration.board import Board
    from hil.vmu.calibration.single_camera import CameraFit

Kind = Literal["opencv", "kalibr", "ros"]
Side = Literal["left", "right"]
_PASSED, _FAILED = 0, 1
_LEAST_SQUARE_MM, _LARGEST_SQUARE_MM = 1.0, 1000.0
_PARTS: Final = ("left", "right", "stereo", "mounting", "leds")


def _parts_problem(parts: tuple[str, ...]) -> str:
    unknown = [part for part in parts if part not in _PARTS]
    return f"{unknown[0]}: unknown, give {', '.join(_PARTS)}" if unknown else ""


def _date_problem(text: str) -> str:
    try:
        datetime.date.fromisoformat(text)
    except ValueError:
        return f"{text}: must be a date like 2026-03-01"
    return ""


Parts = Annotated[Names, Check(_parts_problem)]


@dataclass(frozen=True)
class BoardOptions:
    """Options of a board."""

    board: str | None = None
    """Inner corners of the chessboard that is the target, 11x8; with --marker-mm the squares of a ChArUco board;
    default: the LEDs."""
    square_mm: Positive | None = None
    """Side of a square of the board."""
    marker_mm: Positive | None = None
    """Side of a marker: the board is a ChArUco board, which need not be completely visible."""
    dictionary: str = "4X4_50"
    """With --marker-mm: dictionary of the markers, in OpenCV's notation."""


_BOARD = BoardOptions()


@dataclass(frozen=True)
class InitialGuessOptions:
    """Options of target and initial values."""

    target: Group[BoardOptions] = _BOARD
    """Board that is the target."""
    rig: str = "mock"
    """mock, emulated, or the path of a rig file: lever arm, gimbals, nominal mounting and LEDs."""
    geometry: str | None = None
    """Initial cameras and LEDs, instead of the rig file's."""
    keep: Parts = ()
    """left, right, stereo, mounting or leds: held at its initial value; may be given more than once."""
    hand_held: Flag = False
    """VIEWS has pairs of a board held by hand, without a bench: cameras and their relative pose alone. Without --board
    pairs of the LED ring, moved by hand: its layout by the cameras of --geometry."""
    camera: Side | None = None
    """VIEWS has images of this camera alone, of a board held by hand: left or right of --geometry or --rig."""
    scene: str | None = None
    """Calibrate the camera of this scene of the docking monitor instead, from images of a board in the folder VIEWS."""

    source: Annotated[Kind | None, Parameter(name="--from")] = None
    """VIEWS is a calibration of opencv (YAML of stereoCalibrate), kalibr (camchain) or ros (camera_info, LEFT,RIGHT):
    write its cameras as the geometry file --out, with the LEDs of --geometry or --rig."""
    to: Kind | None = None
    """VIEWS is a geometry file: write its cameras for opencv, kalibr or ros next to it."""

    def problems(self) -> list[Problem]:
        """Return a problem for each option that cannot be used."""
        return _board_problems(self.target)

    def board_missing(self, option: str) -> list[Problem]:
        """Return a problem if ``option``, which needs a board, is given without one."""
        return [] if self.target.board is not None else [Problem(option, "", "needs --board and --square-mm")]


@dataclass(frozen=True)
class ResultOptions:
    """Options of the results."""

    out: TomlFile = None
    """Geometry file (*.toml) to write."""
    rig_out: TomlFile = None
    """Rig file (*.toml) to write: it extends this rig by the measured mounting."""
    scene_out: TomlFile = None
    """Scene file (*.toml) to write: it extends --scene by the measured camera."""
    json: File = None
    """File for the numbers, - for standard output."""
    figure: Figure = None
    """Figure of residuals, views and errors in millimetres over range (PNG, PDF or SVG)."""
    id: str | None = None
    """Name of the calibration."""
    date: Annotated[str | None, Check(_date_problem)] = None
    """Date of the calibration, 2026-03-01; default: today."""


@dataclass(frozen=True)
class BenchSigmas:
    """Standard deviations of the bench and the target."""

    rail_sigma_mm: Positive = 0.05
    """Standard deviation of a rail's position error against its encoder."""
    gimbal_sigma_deg: Positive = 0.005
    """Standard deviation of a gimbal's error against its encoder."""
    led_sigma_mm: Positive = 1.0
    """Standard deviation of the LEDs' nominal positions."""
    square_sigma_percent: Positive = 0.1
    """Standard deviation of the nominal square size."""


@dataclass(frozen=True)
class LimitOptions:
    """Limits of a calibration."""

    max_rms_px: Positive = 0.15
    """Limit of the residuals, RMS: with larger ones the vision unit loses the tilt of a distant ring."""
    max_error_mm: Positive | None = None
    """Limit of a point's position uncertainty from the calibration at --range-m, 1 sigma; default: 2, or the depth of
    --max-rms-px of disparity if larger."""
    range_m: Positive = 2.0
    """Working range at which the errors are assessed."""
    max_mounting_mm: Positive = 1.0
    """Limit of the standard deviation of the camera's position."""
    max_mounting_deg: Positive = 0.05
    """Limit of the standard deviation of the camera's axes."""
    max_square_percent: Positive = 0.3
    """Limit of the difference between the board's nominal size and its size measured by the rails."""
    max_spot_px: Positive = 0.5
    """Limit of a spot's uncertainty from the calibration at --range-m, 1 sigma: beyond it the unit loses LEDs."""


@dataclass(frozen=True)
class DriftOptions:
    """Options of the drift check."""

    check: str | None = None
    """Geometry file of hil calibrate: check for drift since that calibration with a few views."""
    moved: Flag = False
    """With --check: the LED ring has been removed and remounted since."""
    max_drift_px: Positive = 0.03
    """With --check: a smaller drift is accepted, RMS over all pixels."""
    alarm: Positive = 1e-3
    """With --check: probability of a chance result below which a drift is significant."""


@dataclass(frozen=True)
class DriveOptions:
    """Options of views that the bench takes itself."""

    drive: Flag = False
    """Move the bench of --rig through a plan of views and write VIEWS, a new folder, before the calibration."""
    count: Annotated[Integer, bounded(2)] = 40
    """With --drive: number of views."""
    near_m: Positive = 0.7
    """With --drive: least range from camera to target."""
    far_m: Positive = 4.0
    """With --drive: largest range from camera to target."""
    turn_deg: Positive = 20.0
    """With --drive: largest angle of each gimbal."""
    settle_s: Positive = 0.5
    """With --drive: time at rest before an exposure."""
    speed: Positive = 1.0
    """With --drive: simulation speed relative to real time, on an emulated rig."""
    yes: Flag = False
    """With --drive: confirm that the bench is clear (required for hardware rigs)."""


_START, _RESULT, _SIGMAS, _LIMITS, _DRIFT, _DRIVE = (
    InitialGuessOptions(),
    ResultOptions(),
    BenchSigmas(),
    LimitOptions(),
    DriftOptions(),
    DriveOptions(),
)


def calibrate(
    views: str,
    /,
    *,
    start: Group[InitialGuessOptions] = _START,
    result: Group[ResultOptions] = _RESULT,
    sigmas: Group[BenchSigmas] = _SIGMAS,
    limits: Group[LimitOptions] = _LIMITS,
    drift: Group[DriftOptions] = _DRIFT,
    driving: Group[DriveOptions] = _DRIVE,
    settings: Settings = (),
) -> int:
    """Calibrate the vision unit from views at known bench positions, or check an earlier calibration for drift.

    With --drive the bench takes the views itself. With --scene the camera of the docking monitor is calibrated.

    Parameters
    ----------
    views
        Folder with views.csv and the images (docs/how-to/calibrate-cameras.md), or the path of such a CSV file.
    """
    if start.source is not None or start.to is not None:
        return _interchange(views, start, result.out, settings)
    problems = start.problems()
    if drift.check is not None:
        given = {"geometry": start.geometry, "keep": start.keep, "out": result.out, "rig-out": result.rig_out}
        given["figure"] = result.figure
        problems += [Problem("--check", "", f"goes without --{name}") for name, value in given.items() if value]
    elif drift.moved:
        problems.append(Problem("--moved", "", "goes with --check only"))
    others: dict[str, object] = {"geometry": start.geometry, "keep": start.keep, "out": result.out}
    others["rig-out"] = result.rig_out
    others |= {"figure": result.figure, "check": drift.check, "drive": driving.drive}
    problems += _television_problems(start, result.scene_out, others)
    problems += _hand_held_problems(start, others)
    problems += _one_camera_problems(start, result)
    refuse(problems + (_drive_problems(views, start, driving) if driving.drive else []))
    if start.scene is not None:
        return _calibrate_television(Path(views), start.scene, start, result, limits)
    if start.camera is not None:
        return _calibrate_one(Path(views), start.camera, start, result, limits, settings)
    if driving.drive:
        _drive(Path(views), start, sigmas, driving, settings)
    if drift.check is not None:
        return _check(views, drift.check, start, result.json, limits, drift, settings)
    return _calibrate(views, start, result, sigmas, limits, settings)


def _drive_problems(views: str, start: InitialGuessOptions, driving: DriveOptions) -> list[Problem]:
    problems = []
    if start.target.board is not None:
        problems.append(Problem("--drive", "", "goes without --board: the target is the LED ring"))
    if driving.near_m >= driving.far_m:
        problems.append(Problem("--near-m", "", f"{driving.near_m:g}: must be less than --far-m {driving.far_m:g}"))
    folder = Path(views)
    if not folder.absolute().parent.is_dir():
        problems.append(Problem(views, "", "its parent folder does not exist"))
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        problems.append(Problem(views, "", "exists: give the name of a new folder for --drive"))
    return problems


def _drive(
    folder: Path, start: InitialGuessOptions, sigmas: BenchSigmas, driving: DriveOptions, settings: Sequence[str]
) -> None:
    """Take the views with the bench and write them to ``folder``."""
    import numpy as np

    from hil.cli.warm_up import compile_kernels_with_notice
    from hil.config.load import load_geometry, load_rig, load_scenario
    from hil.parts.vision.calibration_drive import plan_drive, take_views, write_views
    from hil.parts.vision.view_plan import PlanRequest
    from hil.session import build
    from hil.vmu.calibration.model import Setup
    from hil.vmu.calibration.refine import weak_prior
    from hil.vmu.geometry import geometry_of_rig

    refuse_wires_in_use(start.rig, settings)
    scenario = load_scenario("scheme-1", [*settings, "vmu.source=cameras"])
    loaded = load_rig(start.rig, settings)
    if loaded.value.kind == "hardware" and not driving.yes:
        text = f"{loaded.value.name} is hardware and its axes will move: clear the bench, then add --yes"
        raise BadInput.single("--yes", "", text)
    job = build.Job(scenario, loaded, 0, scenario.value.step_s, driving.speed)
    build.check_rig(job)
    rig = job.rig.value
    geometry = geometry_of_rig(rig) if start.geometry is None else load_geometry(start.geometry).value
    setup = Setup.of(geometry, rig.bench)
    axis_sigma = np.array([1e-3 * sigmas.rail_sigma_mm] * 3 + [np.radians(sigmas.gimbal_sigma_deg)] * 3)
    held = weak_prior(setup, start.keep, axis_sigma, 1e-3 * sigmas.led_sigma_mm, 0.0)
    request = PlanRequest(driving.count, driving.near_m, driving.far_m, float(np.radians(driving.turn_deg)))
    plan = plan_drive(job, setup, held, request)
    console = notices()
    compile_kernels_with_notice(job, console)

    announce = partial(say, console=console, style="dim")
    with ProgressBar(console, "opening the axes") as bar, build.wired_bench(job, announce) as bench:
        views, identities = take_views(bench, plan, driving.settle_s, bar.show)
    write_views(folder, views, identities)


def _calibrate(
    views: str,
    start: InitialGuessOptions,
    result: ResultOptions,
    sigmas: BenchSigmas,
    limits: LimitOptions,
    settings: Sequence[str],
) -> int:
    import numpy as np

    from hil.config.load import load_geometry, load_rig
    from hil.params.bench import ideal_axes
    from hil.parts.vision.cli.calibrate_tables import print_outcome
    from hil.vmu.calibration import hand_held, job
    from hil.vmu.calibration.files import HAND_HELD, Label, as_toml, geometry_table, rig_table
    from hil.vmu.calibration.report import as_json
    from hil.vmu.calibration.views import read_views, what_was_read
    from hil.vmu.geometry import geometry_of_rig

    rig = load_rig(start.rig, settings)
    guess = start.geometry is not None
    geometry = load_geometry(start.geometry).value if start.geometry is not None else geometry_of_rig(rig.value)
    board = _board(start.target)
    loaded = hand_held.read_pairs(Path(views)) if start.hand_held else read_views(Path(views))
    read = what_was_read([image for pair in loaded.images for image in pair])
    identities = _identities(Path(views), geometry.identities, start.geometry or start.rig, result.date)
    sigma = np.array([1e-3 * sigmas.rail_sigma_mm] * 3 + [np.radians(sigmas.gimbal_sigma_deg)] * 3)
    given = job.CalibrationInputs(
        board, start.keep, sigma, 1e-3 * sigmas.led_sigma_mm, 0.01 * sigmas.square_sigma_percent
    )
    date = result.date or datetime.datetime.now().astimezone().date().isoformat()
    target = f"{HAND_HELD} {job.target_name(board)}" if start.hand_held else job.target_name(board)
    label = Label(result.id or f"vmu-{date}", date, target)
    with ProgressBar(notices(), "reading the views") as bar:
        limit_values = job.CalibrationLimits(*(getattr(limits, field.name) for field in fields(limits)))
        common = rig.value, geometry, given, limit_values, label, guess, bar.show
        if start.hand_held:
            outcome = job.calibrate_hand_held(loaded, *common)
        else:
            outcome = job.calibrate(replace(loaded, axes=ideal_axes(rig.value, loaded.axes)), *common)
    fit = outcome.solved.fit
    write_json(as_json(outcome), result.json)
    if result.figure is not None:
        from hil.vmu.calibration.figure import draw

        draw(outcome, result.figure)
    outcome.refuse_unusable(views)
    if result.out is not None:
        used = len(outcome.solved.observations.names)
        table = geometry_table(label, fit, outcome.turntable, sigma, geometry, used, identities)
        measured = "LEDs and cameras" if label.target.endswith("leds") and "leds" not in start.keep else "cameras"
        given_leds = "" if measured != "cameras" else " The LEDs are those given to it: measure them too."
        write_text(as_toml(table, f"Vision unit: {measured}, as measured by hil calibrate.{given_leds}"), result.out)
    if result.rig_out is not None:
        content = {"extends": base_of(start.rig, result.rig_out), **rig_table(fit.setup, board is None)}
        write_text(as_toml(content, f"Mounting of the cameras, from calibration {label.id}."), result.rig_out)
    if result.json != "-":
        _print_origin(read, bool(identities))
        print_outcome(outcome, Console())
    return _PASSED if outcome.passed else _FAILED


def _identities(
    views: Path, given: dict[str, CameraIdentity | None], source: str, date: str | None
) -> dict[str, CameraIdentity | None]:
    """Return the identities of the cameras of ``views``, a folder or a CSV file in it.

    given: those of ``source``, of which the cameras of the views must be. Raises BadInput.
    """
    from hil.config.camera_identity import check_folder, read_identities

    check_folder(given, views, source)
    read = read_identities(views)
    day = date or datetime.datetime.now().astimezone().date().isoformat()
    return {name: each and each.model_copy(update={"date": each.date or day}) for name, each in read.items()}


def _print_origin(read: str, is_identified: bool) -> None:
    """Print what was read, and whether the cameras are known."""
    from hil.config.camera_identity import CAMERAS_FILE, NOT_PROVEN

    say(read)
    if not is_identified:
        say(f"{NOT_PROVEN}: no {CAMERAS_FILE} with the images, see hil cameras identity")


def _interchange(views: str, start: InitialGuessOptions, out: str | None, settings: Sequence[str]) -> int:
    """Read or write the cameras of a pair as another program has them."""
    from hil.config.camera_identity import file_doubt
    from hil.config.load import load_geometry, load_rig
    from hil.config.vmu_geometry import Tolerances
    from hil.vmu.calibration.files import as_toml
    from hil.vmu.calibration.interchange import read_pair, written
    from hil.vmu.geometry import geometry_of_rig

    if start.source is not None and start.to is not None:
        raise BadInput.single("--from", "", "goes without --to")
    if start.to is not None:
        path = Path(views)
        files = {path.with_name(f"{path.stem}-{ending}"): text for ending, text in
                 written(start.to, load_geometry(views).value).items()}  # fmt: skip
        if existing := [file for file in files if file.exists()]:
            raise BadInput.single("--to", "", f"{existing[0]}: exists already, move it away")
        for file, text in files.items():
            write_text(text, str(file))
            say(str(file))
        return _PASSED
    if out is None:
        raise BadInput.single("--out", "", "is missing: the geometry file (*.toml) to write")
    assert start.source is not None
    rig = load_rig(start.rig, settings).value
    nominal = load_geometry(start.geometry).value if start.geometry is not None else geometry_of_rig(rig)
    paths = [Path(name) for name in views.split(",")]
    geometry = read_pair(start.source, paths, nominal.model_copy(update={"tolerances": Tolerances()}))
    table = geometry.model_dump(exclude_none=True)
    write_text(as_toml(table, f"Vision unit, with the cameras of {views} ({start.source})."), out)
    say(f"{out}: state the accuracy of this calibration in [tolerances], and check the LEDs")
    if doubt := file_doubt(geometry.identities, out):
        say(doubt)
    return _PASSED


def _television_problems(start: InitialGuessOptions, scene_out: str | None, others: dict[str, object]) -> list[Problem]:
    """Return the problems of the options of a television camera. others: values of options of a vision unit."""
    if start.scene is None:
        return [Problem("--scene-out", "", "goes with --scene only")] if scene_out is not None else []
    problems = [Problem("--scene", "", f"goes without --{name}") for name, value in others.items() if value]
    return [*problems, *start.board_missing("--scene")]


def _hand_held_problems(start: InitialGuessOptions, others: dict[str, object]) -> list[Problem]:
    if not start.hand_held:
        return []
    given = [name for name in ("rig-out", "check", "drive") if others[name]]
    problems = [Problem("--hand-held", "", f"goes without --{name}") for name in given]
    if start.target.board is None and start.geometry is None:
        text = "needs --board and --square-mm; or, for the layout of the LEDs, --geometry with the calibrated cameras"
        problems.append(Problem("--hand-held", "", text))
    return problems


def _one_camera_problems(start: InitialGuessOptions, result: ResultOptions) -> list[Problem]:
    """Return the problems of the options of one camera of a vision unit."""
    if start.camera is None:
        return []
    given = {"scene": start.scene, "keep": start.keep, "rig-out": result.rig_out, "figure": result.figure}
    problems = [Problem("--camera", "", f"goes without --{name}") for name, value in given.items() if value]
    return [*problems, *start.board_missing("--camera")]


def _fit_of(
    folder: Path, side: Side | None, size: tuple[int, int] | None, start: InitialGuessOptions, result: ResultOptions,
    limits: LimitOptions,
) -> tuple[CameraFit, str]:  # fmt: skip
    """Return the camera by its images, and what was read. Raises BadInput if they do not fit."""
    from hil.vmu.calibration.single_camera import board_images, fit_camera, images_of_camera
    from hil.vmu.calibration.views import what_was_read

    board = _board(start.target)
    assert board is not None
    paths = images_of_camera(folder, side)
    with ProgressBar(notices(), "reading the images") as bar:
        fit = fit_camera(*board_images(paths, size, board, bar.show), board)
    passed = fit.rms_px <= limits.max_rms_px
    write_json(fit.as_json(passed, limits.max_rms_px), result.json)
    if not passed:
        text = f"residuals {fit.rms_px:.3f} px RMS, allowed {limits.max_rms_px:g} px: no file is written"
        raise BadInput.single(str(folder), "", text)
    return fit, what_was_read(paths)


def _calibrate_television(
    folder: Path, scene: str, start: InitialGuessOptions, result: ResultOptions, limits: LimitOptions
) -> int:
    from hil.config.camera_identity import MONITOR_CAMERA
    from hil.config.load import load_scene
    from hil.parts.vision.cli.calibrate_tables import print_camera
    from hil.vmu.calibration.files import as_toml

    loaded = load_scene(scene).value
    fit, read = _fit_of(folder, None, (loaded.camera.width, loaded.camera.height), start, result, limits)
    given = {MONITOR_CAMERA: loaded.camera.identity}
    identity = _identities(folder, given, scene, result.date).get(MONITOR_CAMERA)
    if result.scene_out is not None:
        content = {"extends": base_of(scene, result.scene_out, "targets"), **fit.scene_table(loaded, identity)}
        write_text(as_toml(content, "Television camera, as measured by hil calibrate."), result.scene_out)
    if result.json != "-":
        _print_origin(read, identity is not None)
        nominal = loaded.camera.f, loaded.camera.f, loaded.camera.cx, loaded.camera.cy
        print_camera(fit, f"Camera of scene {loaded.name}", nominal, Console())
    return _PASSED


def _calibrate_one(
    folder: Path,
    side: Side,
    start: InitialGuessOptions,
    result: ResultOptions,
    limits: LimitOptions,
    settings: Sequence[str],
) -> int:
    """Calibrate one camera of a vision unit; the other one, baseline and LEDs are those of --geometry or --rig."""
    from hil.config.load import load_geometry, load_rig
    from hil.parts.vision.cli.calibrate_tables import print_camera
    from hil.vmu.calibration.files import as_toml
    from hil.vmu.geometry import geometry_of_rig

    rig = load_rig(start.rig, settings).value
    nominal = load_geometry(start.geometry).value if start.geometry is not None else geometry_of_rig(rig)
    fit, read = _fit_of(folder, side, None, start, result, limits)
    identity = _identities(folder, nominal.identities, start.geometry or start.rig, result.date).get(side)
    if result.out is not None:
        table = fit.geometry(nominal, side, identity).model_dump(exclude_none=True)
        comment = f"Vision unit: {side} camera as measured by hil calibrate; the rest is that given to it."
        write_text(as_toml(table, comment), result.out)
    if result.json != "-":
        _print_origin(read, identity is not None)
        camera = getattr(nominal, side)
        print_camera(fit, f"{side} camera", (camera.fx, camera.fy, camera.cx, camera.cy), Console())
    return _PASSED


def _check(
    views: str,
    known_path: str,
    start: InitialGuessOptions,
    json_path: str | None,
    limits: LimitOptions,
    drift: DriftOptions,
    settings: Sequence[str],
) -> int:
    from hil.config.load import load_geometry, load_rig
    from hil.params.bench import ideal_axes
    from hil.parts.vision.cli.calibrate_tables import print_check
    from hil.vmu.calibration import job
    from hil.vmu.calibration.files import read_back
    from hil.vmu.calibration.report import drift_as_json
    from hil.vmu.calibration.views import read_views

    stored = read_back(load_geometry(known_path).value, known_path)
    loaded = read_views(Path(views))
    loaded = replace(loaded, axes=ideal_axes(load_rig(start.rig, settings).value, loaded.axes))
    with ProgressBar(notices(), "reading the views") as bar:
        checked = job.check(loaded, stored, _board(start.target), drift.moved, limits.range_m, bar.show)
    allowed = job.DriftLimits(limits.max_rms_px, drift.max_drift_px, drift.alarm)
    deliver(drift_as_json(checked, allowed), json_path, lambda: print_check(checked, allowed, Console()))
    return _FAILED if checked.refusal(allowed)[0] else _PASSED


def _board(target: BoardOptions) -> Board | None:
    from hil.vmu.calibration.board import Board

    if target.board is None or target.square_mm is None:
        return None
    columns, rows = (int(number) for number in target.board.split("x"))
    if target.marker_mm is None:
        return Board(columns, rows, 1e-3 * target.square_mm)
    return Board(columns - 1, rows - 1, 1e-3 * target.square_mm, 1e-3 * target.marker_mm, target.dictionary)


def _board_problems(target: BoardOptions) -> list[Problem]:
    board, square_mm = target.board, target.square_mm
    if board is None:
        given = {"square-mm": square_mm, "marker-mm": target.marker_mm}
        return [
            Problem(f"--{name}", "", "goes with --board only") for name, value in given.items() if value is not None
        ]
    if square_mm is not None and square_mm < _LEAST_SQUARE_MM:
        return [Problem("--square-mm", "", f"{square_mm:g}: at least {_LEAST_SQUARE_MM:g} mm; is this in metres?")]
    if square_mm is not None and square_mm > _LARGEST_SQUARE_MM:
        return [
            Problem("--square-mm", "", f"{square_mm:g}: at most {_LARGEST_SQUARE_MM:g} mm; is this in micrometres?")
        ]
    match = re.fullmatch(r"(\d{1,2})x(\d{1,2})", board)
    if match is None:
        return [Problem("--board", "", f"{board}: must be COLUMNSxROWS of inner corners, as 11x8")]
    columns, rows = (int(number) for number in match.groups())
    if target.marker_mm is not None and square_mm is not None:
        return _charuco_problems(target, columns, rows)
    if columns == rows or min(columns, rows) < 3:
        text = "columns and rows must be at least 3 and differ, or the orientation of the board is ambiguous"
        return [Problem("--board", "", f"{board}: {text}")]
    return [Problem("--square-mm", "", "is missing: the side of a square, measured")] if square_mm is None else []


def _charuco_problems(target: BoardOptions, columns: int, rows: int) -> list[Problem]:
    """Return the problems of a ChArUco board of ``columns`` x ``rows`` squares."""
    from hil.vmu.prints import CharucoSettings, checked

    assert target.square_mm is not None
    assert target.marker_mm is not None
    sides = {"square_m": 1e-3 * target.square_mm, "marker_m": 1e-3 * target.marker_mm}
    try:
        checked(CharucoSettings, {"dictionary": target.dictionary, "columns": columns, "rows": rows, **sides})
    except BadInput as error:
        return [Problem("--board", "", f"{p.key.rpartition('.')[2]}: {p.message}") for p in error.problems]
    return []
