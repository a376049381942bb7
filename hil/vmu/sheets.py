"""Sheets of targets to print at full scale, SVG in millimetres: AprilTags, ChArUco boards, drilling plan of LEDs.

The origin of t is the centre, x_t to the right, y_t down, z_t into the sheet; each sheet has a mark of this orientation
and a scale to measure.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from hil.config.rig import Vmu
from hil.config.vmu_geometry import OFFICIAL, OPENCV
from hil.errors import BadInput

_FOOT_MM: Final = 26.0
_MARGIN_MM: Final = 12.0
_SCALE_MM: Final = 100.0
_LED_MM, _CROSS_MM = 5.0, 9.0


def sheet(vmu: Vmu) -> tuple[str, str | None]:
    """Return the sheet of the target of ``vmu``, and the key ``print`` of its geometry file, None for LEDs.

    Raises BadInput for an estimator of another package, and for a target that cannot be printed.
    """
    if vmu.estimator == "led_ring":
        points = 1e3 * np.array(vmu.leds_m)
        return _svg(_leds(points), np.abs(points[:, :2]).max(axis=0) + _CROSS_MM, "LEDs in t, mm"), None
    from hil.vmu.prints import AprilTagSettings, CharucoSettings, checked

    if vmu.estimator == "apriltag":
        tags = checked(AprilTagSettings, vmu.estimator_settings)
        half = 1e3 * (np.abs(tags.corners()[:, :2]).max(axis=0) + 0.25 * max(tag[1] for tag in tags.tags))
        return _svg(_tags(tags), half, f'AprilTags {tags.family}, print = "{OFFICIAL}"'), OFFICIAL
    if vmu.estimator == "charuco":
        board = checked(CharucoSettings, vmu.estimator_settings)
        half = 500.0 * board.square_m * np.array([board.columns, board.rows])
        return _svg(_charuco(board), half, f'ChArUco {board.dictionary}, print = "{OPENCV}"'), OPENCV
    text = f'"{vmu.estimator}": its target is not known here, allowed led_ring, apriltag, charuco'
    raise BadInput.single("rig", "vmu.estimator", text)


def _tags(settings: object) -> Iterator[str]:
    from hil.vmu.prints import AprilTagSettings

    assert isinstance(settings, AprilTagSettings)
    cells = int(settings.dictionary().markerSize) + 2
    for number, side, x, y in settings.tags:
        corner = 1e3 * (np.array([x, y]) - 0.5 * side)
        yield from _cells(settings.marker(number, OFFICIAL, cells), corner, 1e3 * side)
        yield _text(corner[0], corner[1] + 1e3 * side + 4.0, f"tag {number}, {1e3 * side:g} mm")


def _charuco(settings: object) -> Iterator[str]:
    from hil.vmu.prints import CharucoSettings

    assert isinstance(settings, CharucoSettings)
    layout, cells = settings.layout(OPENCV), int(settings.dictionary[0]) + 2
    square, zero = 1e3 * settings.square_m, -500.0 * settings.square_m * np.array([settings.columns, settings.rows])
    first = [1e3 * np.asarray(points)[:, :2].min(axis=0) for points in layout.getObjPoints()]
    white = {tuple((corner // square).astype(int)) for corner in first}
    for column in range(settings.columns):
        for row in range(settings.rows):
            if (column, row) not in white:
                yield _rectangle(zero[0] + column * square, zero[1] + row * square, square, square, "black")
    dictionary = layout.getDictionary()
    for number, corner in zip(np.ravel(layout.getIds()), first, strict=True):
        yield from _cells(dictionary.generateImageMarker(int(number), cells), zero + corner, 1e3 * settings.marker_m)


def _leds(points: np.ndarray) -> Iterator[str]:
    for number, (x, y, z) in enumerate(points):
        yield f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{_LED_MM / 2:g}" fill="none" stroke="black" stroke-width="0.2"/>'
        for dx, dy in ((_CROSS_MM / 2, 0.0), (0.0, _CROSS_MM / 2)):
            yield _line(x - dx, y - dy, x + dx, y + dy)
        yield _text(x + 4.0, y - 2.0, f"{number}: {x:.2f} {y:.2f} {z:.2f}")


def _cells(image: np.ndarray, corner: Sequence[float] | np.ndarray, side: float) -> Iterator[str]:
    """Yield a marker whose upper left corner is at ``corner``, mm; image: a pixel for each cell."""
    yield _rectangle(corner[0], corner[1], side, side, "black")
    step = side / len(image)
    for row, column in np.argwhere(image > 0):
        yield _rectangle(corner[0] + column * step, corner[1] + row * step, step, step, "white")


def _svg(content: Iterator[str], half: np.ndarray, caption: str) -> str:
    """Return the sheet with ``content`` of half width and height ``half``, mm, the mark, a scale and ``caption``."""
    width, height = 2.0 * np.maximum(half + _MARGIN_MM, [0.5 * _SCALE_MM + 30.0, 0.0])
    left, top, foot = -0.5 * width, -0.5 * height, 0.5 * height + 6.0
    mark = left + 8.0
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height + _FOOT_MM:g}mm" '
        f'viewBox="{left:g} {top:g} {width:g} {height + _FOOT_MM:g}" shape-rendering="crispEdges">',
        _rectangle(left, top, width, height + _FOOT_MM, "white"),
        *content,
        f'<path d="M {mark:g} {foot:g} l -3 8 l 6 0 z" fill="black"/>',
        _text(mark + 5.0, foot + 3.0, "up: x_t to the right, y_t down, z_t into the sheet"),
        _text(mark + 5.0, foot + 7.0, caption),
        _line(mark - 3.0, foot + 13.0, mark - 3.0 + _SCALE_MM, foot + 13.0),
        *(_line(x, foot + 11.0, x, foot + 15.0) for x in (mark - 3.0, mark - 3.0 + _SCALE_MM)),
        _text(mark - 2.0, foot + 17.5, f"{_SCALE_MM:g} mm: measure it, and print at 100 %"),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _rectangle(x: float, y: float, width: float, height: float, fill: str) -> str:
    return f'<rect x="{x:.4f}" y="{y:.4f}" width="{width:.4f}" height="{height:.4f}" fill="{fill}"/>'


def _line(x: float, y: float, to_x: float, to_y: float) -> str:
    return f'<path d="M {x:.3f} {y:.3f} L {to_x:.3f} {to_y:.3f}" stroke="black" stroke-width="0.2"/>'


def _text(x: float, y: float, text: str) -> str:
    shown = text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    return f'<text x="{x:.3f}" y="{y:.3f}" font-family="sans-serif" font-size="3">{shown}</text>'
