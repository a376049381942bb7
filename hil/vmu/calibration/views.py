"""Folder of views: ``views.csv`` with the positions of the bench, ``left/`` and ``right/`` with the images."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hil.core.csv_table import read_csv
from hil.core.files import MIB, read_bytes
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
    path = source / "views.csv" if source.is_dir() else source
    table = read_csv(path, _TABLE_BYTES, COLUMNS, IMAGE_COLUMNS, "view")
    names: list[str] = []
    axes, images = [], []
    for line, row in table.rows:
        name = row["view"]
        if not name or name in names:
            table.note(f"line {line}", f"view {name!r}: must be given, and unique")
        names.append(name)
        axes.append([table.number(line, column, row[column]) for column in COLUMNS[1:]])
        left, right = (row.get(side) or f"{side}/{name}.png" for side in IMAGE_COLUMNS)
        images.append((path.parent / left, path.parent / right))
    missing = [image for pair in images for image in pair if not os.path.isfile(image)]
    table.problems += [Problem(str(image), "", "no such image") for image in missing]
    table.check()
    positions = np.array(axes, dtype=float)
    positions[:, 3:] = np.radians(positions[:, 3:])
    return Views(tuple(names), positions, tuple(images))


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
