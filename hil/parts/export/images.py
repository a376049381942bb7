"""Export of a recording's images to folders that ``hil vmu`` and ``hil monitor`` read."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from hil.config.camera_identity import MONITOR_CAMERA, write_identities
from hil.config.scene import Scene
from hil.config.vmu_geometry import VmuGeometry
from hil.core.camera_images import CAMERAS, GEOMETRY_FILE, LEFT, MONITOR, RIGHT, SCENE_FILE
from hil.errors import BadInput
from hil.parts.monitor.sources import WHOLE, exposure, lines_of
from hil.recording.images import RecordedImage, recorded_images
from hil.recording.read import Recorded

FOLDERS: Final = {LEFT: "left", RIGHT: "right", MONITOR: "monitor"}
TIMES: Final = "times.csv"
_COLUMNS: Final = ("file", "camera", "t_s", "bench_s", "number", "status", "recorded_as")


@dataclass
class Exported:
    """Result of an export. images: files by camera; whole: whether no image of the monitor is missing."""

    folder: Path
    images: dict[str, int]
    whole: bool = True
    jpeg: bool = False


def export_images(recorded: Recorded, folder: Path) -> Exported:
    """Write the images as PNG: ``left/NNNN.png`` and ``right/NNNN.png``, ``monitor/NNNNNN.png``, and ``times.csv``.

    The vision unit's are numbered by their exposure, k at ``k / rate_hz`` of bench time; the docking monitor's by
    their frame, k at ``k / fps`` of the run, woven from both half frames if it has such. Geometry and scene are
    written next to them. Raises BadInput if there is nothing to write, or images exist already.
    """
    taken = [folder / name for name in FOLDERS.values() if (folder / name).exists()]
    if taken:
        raise BadInput.single("--images", "", f"{taken[0]} exists: give another folder")
    exported = Exported(folder, dict.fromkeys(CAMERAS, 0))
    times: Path | None = None
    try:
        with _Times(folder / TIMES) as table:
            for entry, name, image in _files(recorded):
                path = folder / FOLDERS[entry.camera] / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(entry.data if image is None else _png(image))
                table.write(entry, path.relative_to(folder))
                if entry.camera == MONITOR:
                    exported.whole &= int(path.stem) == exported.images[MONITOR]
                exported.images[entry.camera] += 1
                exported.jpeg |= entry.encoding == "jpeg"
            times = table.path
        _write_calibrations(recorded, exported)
    except OSError as error:
        raise BadInput.single("--images", "", f"{error.filename or times or folder}: {error.strerror}") from error
    if not any(exported.images.values()):
        text = "has no images: a run has some if its vision unit or docking monitor is rendered"
        raise BadInput.single(str(recorded.path), "", text)
    return exported


class _Times:
    """Table of times; the file is created only if it has rows."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: list[tuple[object, ...]] = []

    def __enter__(self) -> _Times:
        return self

    def write(self, entry: RecordedImage, file: Path) -> None:
        self._rows.append((file, entry.camera, entry.t_s, entry.bench_s, entry.number, entry.status, entry.encoding))

    def __exit__(self, *_: object) -> None:
        if self._rows:
            with self.path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(_COLUMNS)
                writer.writerows(self._rows)


def _files(recorded: Recorded) -> Iterator[tuple[RecordedImage, str, np.ndarray | None]]:
    """Yield each image to be written, its file name and its pixels; None if the recorded bytes are PNG."""
    rate_hz = recorded.rig.vmu.rate_hz
    for entry in recorded_images(recorded.path, LEFT, RIGHT):
        image = None if entry.encoding == "png" else entry.image(recorded.path)
        yield entry, f"{_number(entry.bench_s, rate_hz):04d}.png", image
    if SCENE_FILE in recorded.files:
        scene = recorded.calibration(SCENE_FILE, Scene)
        whole = scene.fields == "whole"
        yield from _full_frames(recorded) if whole else _woven_frames(recorded, scene)


def _number(bench_s: float, rate_hz: float) -> int:
    return round(bench_s * rate_hz) if math.isfinite(bench_s) else 0


def _full_frames(recorded: Recorded) -> Iterator[tuple[RecordedImage, str, np.ndarray | None]]:
    for entry in recorded_images(recorded.path, MONITOR):
        image = None if entry.encoding == "png" else entry.image(recorded.path)
        yield entry, f"{entry.number:06d}.png", image


def _woven_frames(recorded: Recorded, scene: Scene) -> Iterator[tuple[RecordedImage, str, np.ndarray | None]]:
    """Yield images woven from two half frames; if one was not recorded, the lines of the other replace it."""
    slot, whole = -1, np.empty(0, np.uint8)
    last: RecordedImage | None = None
    for entry in recorded_images(recorded.path, MONITOR):
        half = exposure(scene, entry.number)[1]
        image = entry.image(recorded.path)
        if last is None or entry.number // 2 != slot:
            if last is not None:
                yield last, f"{slot:06d}.png", whole
            slot, whole = entry.number // 2, image.copy()
        elif half != WHOLE:
            whole[lines_of(half)] = image[::2]
        last = entry
    if last is not None:
        yield last, f"{slot:06d}.png", whole


def _png(image: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", image)[1].tobytes())


def _write_calibrations(recorded: Recorded, exported: Exported) -> None:
    for name, camera in ((GEOMETRY_FILE, LEFT), (SCENE_FILE, MONITOR)):
        if exported.images[camera] and name in recorded.files:
            (exported.folder / name).write_text(recorded.files[name], encoding="utf-8")
    if exported.images[LEFT] and GEOMETRY_FILE in recorded.files:
        write_identities(recorded.calibration(GEOMETRY_FILE, VmuGeometry).identities, exported.folder)
    if exported.images[MONITOR] and SCENE_FILE in recorded.files:
        identity = recorded.calibration(SCENE_FILE, Scene).camera.identity
        write_identities({MONITOR_CAMERA: identity}, exported.folder / FOLDERS[MONITOR])
