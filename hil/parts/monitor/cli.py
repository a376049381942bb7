"""``hil monitor``: the docking monitor on a video, a folder of images or a camera."""

from __future__ import annotations

import csv
import math
import os
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TextIO

from rich.console import Console
from rich.table import Table

from hil.cli.options import File, Group, Output, within
from hil.cli.output import commonest, notices, write_json
from hil.cli.progress import ProgressBar
from hil.core.files import create
from hil.errors import BadInput

if TYPE_CHECKING:
    from hil.config.scene import Scene
    from hil.parts.monitor.results import FrameResult, Portion
    from hil.parts.monitor.settings import Region
    from hil.parts.monitor.sources import Source

_PASSED = 0
_REMEDIES = {
    "rejected_motion": "the frames contradict a uniform motion: images lost or cut, or fps is not theirs",
    "rejected_displaced": "the image jumps: vertical synchronisation lost, or a shaken camera",
    "rejected_fields": "state fields in the scene",
    "ambiguous": "another roll of the ship fits as well: state roll_max_deg",
}


@dataclass(frozen=True)
class MonitorOptions:
    """Options of the measurement."""

    roi: str | None = None
    """Initial region of interest: u,v,width,height in px."""
    target: Literal["basic", "backup"] = "basic"
    """The scene's basic or its backup target."""
    q: Annotated[float, within(0.0, 1.0)] = 0.5
    """Weight of the previous portion, 0 to 1."""


_DEFAULTS = MonitorOptions()


def monitor(
    video: str,
    /,
    *,
    scene: str,
    out: File,
    screen: Output = None,
    json: File = None,
    frames: File = None,
    options: Group[MonitorOptions] = _DEFAULTS,
) -> int:
    """Measure range, range rate and angles on the video of an approach, each with its standard deviation.

    Parameters
    ----------
    video
        Video file, folder of images, or the number of a camera.
    scene
        Camera and target: atv, bright-cross, or the path of a scene file (JSON or TOML).
    out
        CSV file to write, one row per portion of 10 frames, - for standard output.
    screen
        Video (.mp4, .mkv, .avi) or image (.png) of the operator's screen.
    json
        File for a summary, - for standard output.
    frames
        CSV file with one row per frame: used or not, the reason, and its own pose.
    """
    assert out is not None

    from hil.config.camera_identity import MONITOR_CAMERA, PROVEN, check_folder
    from hil.config.load import load_scene
    from hil.parts.monitor.monitor import DockingMonitor, process_frames
    from hil.parts.monitor.settings import MonitorSettings
    from hil.parts.monitor.sources import open_source

    loaded = load_scene(scene)
    if options.target == "backup" and loaded.value.backup is None:
        raise BadInput.single(loaded.source, "backup", "is missing: --target backup needs it")
    settings = MonitorSettings(
        region=_region(options.roi, loaded.value),
        target=options.target,
        q=options.q,
        q_attitude=options.q,
    )
    source = open_source(video, loaded)
    doubt = check_folder({MONITOR_CAMERA: loaded.value.camera.identity}, Path(video), loaded.source)
    console = notices()
    portions: list[Portion] = []
    looks: list[FrameResult] = []
    with ExitStack() as stack:
        table = stack.enter_context(_CsvFile(out, _columns()))
        each = stack.enter_context(_CsvFile(frames, _FRAME_COLUMNS)) if frames is not None else None
        painter = stack.enter_context(_painter(screen, loaded.value, source.name)) if screen is not None else None
        bar = stack.enter_context(ProgressBar(console, "compiling the kernels that are not cached"))
        watched = DockingMonitor(source.scene, settings)
        for frame, look, done in process_frames(watched, source):
            looks.append(look)
            if each is not None:
                each.write(_frame_row(look))
            if painter is not None:
                painter.show(frame, look.detection, done)
            for portion in done:
                portions.append(portion)
                reason = portion.reasons[0][0] if portion.reasons else ""
                table.write([*_row(portion), doubt.partition(":")[0] or PROVEN, reason])
            if source.image_count:
                bar.show("frames", min(len(looks) / source.image_count, 1.0))
    summary = _summary(portions, looks) | {
        "warning": watched.warning,
        "rate": _rate_of(source),
        "identity": doubt or PROVEN,
    }
    write_json(summary, json)
    if json != "-" and out != "-":
        _render(summary, portions, Console())
    return _PASSED


def _rate_of(source: Source) -> str:
    """Return on what the times of the frames, and with them all rates, rest."""
    if source.stamped:
        return source.note or "times of the images by the file or by their arrival"
    return f"rates rest on {source.scene.fps:g} images per second, fps of the scene: the images have no times"


def _region(roi: str | None, scene: Scene) -> Region | None:
    """Return the operator's region "u,v,width,height", px, or None."""
    from hil.parts.monitor.settings import Region

    if roi is None:
        return None
    try:
        left, top, wide, high = (int(part) for part in roi.split(","))
    except ValueError:
        left, top, wide, high = 0, 0, 0, 0
    if error := scene.camera.region_error((left, top, wide, high)):
        raise BadInput.single("--roi", "", f"{roi}: {error}")
    return Region.of_box(left, top, wide, high)


def _columns() -> tuple[str, ...]:
    from hil.parts.monitor.results import QUANTITIES

    added = (
        "sigma2_edges",
        "sigma2_common",
        "sigma2_motion",
        "consistent",
        "jitter_px",
        "timing",
        "identity",
        "reason",
    )
    return ("t_s", "frames", "status", *QUANTITIES, *(f"sigma_{name}" for name in QUANTITIES), *added)


def _number(value: float, digits: int = 12) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "nan"


def _row(portion: Any) -> list[str]:
    squares = (portion.sigma2_edges, portion.sigma2_common, portion.sigma2_motion)
    return [
        f"{portion.t_s:.6f}",
        str(portion.frames),
        portion.status,
        *(_number(value) for value in (*portion.values, *portion.sigmas)),
        *(_number(value, 6) for value in squares),
        str(int(portion.consistent)),
        f"{portion.jitter_px:g}",
        portion.timing,
    ]


_FRAME_COLUMNS = ("frame", "t_s", "status", "reason", "tracked", "points", "d1_m", "d2_m", "d3_m", "phi1_rad",
                  "phi2_rad", "phi3_rad", "growth_px", "blur_px", "noise")  # fmt: skip


def _frame_row(look: FrameResult) -> list[str]:
    return [
        str(look.detection.number), f"{look.detection.t_s:.6f}", look.status, look.reason, str(int(look.tracked)),
        str(len(look.detection.edges)), *(_number(value) for value in (*look.pose[:7], look.blur_px, look.noise)),
    ]  # fmt: skip


class _CsvFile:
    """CSV file that gets its name when it is complete; "-" is standard output."""

    def __init__(self, path: str, columns: tuple[str, ...]) -> None:
        self._path, self._columns = path, columns
        self._file: TextIO | None = None

    def __enter__(self) -> _CsvFile:
        if self._path == "-":
            self._writer = csv.writer(sys.stdout, lineterminator="\n")
        else:
            try:
                partial = Path(f"{self._path}.part")
                create(partial)
                self._file = partial.open("w", encoding="utf-8", newline="")
            except OSError as error:
                raise BadInput.single("--out", self._path, f"cannot be written: {error.strerror}") from error
            self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow(self._columns)
        return self

    def write(self, row: list[str]) -> None:
        """Add a row."""
        self._writer.writerow(row)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._file is None:
            return
        self._file.close()
        # results of a broken recording stay in the .part file; Ctrl-C ends the recording of a camera
        if kind is None or issubclass(kind, KeyboardInterrupt):
            os.replace(f"{self._path}.part", self._path)


def _painter(path: str, scene: Scene, title: str) -> Any:
    from hil.parts.monitor.screen.screen import Screen, ScreenFile

    rate = scene.fps * (1.0 if scene.fields == "whole" else 2.0)

    class Painter:
        """The screen and the file that keeps it."""

        def __enter__(self) -> Painter:
            self._screen, self._file = Screen(scene.camera, title), ScreenFile(path, rate)
            return self

        def __exit__(self, *_: object) -> None:
            self._file.close()

        def show(self, frame: Any, seen: Any, done: list[Portion]) -> None:
            """Show a frame and the portions that it completes."""
            for portion in done:
                self._screen.show_portion(portion)
            self._screen.show_frame(frame, seen)
            self._file.write(self._screen.canvas)

    return Painter()


def _summary(portions: list[Any], looks: list[FrameResult]) -> dict[str, Any]:
    from hil.parts.monitor.results import QUANTITIES

    last = next((p for p in reversed(portions) if p.frames > 0), None)
    return {
        "frames": len(looks),
        "frames_used": sum(look.used for look in looks),
        "frames_by_status": dict(Counter(look.status for look in looks)),
        "rejected": dict(Counter(look.reason for look in looks if not look.used)),
        "refused": commonest((look.status, look.reason) for look in looks if not look.used)
        + commonest((p.status, _REMEDIES.get(p.status, "")) for p in portions if p.status in _REMEDIES),
        "portions": len(portions),
        "portions_by_status": dict(Counter(portion.status for portion in portions)),
        "inconsistent_portions": sum(p.frames > 0 and not p.consistent for p in portions),
        "last": None if last is None else {
            "t_s": last.t_s,
            "status": last.status,
            **{name: _finite(value) for name, value in zip(QUANTITIES, last.values, strict=True)},
            **{f"sigma_{name}": _finite(value) for name, value in zip(QUANTITIES, last.sigmas, strict=True)},
        },
    }  # fmt: skip


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _rows_shown(portions: list[Any]) -> Iterator[Any]:
    step = max(1, -(-len(portions) // 24))
    yield from portions[::step]


def _render(summary: dict[str, Any], portions: list[Any], console: Console) -> None:
    from hil.config.camera_identity import PROVEN

    rows = Table(title=f"{summary['frames_used']} of {summary['frames']} frames used, {len(portions)} portions")
    for name in ("t, s", "status", "range, m", "rate, m/s", "pitch, deg", "yaw, deg", "roll, deg"):
        rows.add_column(name, justify="left" if name == "status" else "right")
    for portion in _rows_shown(portions):
        cells = [f"{portion.t_s:.2f}", portion.status]
        for name, scale, digits in (
            ("range_m", 1.0, 4), ("range_rate_mps", 1.0, 4), ("pitch_passive_rad", 180.0 / math.pi, 3),
            ("yaw_passive_rad", 180.0 / math.pi, 3), ("phi3_rad", 180.0 / math.pi, 3),
        ):  # fmt: skip
            value, sigma = portion.value(name) * scale, portion.sigma(name) * scale
            cells.append(f"{value:.{digits}f} ± {sigma:.{digits}f}" if math.isfinite(value) else "-")
        rows.add_row(*cells)
    console.print(rows)
    if summary["warning"]:
        console.print(f"Warning: {summary['warning']}", highlight=False)
    doubt = () if summary["identity"] == PROVEN else (summary["identity"],)
    for line in (*summary["refused"], summary["rate"], *doubt):
        console.print(line, highlight=False)
