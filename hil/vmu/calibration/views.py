"""Folder of views: ``views.csv`` with the positions of the bench, ``left/`` and ``right/`` with the images."""

from __future__ import annotations

import csv
import io
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hil.core.files import MIB, read_bytes, read_text
from hil.core.image_files import IMAGE_BYTES, decode_grey
from hil.core.messages import Array
from hil.errors import BadInput, Problem

COLUMNS: Final = ("view", "rail_x_m", "rail_y_m", "rail_z_m", "roll_deg", "pitch_deg", "yaw_deg")
_TABLE_BYTES: Final = 4 * MIB
IMAGE_COLUMNS: Final = ("left", "right")


@dataclass(frozen=True, slots=True)
class Views:
    """names: of the views. axes: (n, 6), rails, m, gimbals, rad. images: the paths of the left and the right image."""

    names: tuple[str, ...]
    axes: Array
    images: tuple[tuple[Path, Path], ...]


def read_views(source: Path) -> Views:
    """Return the views of the folder ``source``, or of the CSV file ``source``; raise BadInput.

    Columns: COLUMNS, and ``left`` and ``right`` if the images are not ``left/VIEW.png`` and ``right/VIEW.png``.
    """
    table = source / "views.csv" if source.is_dir() else source
    try:
        reader = csv.DictReader(io.StringIO(read_text(table, _TABLE_BYTES)), skipinitialspace=True)
        rows = list(reader)
        header = [name.strip() for name in reader.fieldnames or ()]
    except csv.Error as error:
        raise BadInput.single(str(table), "", f"cannot be read: {error}") from error
    missing = [name for name in COLUMNS if name not in header]
    unknown = [name for name in header if name not in (*COLUMNS, *IMAGE_COLUMNS)]
    if missing or unknown:
        what = f"column {missing[0]} is missing" if missing else f"unknown column {unknown[0]!r}"
        raise BadInput.single(str(table), "", f"{what}; columns: {','.join(COLUMNS)}, optional: left,right")
    problems: list[Problem] = [
        Problem(str(table), f"line {number}", f"has {len(row[None])} cells more than the header: decimal commas?")
        for number, row in enumerate(rows, start=2)
        if None in row
    ]
    names, axes, images = [], [], []
    for number, row in enumerate(rows, start=2):
        name = (row["view"] or "").strip()
        if not name or name in names:
            problems.append(Problem(str(table), f"line {number}", f"view {name!r}: must be given, and unique"))
        names.append(name)
        axes.append([_number(table, number, column, row[column], problems) for column in COLUMNS[1:]])
        left, right = ((row.get(side) or "").strip() or f"{side}/{name}.png" for side in IMAGE_COLUMNS)
        images.append((table.parent / left, table.parent / right))
    paths = [path for pair in images for path in pair]
    problems += [Problem(str(path), "", "no such image") for path in paths if not os.path.isfile(path)]
    if not rows:
        problems.append(Problem(str(table), "", "contains no view"))
    if problems:
        raise BadInput(problems[:1] if len(problems) == 1 else _shortened(problems))
    positions = np.array(axes, dtype=float)
    positions[:, 3:] = np.radians(positions[:, 3:])
    return Views(tuple(names), positions, tuple(images))


def _shortened(problems: list[Problem]) -> list[Problem]:
    if len(problems) <= 5:
        return problems
    last = problems[4]
    return [*problems[:4], Problem(last.source, last.key, f"{last.message} (and {len(problems) - 5} more errors)")]


def _number(table: Path, line: int, column: str, text: str | None, problems: list[Problem]) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        problems.append(Problem(str(table), f"line {line}, {column}", f"{text!r}: must be a finite number"))
    return value


def read_image(path: Path) -> np.ndarray:
    """Return the image at ``path`` in 8-bit grey levels, (h, w); raise BadInput."""
    image = decode_grey(read_bytes(path, IMAGE_BYTES))
    if image is None:
        raise BadInput.single(str(path), "", "not a readable image (PNG, TIFF, BMP, ...)")
    return image


def read_pair(views: Views, index: int, sizes: Array | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return both images of a view; raise BadInput if they are not of ``sizes`` (2, 2), width and height."""
    left, right = (read_image(path) for path in views.images[index])
    for image, path, size in zip((left, right), views.images[index], sizes if sizes is not None else (), strict=False):
        if image.shape[::-1] != tuple(int(x) for x in size):
            actual, expected = f"{image.shape[1]} x {image.shape[0]}", f"{int(size[0])} x {int(size[1])}"
            raise BadInput.single(str(path), "", f"is {actual} px, the others are {expected} px")
    return left, right
