"""Comparison of a GNC's estimate with the truth of a case and with common misinterpretations."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.maths import elementary, quat
from hil.parts.links.gnc_check.test_cases import TrueMotion

NEAR_M, NEAR_MPS, NEAR_RAD, NEAR_RADPS = 0.03, 0.01, math.radians(0.3), math.radians(0.05)
"""Tolerances of an estimate: the poses have no noise."""
_MATCH: Final = 0.1  # relative difference within which an estimate matches a misinterpretation

_Wrong = dict[str, Callable[[TrueMotion], Array]]

_VECTORS: Final[_Wrong] = {
    "in millimetres": lambda now: 1000.0 * now.r,
    "in kilometres": lambda now: 0.001 * now.r,
    "of the target from the chaser: opposite sign": lambda now: -now.r,
    "in c instead of H": lambda now: quat.to_matrix(now.q) @ now.r,
    "of the target from the chaser, in c: the pose itself": lambda now: -quat.to_matrix(now.q) @ now.r,
    "as from quaternions read with the scalar first": lambda now: _misread(now, np.roll(now.q, -1)),
    "as from quaternions read as q_HC": lambda now: _misread(now, quat.conjugate(now.q)),
}
_VELOCITIES: Final[_Wrong] = {
    "in millimetres per second": lambda now: 1000.0 * now.v,
    "with the opposite sign": lambda now: -now.v,
    "in c instead of H": lambda now: quat.to_matrix(now.q) @ now.v,
}
_RATES: Final[_Wrong] = {
    "in degrees per second": lambda now: np.degrees(now.w),
    "57 times too small: the gyro read as degrees per second": lambda now: np.radians(now.w + now.orbit) - now.orbit,
    "57 times too small": lambda now: np.radians(now.w),
    "against inertial space instead of H": lambda now: now.w + now.orbit,
    "with the opposite sign": lambda now: -now.w,
}
_ATTITUDES: Final[_Wrong] = {
    "has the scalar first": lambda now: np.roll(now.q, 1),
    "is q_HC: the inverse": lambda now: quat.conjugate(now.q),
    "is 57 times too large: degrees for radians": lambda now: _scaled(now.q, math.degrees(1.0)),
    "is 57 times too small: radians for degrees": lambda now: _scaled(now.q, math.radians(1.0)),
}


def check_estimate(estimate: np.void, now: TrueMotion) -> tuple[list[str], dict[str, float]]:
    """Return messages for the errors of ``estimate`` (GNC_OUTPUT), and their sizes."""
    r, v, q, w = (np.array(estimate[name]) for name in ("r_CT_H_m", "v_CT_H_mps", "q_CH", "w_CH_C_radps"))
    angle = _angle(q, now.q)
    errors = {
        "position_m": float(np.linalg.norm(r - now.r)),
        "velocity_mps": float(np.linalg.norm(v - now.v)),
        "attitude_deg": math.degrees(angle),
        "rate_degps": math.degrees(float(np.linalg.norm(w - now.w))),
    }
    faults = []
    if not errors["position_m"] <= NEAR_M:
        faults.append(f"position {_named(r, now, _VECTORS)}: it is {_triple(r)} m, in truth {_triple(now.r)} m")
    if not errors["velocity_mps"] <= NEAR_MPS:
        faults.append(f"velocity {_named(v, now, _VELOCITIES)}: it is {_triple(v)} m/s, in truth {_triple(now.v)} m/s")
    if not angle <= NEAR_RAD:
        mistake = next((name for name, wrong in _ATTITUDES.items() if _angle(q, wrong(now)) < NEAR_RAD), "is off")
        faults.append(f"attitude {mistake}: {errors['attitude_deg']:.2f} deg from the truth")
    if not errors["rate_degps"] <= math.degrees(NEAR_RADPS):
        faults.append(
            f"angular rate {_named(w, now, _RATES)}: it is {_triple(w)} rad/s, in truth {_triple(now.w)} rad/s"
        )
    return faults, errors


def _named(value: Array, now: TrueMotion, wrongs: _Wrong) -> str:
    for name, wrong in wrongs.items():
        expected = wrong(now)
        if np.linalg.norm(value - expected) <= _MATCH * np.linalg.norm(expected):
            return name
    return "is off"


def _misread(now: TrueMotion, q: Array) -> Array:
    """Return the position if the pose, in c, is transformed back to H with ``q``."""
    misread: Array = quat.to_matrix(q).T @ (quat.to_matrix(now.q) @ now.r)
    return misread


def _scaled(q: Array, factor: float) -> Array:
    scaled: Array = quat.from_rotation_vector(factor * quat.to_rotation_vector(q))
    return scaled


def _angle(p: Array, q: Array) -> float:
    return 2.0 * elementary.acos(min(1.0, abs(float(p @ q)))) if np.isfinite(p).all() else math.nan


def _triple(values: Array) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
