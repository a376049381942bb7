"""Folders of views: images of one camera or of a pair by any names, and ``views.csv`` with positions of the bench."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from hil.core.csv_table import read_csv
from hil.core.files import MIB, read_bytes
from hil.core.image_files import IMAGE_BYTES, IMAGE_SUFFIXES, decode_grey, depth_note
from hil.core.messages import Array
from hil.errors import BadInput, Problem

COLUMNS: Final = ("view", "rail_x_m", "rail_y_m", "rail_z_m", "roll_deg", "pitch_deg", "yaw_deg")
_TABLE_BYTES: Final = 4 * MIB
IMAGE_COLUMNS: Final = ("left", "right")
_LONGEST_M: Final = 100.0
_SIDE: Final = re.compile(r"(left|right|(?:^|(?<=[_\-. ]))(?:l|r|cam_?[01])(?=$|[_\-. ]))", re.IGNORECASE)
_SIDES: Final = {"left": 0, "l": 0, "cam0": 0, "right": 1, "r": 1, "cam1": 1}
"""Names of the cameras in the names of folders and files."""
_NUMBER: Final = re.compile(r"(\d+)\D*$")


@dataclass(frozen=True, slots=True)
class Views:
    """names: of the views. axes: (n, 6), rails, m, gimbals, rad. images: the paths of the left and the right image.

    unused: names of images that belong to no view, with the reason.
    """

    names: tuple[str, ...]
    axes: Array
    images: tuple[tuple[Path, Path], ...]
    unused: Mapping[str, str] = field(default_factory=dict)


def images_of(folder: Path) -> tuple[Path, ...]:
    """Return the images in ``folder``, in the order of their names; none without such a folder."""
    paths = folder.iterdir() if folder.is_dir() else ()
    return tuple(
        sorted(path for path in paths if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith("."))
    )


def sides_of(folder: Path) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Return the images of the left and of the right camera of ``folder``.

    They are in folders of their own, ``left`` and ``right``, or have these words in their names; ``l`` and ``r``,
    ``cam0`` and ``cam1`` are read too.
    """
    sides: tuple[list[Path], list[Path]] = [], []
    inner = sorted(path for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
    for path in inner:
        if _SIDE.fullmatch(path.name):
            sides[_side_of(path.name)].extend(images_of(path))
    if not any(sides):
        for path in images_of(folder):
            if _SIDE.search(path.stem):
                sides[_side_of(path.stem)].append(path)
    return tuple(sides[0]), tuple(sides[1])


def _side_of(name: str) -> int:
    match = _SIDE.search(name)
    assert match is not None
    return _SIDES[match[1].lower().replace("_", "")]


def read_pairs(folder: Path) -> Views:
    """Return the pairs of images in ``folder``: of the same name, else of the same number at its end."""
    sides = sides_of(folder)
    views = max((_paired(sides, key) for key in (_name_key, _number_key)), key=lambda views: len(views.names))
    loose = {} if any(sides) else {path.name: "neither left nor right by its folder or name"
                                   for path in images_of(folder)}  # fmt: skip
    return Views(views.names, views.axes, views.images, {**views.unused, **loose})


def _name_key(path: Path) -> str:
    return _SIDE.sub("", path.stem).lower()


def _number_key(path: Path) -> str:
    match = _NUMBER.search(path.stem)
    return "" if match is None else str(int(match[1]))


def _paired(sides: tuple[tuple[Path, ...], ...], key: Callable[[Path], str]) -> Views:
    """Return the pairs of equal ``key``; a key of several images of a camera is that of none."""
    tables = []
    for paths in sides:
        keys = [key(path) for path in paths]
        tables.append({k: path for k, path in zip(keys, paths, strict=True) if k and keys.count(k) == 1})
    common = [k for k in tables[0] if k in tables[1]]
    images = tuple((tables[0][k], tables[1][k]) for k in common)
    used = {path for pair in images for path in pair}
    unused = {f"{path.parent.name}/{path.name}": "has no image of the other camera"
              for paths in sides for path in paths if path not in used}  # fmt: skip
    return Views(tuple(left.name for left, _ in images), np.zeros((len(images), 6)), images, unused)


def read_views(source: Path) -> Views:
    """Return the views of the folder ``source``, or of the CSV file ``source``; raise BadInput.

    Columns: COLUMNS, and ``left`` and ``right`` if the images are not ``left/VIEW.png`` and ``right/VIEW.png``, or of
    another suffix.
    """
    path = source / "views.csv" if source.is_dir() else source
    table = read_csv(path, _TABLE_BYTES, COLUMNS, IMAGE_COLUMNS, "view")
    names: list[str] = []
    axes, images = [], []
    stored = {f"{side}/{image.stem}": image for side in IMAGE_COLUMNS for image in images_of(path.parent / side)}
    for line, row in table.rows:
        name = row["view"]
        if not name or name in names:
            table.note(f"line {line}", f"view {name!r}: must be given, and unique")
        names.append(name)
        axes.append([table.number(line, column, row[column]) for column in COLUMNS[1:]])
        for column, value in zip(COLUMNS[1:4], axes[-1], strict=False):
            if abs(value) > _LONGEST_M:
                table.note(f"line {line}", f"{column} {value:g}: allowed {_LONGEST_M:g} m: millimetres?")
        left, right = (
            path.parent / row[side]
            if row.get(side)
            else stored.get(f"{side}/{name}", path.parent / side / f"{name}.png")
            for side in IMAGE_COLUMNS
        )
        images.append((left, right))
    missing = [image for pair in images for image in pair if not os.path.isfile(image)]
    table.problems += [Problem(str(image), "", "no such image") for image in missing]
    table.check()
    positions = np.array(axes, dtype=float)
    positions[:, 3:] = np.radians(positions[:, 3:])
    named = {image for pair in images for image in pair}
    unused = {key: f"no view of {path.name}" for key, image in stored.items() if image not in named}
    return Views(tuple(names), positions, tuple(images), unused)


def what_was_read(images: Sequence[Path]) -> str:
    """Return number, size and depth of ``images`` by the first of them. Raises BadInput."""
    if not images:
        return "no images"
    height, width = read_image(images[0]).shape
    depth = depth_note(read_bytes(images[0], IMAGE_BYTES))
    return f"{len(images)} images of {width} x {height} px, {depth or '8 bits'}"


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
