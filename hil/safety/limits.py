"""The supervisor's limits, from the rig file."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.bench.guard import GUARD
from hil.config.rig import Rig
from hil.core.messages import Array, new

_STAND_MPS = 0.01
_STAND_RADPS = math.radians(1.0)
_SLACK_M = 0.001
_SLACK_RAD = 0.001


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """guard: GUARD. feedback_age_max_s: of rails and turntable. slack (6,): how far beyond its travel an axis may
    stand when it is armed, m and rad. stand_mps, stand_radps: slower than that counts as standing."""

    guard: np.record
    feedback_age_max_s: tuple[float, float]
    command_age_max_s: float
    homing_timeout_s: float
    slack: Array
    stand_mps: float = _STAND_MPS
    stand_radps: float = _STAND_RADPS


def safety_limits(rig: Rig, params: np.record) -> SafetyLimits:
    """Return the limits of ``rig``; params: its BENCH_PARAMS."""
    guard = new(GUARD)
    rails, turntable = rig.rails, rig.turntable
    guard.following_max = [rails.following_error_max_m] * 3 + [math.radians(turntable.following_error_max_deg)] * 3
    guard.following_per_speed = [rails.following_error_per_speed_s] * 3 + [turntable.following_error_per_speed_s] * 3
    guard.low, guard.high = params.low, params.high
    return SafetyLimits(
        guard=guard,
        feedback_age_max_s=(rails.timeout_s, turntable.timeout_s),
        command_age_max_s=rig.safety.command_age_max_s,
        homing_timeout_s=rig.safety.homing_timeout_s,
        slack=np.array([_SLACK_M] * 3 + [_SLACK_RAD] * 3),
    )
