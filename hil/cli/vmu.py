"""``hil vmu``: LED images, from disk or from cameras, to poses: in a file and on an RS-422 line."""

from __future__ import annotations

import csv
import math
import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from hil.cli.output import check_json_path, write_json
from hil.cli.progress import Bar
from hil.cli.warm_up import left_at_once_on_ctrl_c
from hil.config.load import load_geometry
from hil.config.vmu_geometry import VmuGeometry
from hil.drivers.vmu.sender import FrameSender
from hil.errors import BadInput, Problem
from hil.vmu.folder import UNREADABLE, ImageFolder, Pair
from hil.vmu.identify import OK
from hil.vmu.live import StreamPairs, names_two
from hil.vmu.overlay import draw
from hil.vmu.pose import Prediction
from hil.vmu.track import prediction_at
from hil.vmu.unit import WRONG_SIZE, Solution, VisionUnit

_PASSED, _FAILED = 0, 1
_POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
COLUMNS = ("frame", "t_s", "status", "n_leds", *_POSE, *(f"sigma_{name}" for name in _POSE))
_START_SIGMA_M, _START_SIGMA_DEG = 0.1, 5.0


def vmu_command(
    folder: str,
    geometry_path: str,
    out: str,
    rate_hz: float,
    overlay: str | None,
    start_frame: int | None,
    start_pose: Sequence[float] | None,
    json_path: str | None,
    rs422: str | None = None,
    baud: int = 460_800,
    fast: bool = False,
) -> int:
    """Do ``hil vmu``; return its exit code. Raises BadInput before any image is looked at."""
    _check_options(out, rate_hz, overlay, start_frame, start_pose, json_path)
    if baud <= 0:
        raise BadInput.single("--baud", "", f"{baud}: must be above 0")
    geometry = load_geometry(geometry_path).value
    images: ImageFolder | StreamPairs
    if names_two(folder):
        images = StreamPairs(folder)
        count = images.count
    else:
        images = ImageFolder(Path(folder), start_frame)
        _check_size(images, geometry, geometry_path)
        count = len(images)
    live = isinstance(images, StreamPairs) and images.live
    console = Console(stderr=True)
    with left_at_once_on_ctrl_c(), console.status("compiling the kernels where they are not yet"):
        unit = VisionUnit(geometry)
        unit.warm_up()
    if overlay is not None:
        Path(overlay).mkdir(exist_ok=True)
    start = _start(start_pose)
    rows, solutions = [], []
    with ExitStack() as stack:
        if isinstance(images, StreamPairs):
            stack.enter_context(closing(images))
        sender = None if rs422 is None else stack.enter_context(closing(FrameSender(rs422, baud)))
        bar = stack.enter_context(Bar(console, "frames"))
        stack.enter_context(suppress(KeyboardInterrupt) if live else nullcontext())
        for done, (t_s, pair) in enumerate(_on_time(images, rate_hz, live, paced=rs422 is not None and not fast)):
            solution = solve(unit, pair, t_s, start if done == 0 else None)
            if sender is not None:
                sender.send(solution.frame(0, t_s), t_s)
            rows.append(row(pair.frame, solution))
            solutions.append(solution)
            if overlay is not None:
                _write_overlay(Path(overlay), unit, pair, solution)
            bar.tell(f"frame {pair.frame} {solution.status}", (done + 1) / count if count else 0.0)
    write_csv(rows, out)
    summary = summarise(solutions, folder)
    if json_path is not None:
        write_json(summary, json_path)
    if json_path != "-":
        _print(summary, out, Console())
    return _PASSED if summary["solved"] else _FAILED


def _on_time(images: Iterable[Pair], rate_hz: float, live: bool, paced: bool) -> Iterator[tuple[float, Pair]]:
    """Give each pair with the time of its exposure, s: cameras by the clock, others by their number.

    Cameras are looked at ``rate_hz`` times a second, frames between are let go; others wait for their time if paced.
    """
    zero_s, due_s = time.monotonic(), 0.0
    for pair in images:
        now_s = time.monotonic() - zero_s
        if live:
            if now_s >= due_s:
                due_s = max(due_s + 1.0 / rate_hz, now_s)
                yield now_s, pair
            continue
        t_s = pair.frame / rate_hz
        if paced:
            time.sleep(max(0.0, t_s - now_s))
        yield t_s, pair


def solve(unit: VisionUnit, pair: Pair, t_s: float, prediction: Prediction | None = None) -> Solution:
    """Return the solution of ``pair``; an image that cannot be read counts as lost, two of them as rejected."""
    if pair.unreadable and pair.left is None and pair.right is None:
        return unit.rejected(t_s, UNREADABLE)
    return unit.solve(pair.left, pair.right, t_s, prediction)


def row(frame: int, solution: Solution) -> dict[str, Any]:
    """Return the line of ``solution`` under COLUMNS; nan where there is no pose."""
    values, sigmas = np.full(6, math.nan), np.full(6, math.nan)
    if solution.pose is not None:
        values = np.concatenate([solution.pose.t_v, solution.pose.rotation_vector])
        sigmas = np.sqrt(np.diag(solution.pose.covariance))
    numbers = [f"{value:.9g}" for value in (*values, *sigmas)]
    head = (frame, f"{solution.t_s:.6f}", solution.status, solution.n_leds)
    return dict(zip(COLUMNS, (*head, *numbers), strict=True))


def write_csv(rows: Sequence[dict[str, Any]], path: str) -> None:
    """Write ``rows`` to ``path``: the whole file or none of it."""
    partial = Path(f"{path}.part")
    with partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    os.replace(partial, path)


def summarise(solutions: Sequence[Solution], folder: str) -> dict[str, Any]:
    """Return the numbers of ``hil vmu --json``."""
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
    }


def _check_options(
    out: str,
    rate_hz: float,
    overlay: str | None,
    start_frame: int | None,
    start_pose: Sequence[float] | None,
    json_path: str | None,
) -> None:
    problems = check_json_path("--json", json_path)
    problems += check_json_path("--out", out) if out != "-" else [Problem("--out", "", "-: give the name of a file")]
    if not (math.isfinite(rate_hz) and rate_hz > 0.0):
        problems.append(Problem("--rate-hz", "", f"{rate_hz:g}: must be above 0"))
    if start_frame is not None and start_frame < 0:
        problems.append(Problem("--start-frame", "", f"{start_frame}: must be at least 0"))
    if start_pose is not None and not (len(start_pose) == 6 and all(math.isfinite(v) for v in start_pose)):
        problems.append(Problem("--start-pose", "", "must be six numbers: x y z in m, rotation vector in deg"))
    if overlay is not None and not Path(overlay).absolute().parent.is_dir():
        problems.append(Problem("--overlay", "", f"{overlay}: the folder it is to stand in does not exist"))
    if overlay is not None and Path(overlay).exists() and not Path(overlay).is_dir():
        problems.append(Problem("--overlay", "", f"{overlay}: is a file, give the name of a folder"))
    if problems:
        raise BadInput(problems)


def _check_size(images: ImageFolder, geometry: VmuGeometry, path: str) -> None:
    """Raise BadInput where the first images that can be read are all of another size than the geometry's."""
    for pair in images:
        found = [(i, c) for i, c in ((pair.left, geometry.left), (pair.right, geometry.right)) if i is not None]
        if not found:
            continue
        if all(image.shape != (camera.height, camera.width) for image, camera in found):
            image, camera = found[0]
            text = f"{camera.width} x {camera.height}, but frame {pair.frame} is {image.shape[1]} x {image.shape[0]}"
            raise BadInput.single(path, "width, height", text)
        return
    raise BadInput.single(path, "", "goes with a folder in which no image can be read")


def _start(values: Sequence[float] | None) -> Prediction | None:
    if values is None:
        return None
    turn = np.radians(np.array(values[3:]))
    return prediction_at(np.array(values[:3]), turn, _START_SIGMA_M, _START_SIGMA_DEG)


def _write_overlay(folder: Path, unit: VisionUnit, pair: Pair, solution: Solution) -> None:
    import cv2

    picture = draw(unit.solver.scene, pair.left, pair.right, solution, f"frame {pair.frame}  {solution.t_s:.2f} s")
    path = folder / f"{pair.frame:04d}.png"
    if not cv2.imwrite(str(path), picture):
        raise BadInput.single("--overlay", "", f"{path}: cannot be written")


def _print(summary: dict[str, Any], out: str, console: Console) -> None:
    text = ", ".join(f"{count} {status}" for status, count in summary["status"].items())
    console.print(f"{summary['frames']} frames: {text}", highlight=False)
    if summary["chi2_per_degree"] is not None:
        console.print(f"chi-square a degree of freedom {summary['chi2_per_degree']:.2f}", highlight=False)
    if WRONG_SIZE in summary["status"]:
        console.print(f"{WRONG_SIZE}: images of another size than the geometry's", style="red", highlight=False)
    console.print(f"poses in {out}", highlight=False, soft_wrap=True)
