"""Printed targets: AprilTags and ChArUco boards by their settings, which way they are printed, and their images.

OpenCV's dictionaries have the AprilTags turned by 180 deg against the prints of the AprilTag library, and its ChArUco
boards of an even number of rows began with the other colour before 4.6. The key ``print`` of a geometry file states
which one it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Final, Self, TypeVar

import cv2
import numpy as np
from pydantic import Field, ValidationError, model_validator

from hil.config.tables.model import ConfigModel, Positive
from hil.config.vmu_geometry import LEGACY, OFFICIAL, OPENCV, VmuGeometry
from hil.core.messages import Array
from hil.errors import BadInput, Problem
from hil.vmu.estimators import GEOMETRY, FlatTarget

_Settings = TypeVar("_Settings", bound=ConfigModel)
_Image = np.ndarray

_PICTURE_PX: Final = 2000
_MARKER_PX: Final = 480
_LEAST_CELL_PX: Final = 4
_OFFICIAL_TAG_0: Final = {"16h5": 0x231B, "25h9": 0x155CBF1, "36h10": 0x1CA92A687, "36h11": 0xD5D628584}
"""Cells of tag 0 in the AprilTag library, row by row from the upper left one, 1 for white."""
_TURNS: Final = {OFFICIAL: 0, OPENCV: 2}
"""Quarter turns of a print against the official one, counter-clockwise; OpenCV's of 4.10 to 5.0."""


class AprilTagSettings(ConfigModel):
    """``[vmu.estimator_settings]`` of ``apriltag``."""

    family: Annotated[str, Field(pattern="^(16h5|25h9|36h10|36h11)$")] = "36h11"
    """Family of the tags."""
    tags: Annotated[tuple[tuple[Annotated[int, Field(ge=0)], Positive, float, float], ...], Field(min_length=1)] = (
        (0, 0.2, 0.0, 0.0),
    )
    """Each tag: number, side of the black square, m, x and y of its centre in t, m."""
    corner_px: Positive = 0.1
    """Error of a corner in the image, 1 sigma."""

    @model_validator(mode="after")
    def _tags_can_be_printed(self) -> Self:
        known = len(self.dictionary().bytesList)
        for k, (number, side, x, y) in enumerate(self.tags):
            if number >= known:
                raise ValueError(f"tags: {number}: tags of family {self.family} are 0 to {known - 1}")
            for other, its_side, its_x, its_y in self.tags[:k]:
                if other == number:
                    raise ValueError(f"tags: {number}: is given twice")
                if max(abs(x - its_x), abs(y - its_y)) < 0.5 * (side + its_side):
                    raise ValueError(f"tags: {other} and {number} overlap")
        return self

    def dictionary(self) -> Any:
        """Return OpenCV's dictionary of the family."""
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{self.family.upper()}"))

    def corners(self) -> Array:
        """Return the corners of the black squares in t, (4 n, 3), m: of each clockwise from the upper left one."""
        square = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        places = np.concatenate([np.array([x, y]) + side * square for _, side, x, y in self.tags])
        return np.column_stack([places, np.zeros(len(places))])

    def shift(self, way: str) -> int:
        """Return by how many corners, clockwise, the print ``way`` has OpenCV's first corner of a tag further on."""
        return (self._turns_of_opencv() - _TURNS[way]) % 4

    def marker(self, number: int, way: str, pixels: int) -> _Image:
        """Return tag ``number`` printed the way ``way``, (pixels, pixels), uint8."""
        image = self.dictionary().generateImageMarker(number, pixels)
        return np.ascontiguousarray(np.rot90(image, _TURNS[way] - self._turns_of_opencv()))

    def _turns_of_opencv(self) -> int:
        """Return the quarter turns of the installed OpenCV's tags against the official ones, counter-clockwise."""
        dictionary = self.dictionary()
        n = int(dictionary.markerSize)
        cells = dictionary.generateImageMarker(0, n + 2)[1:-1, 1:-1] > 0
        bits = f"{_OFFICIAL_TAG_0[self.family]:0{n * n}b}"
        official = np.array([bit == "1" for bit in bits]).reshape(n, n)
        return next(k for k in range(4) if (np.rot90(official, k) == cells).all())

    def board(self, way: str) -> FlatTarget:
        """Return the printed target, each tag with a white margin."""
        half = np.abs(self.corners()[:, :2]).max(axis=0) + 0.25 * max(tag[1] for tag in self.tags)
        per_m = _PICTURE_PX / (2.0 * float(half.max()))
        size = [math.ceil(2.0 * float(x) * per_m) for x in half]
        picture: _Image = np.full((size[1], size[0]), 255, np.uint8)
        middle = 0.5 * np.array(size)
        for number, side, x, y in self.tags:
            scale = side * per_m / _MARKER_PX
            centre = middle + per_m * (np.array([x, y]) - 0.5 * side) - 0.5 + 0.5 * scale  # of the first pixel
            to_picture = np.array([[scale, 0.0, centre[0]], [0.0, scale, centre[1]]])
            marker = self.marker(number, way, _MARKER_PX)
            cv2.warpAffine(marker, to_picture, tuple(size), dst=picture, borderMode=cv2.BORDER_TRANSPARENT)
        return FlatTarget(picture, size[0] / per_m, size[1] / per_m)


class CharucoSettings(ConfigModel):
    """``[vmu.estimator_settings]`` of ``charuco``."""

    dictionary: Annotated[str, Field(pattern="^[4-7]X[4-7]_(50|100|250|1000)$")] = "4X4_50"
    """Dictionary of the markers, in OpenCV's notation."""
    columns: Annotated[int, Field(ge=3, le=100)] = 7
    """Squares along x_t."""
    rows: Annotated[int, Field(ge=3, le=100)] = 5
    """Squares along y_t."""
    square_m: Positive = 0.04
    """Side of a square."""
    marker_m: Positive = 0.03
    """Side of a marker, from 0.3 of a square."""
    corner_px: Positive = 0.1
    """Error of a corner in the image, 1 sigma."""

    @model_validator(mode="after")
    def _board_can_be_printed(self) -> Self:
        if not 0.3 * self.square_m <= self.marker_m < self.square_m:
            text = f"must be below square_m, {self.square_m:g}, and at least 0.3 of it"
            raise ValueError(f"marker_m: {self.marker_m:g}: {text}")
        if not hasattr(cv2.aruco, name := f"DICT_{self.dictionary}"):
            raise ValueError(f"dictionary: {self.dictionary}: as many cells along both sides, as 4X4_50")
        known, needed = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList), self.markers
        if needed > known:
            raise ValueError(
                f"columns, rows: {self.columns} x {self.rows} squares have {needed} markers, {self.dictionary} {known}"
            )
        return self

    @property
    def markers(self) -> int:
        """Number of markers."""
        return self.columns * self.rows // 2

    @property
    def ways(self) -> tuple[str, ...]:
        """Ways to print the board that differ."""
        return (OPENCV, LEGACY) if self.rows % 2 == 0 else (OPENCV,)

    def layout(self, way: str) -> Any:
        """Return OpenCV's board, printed the way ``way``."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, dictionary)
        board.setLegacyPattern(way == LEGACY)
        return board

    def corners(self) -> Array:
        """Return the inner corners of the squares in t, (n, 3), m."""
        middle = [0.5 * self.columns * self.square_m, 0.5 * self.rows * self.square_m, 0.0]
        return np.array(self.layout(OPENCV).getChessboardCorners(), float) - middle

    def board(self, way: str) -> FlatTarget:
        """Return the printed target with a white margin."""
        cells = int(self.dictionary[0]) + 2
        least = math.ceil(_LEAST_CELL_PX * cells * self.square_m / self.marker_m)
        side, margin = max(_PICTURE_PX // max(self.columns, self.rows), least), _PICTURE_PX // 20
        picture = np.asarray(self.layout(way).generateImage((self.columns * side, self.rows * side), marginSize=0))
        framed = cv2.copyMakeBorder(picture, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=255)
        per_m = side / self.square_m
        return FlatTarget(framed, framed.shape[1] / per_m, framed.shape[0] / per_m)


def ways_of(geometry: VmuGeometry, allowed: tuple[str, ...], known: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ways in which the target may be printed, the stated one alone. Raises BadInput.

    allowed: those that differ for this target. known: those of its kind.
    """
    way = geometry.print
    if way is None:
        return allowed
    if way not in known:
        raise BadInput.single(GEOMETRY, "print", f'"{way}": allowed for this target: {", ".join(known)}')
    return (way,)


def checked(model: type[_Settings], settings: Mapping[str, Any]) -> _Settings:
    """Return the table ``[vmu.estimator_settings]`` as ``model``. Raises BadInput."""
    try:
        return model.model_validate(dict(settings), strict=False)
    except ValidationError as error:
        raise BadInput([_problem(each) for each in error.errors()]) from error


def _problem(fault: Any) -> Problem:
    """Return a fault of pydantic; the text of a check of several keys begins with them."""
    table, text = "vmu.estimator_settings", fault["msg"].removeprefix("Value error, ")
    if not fault["loc"]:
        key, _, text = text.partition(": ")
        return Problem("rig", f"{table}.{key}", text)
    return Problem("rig", ".".join([table, *map(str, fault["loc"])]), f"{fault['input']}: {text}")
