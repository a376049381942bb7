"""JSON messages of a recording with JSON schemas, several per second, for Foxglove."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

STATE_TOPIC, TRANSFORM_TOPIC, LOG_TOPIC, SCENE_TOPIC = "/state", "/tf", "/log", "/scene"

_INFO, _WARNING, _ERROR = 2, 3, 4  # levels of foxglove.Log
_LEVELS: Final = {"alarm": _ERROR, "fault": _ERROR, "order": _WARNING, "setting": _WARNING}


def number(text: str) -> dict[str, Any]:
    return {"type": ["number", "null"], "description": text}


def _three(text: str) -> dict[str, Any]:
    return {"type": "array", "items": {"type": ["number", "null"]}, "description": text}


def table(title: str, properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def schema_of(title: str, example: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of messages with the keys and types of ``example``, which has one item in each list."""
    return {"title": title, **_type_of(example)}


def _type_of(value: Any) -> dict[str, Any]:
    match value:
        case dict():
            return {"type": "object", "properties": {key: _type_of(each) for key, each in value.items()}}
        case list():
            return {"type": "array", "items": _type_of(value[0])}
        case _:
            names = {bool: "boolean", int: "integer", float: "number", str: "string"}
            return {"type": names[type(value)]}


def time_of(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 1_000_000_000, "nsec": time_ns % 1_000_000_000}


TIME: Final = _type_of(time_of(0))
TEXT: Final = {"type": "string"}


def _transform(r: Iterable[float], q: Iterable[float], time_ns: int) -> dict[str, Any]:
    return {
        "timestamp": time_of(time_ns),
        "parent_frame_id": "H",
        "child_frame_id": "chaser",
        "translation": dict(zip("xyz", map(float, r), strict=True)),
        "rotation": dict(zip("xyzw", map(float, q), strict=True)),
    }


SCHEMAS: Final[dict[str, dict[str, Any]]] = {
    STATE_TOPIC: table(
        "hil.State",
        {
            "t_s": number("s, time of the run"),
            "position_m": _three("m, truth, chaser against target, in H"),
            "velocity_mps": _three("m/s, truth, in H"),
            "estimate_m": _three("m, estimated position, in H"),
            "error_mm": _three("mm, estimate minus truth, in H"),
            "sigma_mm": _three("mm, standard deviation of the estimate"),
            "nis_position": number("normalised innovation squared, 3 components"),
            "nis_attitude": number("normalised innovation squared, 3 components"),
            "corridor_margin_m": number("m, of the estimate, negative outside"),
            "closing_margin_mps": number("m/s, allowed minus actual closing rate"),
            "phase": number("number of the phase"),
            "thrusters_on": number("number of thrusters commanded"),
            "rail_m": _three("m, encoders of the rails, in L"),
            "gimbal_deg": _three("deg, encoders of the turntable: roll, pitch, yaw"),
            "lateness_us": number("us, lateness of the cycle's wake-up"),
        },
    ),
    TRANSFORM_TOPIC: schema_of("foxglove.FrameTransform", _transform([0.0] * 3, [0.0] * 4, 0)),
    LOG_TOPIC: table(
        "foxglove.Log",
        {
            "timestamp": TIME,
            "level": {"type": "integer"},
            "message": TEXT,
            "name": TEXT,
            "file": TEXT,
            "line": {"type": "integer"},
            "kind": {"type": "string", "description": "event, alarm, mode, order, setting, operator or fault"},
            "t_s": number("s, time of the run, null before it"),
            "bench_s": number("s, bench time"),
            "cycle": {
                "type": "integer",
                "description": "cycle that it concerns, -1 before the run",
            },
        },
    ),
}


def state(row: np.void) -> dict[str, Any]:
    """Return the state in ``row`` (CYCLE)."""
    truth, estimate, supervision = row["truth"], row["navigation"], row["supervision"]
    return {
        "t_s": finite(row["t_s"]),
        "position_m": _list(truth["r_CT_H"]),
        "velocity_mps": _list(truth["v_CT_H"]),
        "estimate_m": _list(estimate["r_CT_H"]),
        "error_mm": _list(1e3 * (estimate["r_CT_H"] - truth["r_CT_H"])),
        "sigma_mm": _list(1e3 * estimate["sigma_r_m"]),
        "nis_position": finite(estimate["nis_position"]),
        "nis_attitude": finite(estimate["nis_attitude"]),
        "corridor_margin_m": finite(supervision["corridor_margin_m"]),
        "closing_margin_mps": finite(supervision["closing_margin_mps"]),
        "phase": int(row["reference"]["phase"]),
        "thrusters_on": int(row["command"]["on"].sum()),
        "rail_m": _list(row["feedback"]["rail_m"]),
        "gimbal_deg": _list(np.degrees(row["feedback"]["gimbal_rad"])),
        "lateness_us": finite(1e6 * row["lateness_s"]),
    }


def transform(row: np.void, time_ns: int) -> dict[str, Any]:
    """Return the chaser's true pose in H. The rotation takes c to H, as Foxglove's child to parent."""
    return _transform(row["truth"]["r_CT_H"], row["truth"]["q_CH"], time_ns)


def log(entry: np.void, time_ns: int) -> dict[str, Any]:
    """Return ``entry`` (LOG_ENTRY) as a message of a log."""
    kind = text_of(entry["kind"])
    return {
        "timestamp": time_of(time_ns),
        "level": _LEVELS.get(kind, _INFO),
        "message": text_of(entry["text"]),
        "name": text_of(entry["source"]),
        "file": "",
        "line": 0,
        "kind": kind,
        "t_s": finite(entry["t_s"]),
        "bench_s": finite(entry["bench_s"]),
        "cycle": int(entry["cycle"]),
        "number": int(entry["number"]),
        **{name: text_of(entry[name]) for name in ("key", "rights", "configuration", "digest")},
    }


def encoded(message: dict[str, Any]) -> bytes:
    """Return ``message`` as JSON."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()


def finite(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def _list(values: Any) -> list[float | None]:
    return [finite(value) for value in values]


def text_of(text: bytes) -> str:
    return text.decode(errors="replace")
