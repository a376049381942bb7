"""The part of a recording that Foxglove shows by itself: JSON messages, a few each second, with JSON schemas."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from hil.pictures import Shape, data_of

STATE_TOPIC, TRANSFORM_TOPIC, LOG_TOPIC = "/state", "/tf", "/log"
PICTURE_TOPICS: Final = "/pictures/"
ANNOTATIONS: Final = "/annotations"
"""Ends the topic of what is drawn over a camera's pictures."""

_INFO, _WARNING, _ERROR = 2, 3, 4  # levels of foxglove.Log
_LEVELS: Final = {"alarm": _ERROR, "fault": _ERROR, "order": _WARNING, "setting": _WARNING}


def _number(text: str) -> dict[str, Any]:
    return {"type": ["number", "null"], "description": text}


def _three(text: str) -> dict[str, Any]:
    return {"type": "array", "items": {"type": ["number", "null"]}, "description": text}


def _object(title: str, properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


_TIME: Final = _object("time", {"sec": {"type": "integer"}, "nsec": {"type": "integer"}})
_XYZ: Final = _object("vector", {axis: {"type": "number"} for axis in "xyz"})
_XYZW: Final = _object("quaternion", {axis: {"type": "number"} for axis in "xyzw"})
_TEXT: Final = {"type": "string"}

SCHEMAS: Final[dict[str, dict[str, Any]]] = {
    STATE_TOPIC: _object(
        "hil.State",
        {
            "t_s": _number("s, time of the run"),
            "position_m": _three("m, truth, chaser against target, in H"),
            "velocity_mps": _three("m/s, truth, in H"),
            "estimate_m": _three("m, estimated position, in H"),
            "error_mm": _three("mm, estimate minus truth, in H"),
            "sigma_mm": _three("mm, standard deviation of the estimate"),
            "nis_position": _number("normalised innovation squared, 3 components"),
            "nis_attitude": _number("normalised innovation squared, 3 components"),
            "corridor_margin_m": _number("m, of the estimate, negative outside"),
            "closing_margin_mps": _number("m/s, allowed minus actual closing rate"),
            "phase": _number("number of the phase"),
            "thrusters_on": _number("how many thrusters are commanded"),
            "rail_m": _three("m, encoders of the rails, in L"),
            "gimbal_deg": _three("deg, encoders of the turntable: roll, pitch, yaw"),
            "lateness_us": _number("us, how late the cycle woke up"),
        },
    ),
    TRANSFORM_TOPIC: _object(
        "foxglove.FrameTransform",
        {
            "timestamp": _TIME,
            "parent_frame_id": _TEXT,
            "child_frame_id": _TEXT,
            "translation": _XYZ,
            "rotation": _XYZW,
        },
    ),
    LOG_TOPIC: _object(
        "foxglove.Log",
        {
            "timestamp": _TIME,
            "level": {"type": "integer"},
            "message": _TEXT,
            "name": _TEXT,
            "file": _TEXT,
            "line": {"type": "integer"},
            "kind": {"type": "string", "description": "event, alarm, mode, order, setting, operator or fault"},
            "t_s": _number("s, time of the run, null before it"),
            "bench_s": _number("s, bench time"),
            "cycle": {"type": "integer", "description": "cycle that it acts on or fell into, -1 before the run"},
        },
    ),
}

PICTURE_SCHEMA: Final = _object(
    "foxglove.CompressedImage",
    {
        "timestamp": _TIME,
        "frame_id": _TEXT,
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string", "description": "jpeg or png"},
        "t_s": _number("s, exposure, time of the run; null before it and while it is held"),
        "bench_s": _number("s, exposure, bench time; null where only the run's time is known"),
        "number": {"type": "integer", "description": "of the exposure; pictures of one exposure share it"},
        "left_out": {"type": "integer", "description": "pictures of this camera so far that its maker left out"},
        "status": {"type": "string", "description": "what the unit or monitor said of it"},
        "width_px": {"type": "integer"},
        "height_px": {"type": "integer"},
    },
)

_POINT: Final = _object("point", {axis: {"type": "number"} for axis in "xy"})
_COLOUR: Final = _object("colour", {part: {"type": "number"} for part in "rgba"})
ANNOTATION_SCHEMA: Final = _object(
    "foxglove.ImageAnnotations",
    {
        "circles": {
            "type": "array",
            "items": _object(
                "circle",
                {
                    "timestamp": _TIME,
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
            "items": _object(
                "points",
                {
                    "timestamp": _TIME,
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
            "items": _object(
                "text",
                {
                    "timestamp": _TIME,
                    "position": _POINT,
                    "text": _TEXT,
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


def state(row: np.void) -> dict[str, Any]:
    """Return what ``row`` (CYCLE) shows of itself."""
    truth, estimate, found = row["truth"], row["navigation"], row["supervision"]
    return {
        "t_s": _finite(row["t_s"]),
        "position_m": _list(truth["r_CT_H"]),
        "velocity_mps": _list(truth["v_CT_H"]),
        "estimate_m": _list(estimate["r_CT_H"]),
        "error_mm": _list(1e3 * (estimate["r_CT_H"] - truth["r_CT_H"])),
        "sigma_mm": _list(1e3 * estimate["sigma_r_m"]),
        "nis_position": _finite(estimate["nis_position"]),
        "nis_attitude": _finite(estimate["nis_attitude"]),
        "corridor_margin_m": _finite(found["corridor_margin_m"]),
        "closing_margin_mps": _finite(found["closing_margin_mps"]),
        "phase": int(row["reference"]["phase"]),
        "thrusters_on": int(row["command"]["on"].sum()),
        "rail_m": _list(row["feedback"]["rail_m"]),
        "gimbal_deg": _list(np.degrees(row["feedback"]["gimbal_rad"])),
        "lateness_us": _finite(1e6 * row["lateness_s"]),
    }


def transform(row: np.void, time_ns: int) -> dict[str, Any]:
    """Return where the chaser truly is in H. The rotation takes c to H, as Foxglove's child to parent."""
    r, q = row["truth"]["r_CT_H"], row["truth"]["q_CH"]
    return {
        "timestamp": _time(time_ns),
        "parent_frame_id": "H",
        "child_frame_id": "chaser",
        "translation": dict(zip("xyz", map(float, r), strict=True)),
        "rotation": dict(zip("xyzw", map(float, q), strict=True)),
    }


def log(note: np.void, time_ns: int) -> dict[str, Any]:
    """Return ``note`` (NOTE) as a line of a log."""
    kind = _word(note["kind"])
    return {
        "timestamp": _time(time_ns),
        "level": _LEVELS.get(kind, _INFO),
        "message": _word(note["text"]),
        "name": _word(note["source"]),
        "file": "",
        "line": 0,
        "kind": kind,
        "t_s": _finite(note["t_s"]),
        "bench_s": _finite(note["bench_s"]),
        "cycle": int(note["cycle"]),
    }


def picture(row: np.void, time_ns: int) -> dict[str, Any]:
    """Return the picture of ``row`` (PICTURE) for ``PICTURE_TOPICS + camera``."""
    return {
        "timestamp": _time(time_ns),
        "frame_id": _word(row["camera"]),
        "data": base64.b64encode(data_of(row)).decode(),
        "format": _word(row["encoding"]),
        "t_s": _finite(row["t_s"]),
        "bench_s": _finite(row["bench_s"]),
        "number": int(row["number"]),
        "left_out": int(row["left_out"]),
        "status": _word(row["status"]),
        "width_px": int(row["width_px"]),
        "height_px": int(row["height_px"]),
    }


def drawn(shapes: Sequence[Shape], time_ns: int) -> dict[str, Any]:
    """Return what is drawn over a picture for ``PICTURE_TOPICS + camera + ANNOTATIONS``."""
    when = _time(time_ns)
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


def encoded(message: dict[str, Any]) -> bytes:
    """Return ``message`` as JSON."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()


def _finite(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def _list(values: Any) -> list[float | None]:
    return [_finite(value) for value in values]


def _word(text: bytes) -> str:
    return text.decode(errors="replace")


def _time(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 1_000_000_000, "nsec": time_ns % 1_000_000_000}
