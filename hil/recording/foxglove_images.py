"""Images of a recording and their overlays as JSON messages for Foxglove."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from hil.core.camera_images import Shape, image_data
from hil.recording.foxglove import TEXT, TIME, encoded, finite, number, schema_of, table, text_of, time_of

PICTURE_TOPICS: Final = "/pictures/"
ANNOTATIONS: Final = "/annotations"
"""End of the topic of the overlays of a camera."""

PICTURE_SCHEMA: Final = table(
    "foxglove.CompressedImage",
    {
        "timestamp": TIME,
        "frame_id": TEXT,
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string", "description": "jpeg or png"},
        "t_s": number("s, exposure, time of the run; null before it and while it is held"),
        "bench_s": number("s, exposure, bench time; null if only the run's time is known"),
        "number": {"type": "integer", "description": "of the exposure; images of one exposure have the same"},
        "left_out": {"type": "integer", "description": "images of this camera that its source has dropped so far"},
        "status": {"type": "string", "description": "result of the vision unit or docking monitor"},
        "width_px": {"type": "integer"},
        "height_px": {"type": "integer"},
    },
)

_LINE_LIST: Final = 4  # of foxglove.PointsAnnotation: each two points a line
_CROSS_ARM_PX: Final = 5.0
_GOOD, _BAD, _CLEAR = (
    dict(zip("rgba", colour, strict=True))
    for colour in ((0.34, 0.71, 0.91, 1.0), (0.90, 0.62, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0))
)  # the first two as on the console's page


def image(row: np.void, time_ns: int) -> bytes:
    """Return the image of ``row`` (IMAGE) as JSON for ``PICTURE_TOPICS + camera``."""
    content = {
        "timestamp": time_of(time_ns),
        "frame_id": text_of(row["camera"]),
        "format": text_of(row["encoding"]),
        "t_s": finite(row["t_s"]),
        "bench_s": finite(row["bench_s"]),
        "number": int(row["number"]),
        "left_out": int(row["dropped"]),
        "status": text_of(row["status"]),
        "width_px": int(row["width_px"]),
        "height_px": int(row["height_px"]),
    }
    # inserted without the search for characters to escape, which would take longer than all the rest
    return b"".join((encoded(content)[:-1], b',"data":"', base64.b64encode(image_data(row)), b'"}'))


def overlay(shapes: Sequence[Shape], time_ns: int) -> dict[str, Any]:
    """Return the overlay of an image for ``PICTURE_TOPICS + camera + ANNOTATIONS``."""
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
        "points": [_lines(points, when, _GOOD if good else _BAD) for good, points in ends.items() if points],
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


def _example() -> dict[str, Any]:
    """Return an overlay with one item in each of its lists."""
    circle, text = {"kind": "circle", "at": (0, 0), "radius": 1}, {"kind": "text", "at": (0, 0), "text": ""}
    example = overlay([circle, text, {"kind": "cross", "at": (0, 0)}], 0)
    example["points"][0]["outline_colors"] = [_GOOD]
    return example


ANNOTATION_SCHEMA: Final = schema_of("foxglove.ImageAnnotations", _example())
