"""Pictures of a recording, and what is drawn over them, as JSON messages that Foxglove shows by itself."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from hil.core.camera_images import Shape, data_of
from hil.recording.show import TEXT, TIME, encoded, finite, number, table, time_of, word

PICTURE_TOPICS: Final = "/pictures/"
ANNOTATIONS: Final = "/annotations"
"""Ends the topic of what is drawn over a camera's pictures."""

PICTURE_SCHEMA: Final = table(
    "foxglove.CompressedImage",
    {
        "timestamp": TIME,
        "frame_id": TEXT,
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string", "description": "jpeg or png"},
        "t_s": number("s, exposure, time of the run; null before it and while it is held"),
        "bench_s": number("s, exposure, bench time; null where only the run's time is known"),
        "number": {"type": "integer", "description": "of the exposure; pictures of one exposure share it"},
        "left_out": {"type": "integer", "description": "pictures of this camera so far that its maker left out"},
        "status": {"type": "string", "description": "what the unit or monitor said of it"},
        "width_px": {"type": "integer"},
        "height_px": {"type": "integer"},
    },
)

_POINT: Final = table("point", {axis: {"type": "number"} for axis in "xy"})
_COLOUR: Final = table("colour", {part: {"type": "number"} for part in "rgba"})
ANNOTATION_SCHEMA: Final = table(
    "foxglove.ImageAnnotations",
    {
        "circles": {
            "type": "array",
            "items": table(
                "circle",
                {
                    "timestamp": TIME,
                    "position": _POINT,
                    "diameter": {"type": "number"},
                    "thickness": {"type": "number"},
                    "fill_color": _COLOUR,
                    "outline_color": _COLOUR,
                },
            ),
        },
        "points": {
            "type": "array",
            "items": table(
                "points",
                {
                    "timestamp": TIME,
                    "type": {"type": "integer"},
                    "points": {"type": "array", "items": _POINT},
                    "outline_color": _COLOUR,
                    "outline_colors": {"type": "array", "items": _COLOUR},
                    "fill_color": _COLOUR,
                    "thickness": {"type": "number"},
                },
            ),
        },
        "texts": {
            "type": "array",
            "items": table(
                "text",
                {
                    "timestamp": TIME,
                    "position": _POINT,
                    "text": TEXT,
                    "font_size": {"type": "number"},
                    "text_color": _COLOUR,
                    "background_color": _COLOUR,
                },
            ),
        },
    },
)

_LINE_LIST: Final = 4  # of foxglove.PointsAnnotation: each two points a line
_CROSS_ARM_PX: Final = 5.0
_GOOD, _BAD, _CLEAR = (
    dict(zip("rgba", colour, strict=True))
    for colour in ((0.34, 0.71, 0.91, 1.0), (0.90, 0.62, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0))
)  # the first two as on the console's page


def picture(row: np.void, time_ns: int) -> bytes:
    """Return the picture of ``row`` (PICTURE) as JSON for ``PICTURE_TOPICS + camera``."""
    told = {
        "timestamp": time_of(time_ns),
        "frame_id": word(row["camera"]),
        "format": word(row["encoding"]),
        "t_s": finite(row["t_s"]),
        "bench_s": finite(row["bench_s"]),
        "number": int(row["number"]),
        "left_out": int(row["left_out"]),
        "status": word(row["status"]),
        "width_px": int(row["width_px"]),
        "height_px": int(row["height_px"]),
    }
    # put in as it is: a search for characters to escape would take longer than all the rest
    return b"".join((encoded(told)[:-1], b',"data":"', base64.b64encode(data_of(row)), b'"}'))


def drawn(shapes: Sequence[Shape], time_ns: int) -> dict[str, Any]:
    """Return what is drawn over a picture for ``PICTURE_TOPICS + camera + ANNOTATIONS``."""
    when = time_of(time_ns)
    circles: list[dict[str, Any]] = []
    texts: list[dict[str, Any]] = []
    ends: dict[bool, list[dict[str, float]]] = {True: [], False: []}
    for shape in shapes:
        good = bool(shape.get("good"))
        match shape["kind"]:
            case "circle":
                circles.append(_circle(shape, when, _GOOD if good else _BAD))
            case "text":
                texts.append(_text(shape, when, _GOOD if good else _BAD))
            case "line":
                ends[good] += [_point(*shape["from"]), _point(*shape["to"])]
            case "cross":
                u, v = shape["at"]
                arm = _CROSS_ARM_PX
                ends[good] += [_point(u - arm, v), _point(u + arm, v), _point(u, v - arm), _point(u, v + arm)]
    return {
        "circles": circles,
        "points": [_lines(found, when, _GOOD if good else _BAD) for good, found in ends.items() if found],
        "texts": texts,
    }


def _circle(shape: Shape, when: dict[str, int], colour: dict[str, float]) -> dict[str, Any]:
    return {
        "timestamp": when,
        "position": _point(*shape["at"]),
        "diameter": 2.0 * float(shape["radius"]),
        "thickness": 1.0,
        "fill_color": _CLEAR,
        "outline_color": colour,
    }


def _text(shape: Shape, when: dict[str, int], colour: dict[str, float]) -> dict[str, Any]:
    return {
        "timestamp": when,
        "position": _point(*shape["at"]),
        "text": shape["text"],
        "font_size": 12.0,
        "text_color": colour,
        "background_color": _CLEAR,
    }


def _lines(ends: list[dict[str, float]], when: dict[str, int], colour: dict[str, float]) -> dict[str, Any]:
    return {
        "timestamp": when,
        "type": _LINE_LIST,
        "points": ends,
        "outline_color": colour,
        "outline_colors": [],
        "fill_color": _CLEAR,
        "thickness": 1.0,
    }


def _point(u: float, v: float) -> dict[str, float]:
    return {"x": float(u), "y": float(v)}
