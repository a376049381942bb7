"""``hil vmu``: LED images, from files or cameras, to poses: in a CSV file and on an RS-422 line."""

from __future__ import annotations

import csv
import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, nullcontext, suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from rich.console import Console

from hil.cli.options import (
    Check,
    File,
    Flag,
    Group,
    Integer,
    OptionalCase,
    OptionalInteger,
    Output,
    Positive,
    above_zero,
    bounded,
)
from hil.cli.output import commonest, deliver, file_path_problem, notices, say
from hil.cli.progress import ProgressBar
from hil.core.files import replaced
from hil.errors import BadInput

if TYPE_CHECKING:
    from hil.config.vmu_geometry import VmuGeometry
    from hil.parts.cameras.live import CameraPairs
    from hil.vmu.estimators import PoseEstimator
    from hil.vmu.pose import Prediction
    from hil.vmu.sources import ImageFolder, Pair, StreamPairs
    from hil.vmu.unit import Pose, Solution, VisionUnit

_PASSED, _FAILED = 0, 1
_POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
COLUMNS = (
    "frame",
    "t_s",
    "status",
    "n_leds",
    *_POSE,
    *(f"sigma_{name}" for name in _POSE),
    "epipolar_px",
    "scale",
    *(f"sight_{axis}" for axis in "xyz"),
    "sigma_sight_rad",
    "identity",
    "reason",
)
_ENOUGH = 5  # measured pairs
_START_SIGMA_M, _START_SIGMA_DEG = 0.1, 5.0


def _pose_problem(values: tuple[float, ...]) -> str:
    return "" if all(map(math.isfinite, values)) else "must be six numbers: x y z in m, rotation vector in deg"


def _csv_problem(path: str) -> str:
    return "-: give the name of a file" if path == "-" else file_path_problem(path)


def _overlay_problem(path: str) -> str:
    if not Path(path).absolute().parent.is_dir():
        return f"{path}: its parent folder does not exist"
    is_file = Path(path).exists() and not Path(path).is_dir()
    return f"{path}: is a file, give the name of a folder" if is_file else ""


StartPose = Annotated[
    tuple[float, float, float, float, float, float] | None, Parameter(negative=()), Check(_pose_problem)
]
CsvFile = Annotated[str, Check(_csv_problem)]
Overlay = Annotated[Output, Check(_overlay_problem)]


@dataclass(frozen=True)
class TrackStartOptions:
    """Options of the frames to evaluate, and of their evaluation."""

    rig: str | None = None
    """Rig file whose estimator and its settings are used, of AprilTags or a ChArUco board; default: the LED ring."""
    start_frame: OptionalCase = None
    """First frame to evaluate."""
    frames: Annotated[OptionalInteger, bounded(1)] = None
    """Number of frames to evaluate."""
    start_pose: StartPose = None
    """Initial pose, x y z in m and rotation vector in deg: resolves symmetric LEDs."""


@dataclass(frozen=True)
class SenderOptions:
    """Options of the RS-422 output."""

    rs422: str | None = None
    """Serial port to which each pose is sent at the frame's time, as by the vision unit."""
    baud: Annotated[Integer, above_zero(at_most=1e9)] = 460_800
    """Baud rate of that port."""
    fast: Flag = False
    """Send each pose as soon as it is solved."""


_START_DEFAULTS, _SENDER_DEFAULTS = TrackStartOptions(), SenderOptions()


def vmu(
    folder: str,
    /,
    *,
    geometry: str,
    out: CsvFile,
    rate_hz: Positive = 6.25,
    overlay: Overlay = None,
    start: Group[TrackStartOptions] = _START_DEFAULTS,
    sender: Group[SenderOptions] = _SENDER_DEFAULTS,
    json: File = None,
) -> int:
    """Compute poses with status and sigma from LED images (left/NNNN.png, right/NNNN.png), one row per frame.

    Parameters
    ----------
    folder
        Folder with the folders left and right; or two videos, left.mkv,right.mkv; or two cameras, camera:0,1 or GenICam
        cameras with software trigger, camera:192.168.1.10,192.168.1.11 (hil cameras list).
    geometry
        File of LED layout and cameras, JSON or TOML (docs/explanation/vision-unit.md).
    out
        CSV file to write.
    rate_hz
        Frame rate: the time of a frame is its number divided by this; of two videos, that of the files.
    overlay
        Folder for one image per frame: spots, identities, reprojected LEDs, pose.
    json
        File for the counts, - for standard output.
    """
    from hil.cli.warm_up import exit_on_ctrl_c
    from hil.config.camera_identity import PROVEN, check_folder
    from hil.config.load import load_geometry
    from hil.drivers.vmu.sender import FrameSender
    from hil.vmu.sources import ImageFolder, StreamPairs, exposures, names_two
    from hil.vmu.unit import VisionUnit

    loaded = load_geometry(geometry).value
    images: ImageFolder | StreamPairs | CameraPairs
    doubt = check_folder(loaded.identities, Path(folder.partition(",")[0]), geometry)
    if (cameras := _genicam(folder)) is not None:
        images, count = _camera_pairs(cameras, loaded, rate_hz), None
        doubt = images.identity_doubt
    elif names_two(folder):
        images = StreamPairs(folder)
        count = images.count
    else:
        images = ImageFolder(Path(folder), start.start_frame)
        _check_size(images, loaded, geometry)
        count = len(images)
    live = isinstance(images, StreamPairs) and images.live
    endless = live or cameras is not None
    console = notices()
    if isinstance(images, ImageFolder) and (note := images.depth_note()):
        say(note, console)
    with exit_on_ctrl_c(), console.status("compiling the kernels that are not cached"):
        unit = VisionUnit(loaded) if start.rig is None else _estimator(start.rig, loaded, geometry)
        unit.warm_up()
    if overlay is not None and not isinstance(unit, VisionUnit):
        raise BadInput.single("--overlay", "", "goes with the LED ring, not with another estimator of --rig")
    if overlay is not None:
        Path(overlay).mkdir(exist_ok=True)
    first = _start(start.start_pose)
    rows, solutions = [], []
    identity = doubt.partition(":")[0] or PROVEN
    with ExitStack() as stack:
        if not isinstance(images, ImageFolder):
            stack.enter_context(closing(images))
        line = None if sender.rs422 is None else stack.enter_context(closing(FrameSender(sender.rs422, sender.baud)))
        bar = stack.enter_context(ProgressBar(console, "frames"))
        stack.enter_context(suppress(KeyboardInterrupt) if endless else nullcontext())
        paced = sender.rs422 is not None and not sender.fast
        evaluated = islice(_on_time(exposures(images), rate_hz, live, paced and cameras is None), start.frames)
        for done, (t_s, pair) in enumerate(evaluated):
            solution = solve(unit, pair, t_s, first if done == 0 else None)
            if line is not None:
                line.send(solution.frame(0, t_s), t_s)
            rows.append(row(pair.frame, solution, identity))
            solutions.append(solution)
            if overlay is not None and isinstance(unit, VisionUnit):
                _write_overlay(Path(overlay), unit, pair, solution)
            bar.show(f"frame {pair.frame} {solution.status}", (done + 1) / count if count else 0.0)
    write_csv(rows, out)
    summary = summarise(solutions, folder) | {"identity": doubt or PROVEN}
    deliver(summary, json, lambda: _print(summary, geometry, out, Console()))
    return _PASSED if summary["solved"] else _FAILED


def _genicam(source: str) -> list[str] | None:
    """Return the identifiers of two GenICam cameras, None if ``source`` names something else."""
    from hil.vmu.sources import CAMERAS

    names = [name.strip() for name in source.removeprefix(CAMERAS).split(",")]
    if not source.startswith(CAMERAS) or len(names) != 2 or any(name.isdecimal() for name in names):
        return None
    return names


def _camera_pairs(cameras: Sequence[str], geometry: VmuGeometry, rate_hz: float) -> CameraPairs:
    from hil.config.rig import Vmu
    from hil.config.tables.cameras import VisionCameras
    from hil.parts.cameras.live import CameraPairs

    wait_s = 0.5 / rate_hz  # poses are not due at once
    settings = VisionCameras(left=cameras[0], right=cameras[1], pair_within_s=0.1 / rate_hz, pair_wait_s=wait_s)
    vmu = Vmu.model_validate({"driver": "cameras", "cameras": settings, "rate_hz": rate_hz, "timeout_s": 2.0})
    return CameraPairs(vmu, geometry)


def _on_time(images: Iterable[Pair], rate_hz: float, live: bool, paced: bool) -> Iterator[tuple[float, Pair]]:
    """Yield each pair with the time of its exposure, s: cameras by the clock, videos by their times, others by number.

    Cameras are sampled at ``rate_hz``, frames between are dropped; others wait for their time if paced.
    """
    zero_s, due_s = time.monotonic(), 0.0
    for pair in images:
        now_s = time.monotonic() - zero_s
        if live:
            if now_s >= due_s:
                due_s = max(due_s + 1.0 / rate_hz, now_s)
                yield now_s, pair
            continue
        t_s = pair.frame / rate_hz if pair.t_s is None else pair.t_s
        if paced:
            time.sleep(max(0.0, t_s - now_s))
        yield t_s, pair


def _estimator(rig: str, geometry: VmuGeometry, path: str) -> PoseEstimator:
    """Return the estimator of a rig file with the ``geometry`` of the file at ``path``. Raises BadInput."""
    from hil.config.load import load_rig
    from hil.vmu.estimators import make_estimator

    vmu = load_rig(rig).value.vmu
    return make_estimator(vmu.estimator, geometry, vmu.estimator_settings, path)


def solve(unit: VisionUnit | PoseEstimator, pair: Pair, t_s: float, prediction: Prediction | None = None) -> Solution:
    """Return the solution of ``pair``; one image that is repeated or unreadable counts as lost, two as rejected."""
    from hil.vmu.reflections import Doubt
    from hil.vmu.sources import FAULTS
    from hil.vmu.unit import VisionUnit

    if pair.faults and pair.left is None and pair.right is None:
        solution = _without_spots(t_s, next(iter(pair.faults.values())))
    elif isinstance(unit, VisionUnit):
        solution = unit.solve(pair.left, pair.right, t_s, prediction)
    else:
        solution = _solution(unit, pair, t_s)
    if pair.faults and solution.doubt is None:
        doubt = Doubt(", ".join(f"{side} image {FAULTS[fault]}" for side, fault in pair.faults.items()))
        return replace(solution, doubt=doubt)
    return solution


def _without_spots(t_s: float, status: str, pose: Pose | None = None) -> Solution:
    import numpy as np

    from hil.vmu.kernels.records import SPOT
    from hil.vmu.unit import Solution

    none = np.zeros(0, SPOT)
    return Solution(t_s, status, pose, (none, none), ((), ()))


def _solution(unit: PoseEstimator, pair: Pair, t_s: float) -> Solution:
    """Return the result of an estimator as a solution without spots."""
    from hil.vmu.estimators import PoseEstimate, solve_pair
    from hil.vmu.unit import Pose, Solution

    solved = solve_pair(unit, pair.left, pair.right, t_s)
    if isinstance(solved, Solution):
        return solved
    pose = None
    if isinstance(solved, PoseEstimate) and solved.t_v is not None and solved.covariance is not None:
        assert solved.q_vt is not None
        pose = Pose(
            solved.t_v, solved.q_vt, solved.covariance, solved.covariance if solved.noise is None else solved.noise
        )
    return _without_spots(t_s, solved.status, pose)


def row(frame: int, solution: Solution, identity: str) -> dict[str, Any]:
    """Return the row of ``solution`` under COLUMNS, with the ``identity`` of the cameras; nan without a pose."""
    import numpy as np

    values, sigmas = np.full(6, math.nan), np.sqrt(np.diag(solution.covariance))
    values[:3] = solution.t
    if solution.pose is not None:
        values[3:] = solution.pose.rotation_vector
    partial = solution.partial
    sight = [math.nan] * 4 if partial is None else [*partial.sight, partial.sight_sigma_rad]
    numbers = [f"{value:.9g}" for value in (*values, *sigmas, solution.epipolar_px, solution.scale, *sight)]
    head = (frame, f"{solution.t_s:.6f}", solution.status, solution.n_leds)
    doubt = "" if solution.doubt is None else str(solution.doubt)
    return dict(zip(COLUMNS, (*head, *numbers, identity, doubt), strict=True))


def write_csv(rows: Sequence[dict[str, Any]], path: str) -> None:
    """Write ``rows`` to ``path``, completely or not at all."""
    with replaced(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def summarise(solutions: Sequence[Solution], folder: str) -> dict[str, Any]:
    """Return the numbers of ``hil vmu --json``."""
    from hil.vmu.identify import OK

    counts = Counter(solution.status for solution in solutions)
    measured = [solution for solution in solutions if solution.status == OK]
    degrees = sum(solution.degrees for solution in measured)
    chi2 = sum(solution.chi2 for solution in measured)
    return {
        "folder": folder,
        "frames": len(solutions),
        "solved": len(measured),
        "status": dict(sorted(counts.items())),
        "chi2_per_degree": chi2 / degrees if degrees else None,
        "searched": sum(solution.full_frame for solution in measured),
        "refused": commonest((s.status, str(s.doubt or "")) for s in solutions if s.status != OK)
        + [f"LED {n} was never found: dark, hidden, or not where leds_m has it" for n in never_found(measured)],
    }


def never_found(measured: Sequence[Solution]) -> list[int]:
    """Return the LEDs without a spot in all of at least ``_ENOUGH`` measured pairs."""
    if len(measured) < _ENOUGH:
        return []
    n_leds = len(measured[0].leds[0])
    return [n for n in range(n_leds) if all(side[n] < 0 for solution in measured for side in solution.leds if side)]


def _check_size(images: ImageFolder, geometry: VmuGeometry, path: str) -> None:
    """Raise BadInput if the first readable images all have another size than the geometry's."""
    for pair in images:
        pairs = [(i, c) for i, c in ((pair.left, geometry.left), (pair.right, geometry.right)) if i is not None]
        if not pairs:
            continue
        if all(image.shape != (camera.height, camera.width) for image, camera in pairs):
            image, camera = pairs[0]
            text = f"{camera.width} x {camera.height}, but frame {pair.frame} is {image.shape[1]} x {image.shape[0]}"
            raise BadInput.single(path, "width, height", text)
        return
    raise BadInput.single(path, "", "no image can be read in the folder")


def _start(values: Sequence[float] | None) -> Prediction | None:
    if values is None:
        return None
    import numpy as np

    from hil.vmu.track import prediction_at

    return prediction_at(np.array(values[:3]), np.radians(np.array(values[3:])), _START_SIGMA_M, _START_SIGMA_DEG)


def _write_overlay(folder: Path, unit: VisionUnit, pair: Pair, solution: Solution) -> None:
    import cv2

    from hil.vmu.overlay import draw

    image = draw(unit.solver.scene, pair.left, pair.right, solution, f"frame {pair.frame}  {solution.t_s:.2f} s")
    path = folder / f"{pair.frame:04d}.png"
    if not cv2.imwrite(str(path), image):
        raise BadInput.single("--overlay", "", f"{path}: cannot be written")


def _print(summary: dict[str, Any], geometry: str, out: str, console: Console) -> None:
    from hil.config.camera_identity import PROVEN
    from hil.vmu.estimators import PRINT

    text = ", ".join(f"{count} {status}" for status, count in summary["status"].items())
    say(f"{summary['frames']} frames: {text}", console)
    if summary["chi2_per_degree"] is not None:
        say(f"chi-square per degree of freedom {summary['chi2_per_degree']:.2f}", console)
    if PRINT in summary["status"]:
        text = 'the target fits several prints, or not the stated one: state print = "official" or "opencv" in'
        say(f"{PRINT}: {text} {geometry}", console, "red")
    for line in summary["refused"]:
        say(line, console, "red")
    if summary["identity"] != PROVEN:
        say(summary["identity"], console)
    say(f"poses in {out}", console)
