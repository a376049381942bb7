"""Takes the pictures of a recording into folders that ``hil vmu`` and ``hil monitor`` read."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from hil.config.scene import Scene
from hil.core.camera_images import CAMERAS, LEFT, MONITOR, RIGHT
from hil.errors import BadInput
from hil.monitor.sources import WHOLE, exposure, lines_of
from hil.recording.images import RecordedImage, pictures
from hil.recording.read import Recorded
from hil.recording.schema import GEOMETRY_FILE, SCENE_FILE

FOLDERS: Final = {LEFT: "left", RIGHT: "right", MONITOR: "monitor"}
TIMES: Final = "times.csv"
_COLUMNS: Final = ("file", "camera", "t_s", "bench_s", "number", "status", "recorded_as")


@dataclass
class Exported:
    """What was written. pictures: files by camera; whole: whether there is one for each picture of the monitor."""

    folder: Path
    pictures: dict[str, int]
    whole: bool = True
    jpeg: bool = False


def export_pictures(recorded: Recorded, folder: Path) -> Exported:
    """Write the pictures as PNG: ``left/NNNN.png`` and ``right/NNNN.png``, ``monitor/NNNNNN.png``, and ``times.csv``.

    The vision unit's are numbered by their exposure, k at ``k / rate_hz`` of bench time; the docking monitor's by
    their picture, k at ``k / fps`` of the run, of both half frames where it has such. Geometry and scene stand
    beside them. Raises BadInput where there is nothing to write, or pictures are there already.
    """
    taken = [folder / name for name in FOLDERS.values() if (folder / name).exists()]
    if taken:
        raise BadInput.single("--pictures", "", f"{taken[0]} is there already: give another folder")
    found = Exported(folder, dict.fromkeys(CAMERAS, 0))
    times: Path | None = None
    try:
        with _Times(folder / TIMES) as table:
            for picture, name, image in _files(recorded):
                path = folder / FOLDERS[picture.camera] / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(picture.data if image is None else _png(image))
                table.write(picture, path.relative_to(folder))
                if picture.camera == MONITOR:
                    found.whole &= int(path.stem) == found.pictures[MONITOR]
                found.pictures[picture.camera] += 1
                found.jpeg |= picture.encoding == "jpeg"
            times = table.path
        _write_calibrations(recorded, found)
    except OSError as error:
        raise BadInput.single("--pictures", "", f"{error.filename or times or folder}: {error.strerror}") from error
    if not any(found.pictures.values()):
        text = "holds no pictures: a run has some where its vision unit or docking monitor is rendered"
        raise BadInput.single(str(recorded.path), "", text)
    return found


class _Times:
    """The table of times; it is made with its first row."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: list[tuple[object, ...]] = []

    def __enter__(self) -> _Times:
        return self

    def write(self, picture: RecordedImage, file: Path) -> None:
        self._rows.append(
            (file, picture.camera, picture.t_s, picture.bench_s, picture.number, picture.status, picture.encoding)
        )

    def __exit__(self, *_: object) -> None:
        if self._rows:
            with self.path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(_COLUMNS)
                writer.writerows(self._rows)


def _files(recorded: Recorded) -> Iterator[tuple[RecordedImage, str, np.ndarray | None]]:
    """Yield each picture that becomes a file, its name, and its image; None where the recorded bytes are it."""
    rate_hz = recorded.rig.vmu.rate_hz
    for picture in pictures(recorded.path, LEFT, RIGHT):
        image = None if picture.encoding == "png" else picture.image(recorded.path)
        yield picture, f"{_number(picture.bench_s, rate_hz):04d}.png", image
    if SCENE_FILE in recorded.files:
        scene = recorded.calibration(SCENE_FILE, Scene)
        whole = scene.fields == "whole"
        yield from _whole_pictures(recorded) if whole else _woven_pictures(recorded, scene)


def _number(bench_s: float, rate_hz: float) -> int:
    return round(bench_s * rate_hz) if math.isfinite(bench_s) else 0


def _whole_pictures(recorded: Recorded) -> Iterator[tuple[RecordedImage, str, np.ndarray | None]]:
    for picture in pictures(recorded.path, MONITOR):
        image = None if picture.encoding == "png" else picture.image(recorded.path)
        yield picture, f"{picture.number:06d}.png", image


def _woven_pictures(recorded: Recorded, scene: Scene) -> Iterator[tuple[RecordedImage, str, np.ndarray | None]]:
    """Yield pictures of two half frames; where one was not recorded, the lines of the other stand for it."""
    slot, whole = -1, np.empty(0, np.uint8)
    last: RecordedImage | None = None
    for picture in pictures(recorded.path, MONITOR):
        half = exposure(scene, picture.number)[1]
        image = picture.image(recorded.path)
        if last is None or picture.number // 2 != slot:
            if last is not None:
                yield last, f"{slot:06d}.png", whole
            slot, whole = picture.number // 2, image.copy()
        elif half != WHOLE:
            whole[lines_of(half)] = image[::2]
        last = picture
    if last is not None:
        yield last, f"{slot:06d}.png", whole


def _png(image: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", image)[1].tobytes())


def _write_calibrations(recorded: Recorded, found: Exported) -> None:
    for name, camera in ((GEOMETRY_FILE, LEFT), (SCENE_FILE, MONITOR)):
        if found.pictures[camera] and name in recorded.files:
            (found.folder / name).write_text(recorded.files[name], encoding="utf-8")
