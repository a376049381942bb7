"""Files of a calibration: geometry file (written and read) and rig file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hil.config.camera_identity import CameraIdentity
from hil.config.vmu_geometry import Sensor, VmuGeometry
from hil.core.messages import Array
from hil.errors import BadInput
from hil.vmu.calibration.model import SIDES, Setup, TurntableModel, camera_of, lens_numbers, parameters
from hil.vmu.calibration.refine import RefinementFit
from hil.vmu.geometry import EXACT
from hil.vmu.kernels.chain import (
    BASELINE,
    CAMERA_POSITION,
    CAMERA_ROTATION,
    COMMON,
    ROTATION,
    SCALE,
    TARGET_POSITION,
    TARGET_ROTATION,
)

_ORDER = "xyz"
HAND_HELD: Final = "hand-held"
"""First word of a calibration's target: it has no positions of a bench."""
MOST_LEDS: Final = 8
"""of a geometry file; a target with more points is a board"""


@dataclass(frozen=True, slots=True)
class Label:
    """Name of a calibration, its date, and its target (``leds``, ``board 11x8 30 mm``)."""

    id: str
    date: str
    target: str


def geometry_table(
    label: Label,
    fit: RefinementFit,
    turntable: TurntableModel,
    axis_sigma: Array,
    nominal: VmuGeometry,
    views: int,
    identities: Mapping[str, CameraIdentity | None] = {},
) -> dict[str, Any]:
    """Return the keys of the geometry file, including ``[calibration]``. identities: of the cameras of the views."""
    setup = fit.setup
    on_leds = label.target.endswith("leds")
    table: dict[str, Any] = {
        "leds_m": setup.points.tolist() if on_leds else [list(led) for led in nominal.leds_m],
        "baseline_m": setup.theta[BASELINE:CAMERA_ROTATION].tolist(),
        "right_rotation_rad": setup.theta[ROTATION:BASELINE].tolist(),
    }
    if nominal.marked_led is not None:
        table["marked_led"] = nominal.marked_led
    if nominal.print is not None:
        table["print"] = nominal.print
    for side, name in enumerate(SIDES):
        table[name] = camera_of(setup.theta, side, setup.sizes[side])
        if (row_time_s := getattr(nominal, name).row_time_s) is not None:
            table[name]["row_time_s"] = row_time_s
        if (identity := identities.get(name)) is not None:
            table[name]["identity"] = identity.model_dump(exclude_none=True)
    if nominal.sensor is not None:
        table["sensor"] = nominal.sensor.model_dump()
    if nominal.tolerances != EXACT:
        table["tolerances"] = nominal.tolerances.model_dump()
    table["calibration"] = {
        "id": label.id,
        "date": label.date,
        "target": label.target,
        "views": views,
        "rms_px": fit.rms_px,
        "noise": fit.noise,
        "rail_sigma_m": float(axis_sigma[0]),
        "gimbal_sigma_deg": math.degrees(float(axis_sigma[3])),
        "lever_arm_m": turntable.lever_arm.tolist(),
        "gimbal_order": "".join(_ORDER[k] for k in turntable.order),
        **mounting_keys(setup),
        "target_position_m": setup.theta[TARGET_POSITION:SCALE].tolist(),
        "target_axes": setup.target_axes.T.tolist(),
        "sigma": {
            f"{p.name}_{p.unit}" if p.unit else p.name: float(s * p.shown)
            for p, s in zip(parameters((len(fit.covariance) - COMMON) // 3), fit.sigma, strict=True)
            if s > 0.0
        },
        "covariance": [row[: k + 1].tolist() for k, row in enumerate(fit.covariance)],
    }
    return table


def mounting_keys(setup: Setup) -> dict[str, Any]:
    """Return the keys of a rig file's ``[bench]`` for the mounting of the left camera."""
    return {
        "camera_position_m": setup.theta[CAMERA_POSITION:TARGET_ROTATION].tolist(),
        "camera_axes": setup.camera_axes.tolist(),
    }


def rig_table(setup: Setup, on_leds: bool) -> dict[str, Any]:
    """Return the keys for a rig file: mounting of the cameras, and of the LED ring if it was the target."""
    bench = mounting_keys(setup)
    if not on_leds:
        return {"bench": bench}
    bench |= {
        "led_ring_position_m": setup.theta[TARGET_POSITION:SCALE].tolist(),
        "led_ring_axes": setup.target_axes.T.tolist(),
    }
    return {"bench": bench, "vmu": {"leds_m": setup.points.tolist()}}


def as_toml(table: Mapping[str, Any], comment: str) -> str:
    """Return ``table`` as TOML: values first, then its tables; nested lists one row per line."""
    lines = [f"# {line}" for line in comment.splitlines()]
    _write(table, "", lines)
    return "\n".join(lines) + "\n"


def _write(table: Mapping[str, Any], prefix: str, lines: list[str]) -> None:
    if prefix:
        lines += ["", f"[{prefix}]"]
    for key, value in table.items():
        if not isinstance(value, Mapping):
            lines.append(f"{_key(key)} = {_value(value)}")
    for key, value in table.items():
        if isinstance(value, Mapping):
            _write(value, f"{prefix}.{_key(key)}" if prefix else _key(key), lines)


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        inner = [_value(item) for item in value]
        if value and isinstance(value[0], (list, tuple)):
            return "[\n" + "".join(f"    {item},\n" for item in inner) + "]"
        return "[" + ", ".join(inner) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value)


@dataclass(frozen=True, slots=True)
class StoredCalibration:
    """A calibration read from a file. covariance: of COMMON, or COMMON + 3 m. noise: of the pixels."""

    label: Label
    setup: Setup
    turntable: TurntableModel
    covariance: Array
    noise: float
    axis_sigma: Array
    sensor: Sensor | None = None


def read_back(geometry: VmuGeometry, source: str) -> StoredCalibration:
    """Return the calibration in a geometry file; raise BadInput if it has none."""
    calibration = geometry.calibration
    if calibration is None:
        raise BadInput.single(source, "calibration", "is missing: a file written by hil calibrate is required")
    if calibration.target.startswith(HAND_HELD):
        text = f'"{calibration.target}": has no bench positions to compare with; calibrate with views at given ones'
        raise BadInput.single(source, "calibration.target", text)
    n = len(calibration.covariance)
    if n not in (COMMON, COMMON + 3 * len(geometry.leds_m)):
        allowed = f"{COMMON} rows, or {COMMON + 3 * len(geometry.leds_m)} with the layout of the LEDs"
        raise BadInput.single(source, "calibration.covariance", f"{n} rows, allowed {allowed}")
    covariance = np.zeros((n, n))
    for k, row in enumerate(calibration.covariance):
        covariance[k, : k + 1] = row
        covariance[: k + 1, k] = row
    theta = np.zeros(COMMON)
    theta[0:9], theta[9:18] = lens_numbers(geometry.left), lens_numbers(geometry.right)
    theta[ROTATION:BASELINE], theta[BASELINE:CAMERA_ROTATION] = geometry.right_rotation_rad, geometry.baseline_m
    theta[CAMERA_POSITION:TARGET_ROTATION] = calibration.camera_position_m
    theta[TARGET_POSITION:SCALE] = calibration.target_position_m
    theta[SCALE] = 1.0
    sizes = np.array([[c.width, c.height] for c in (geometry.left, geometry.right)], dtype=float)
    target_axes = np.ascontiguousarray(np.array(calibration.target_axes).T)
    setup = Setup(theta, np.array(calibration.camera_axes), target_axes, np.array(geometry.leds_m), sizes)
    order = np.array([_ORDER.index(axis) for axis in calibration.gimbal_order])
    sigma = np.array([calibration.rail_sigma_m] * 3 + [math.radians(calibration.gimbal_sigma_deg)] * 3)
    turntable = TurntableModel(np.array(calibration.lever_arm_m, dtype=float), order)
    label = Label(calibration.id, calibration.date, calibration.target)
    return StoredCalibration(label, setup, turntable, covariance, calibration.noise, sigma, geometry.sensor)
