"""Memory of the last steps of the filters: an array of floats, as long as number of steps and of errors ask for.

A step has its inputs, its poses, and the estimates with their covariance as they were before these poses. Of the
covariance a triangle is kept, made of blocks of eight columns.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import POSE
from hil.core.sensor_records import SENSOR_SAMPLE
from hil.gnc.estimation.akf import AKF_STATE
from hil.gnc.estimation.error_state import LANES
from hil.gnc.estimation.pkf import PKF_STATE
from hil.gnc.estimation.target_orbit import HILL_STEP
from hil.maths.arrays import copy_into
from hil.maths.record_view import copy_eight, record_at

POSES_PER_STEP = 2
SAMPLES_PER_STEP = 8
"""Samples of all sensors together."""

DOUBTS = np.dtype(
    [
        ("acts", "i8"),  # 1: there are some
        ("position", "f8", 3),  # m, in H: by which the estimate may be off, 1 sigma
        ("velocity", "f8", 3),  # m/s, in H: the same
        ("across", "f8"),  # m/s, the same along each axis
        ("disturbance", "f8"),  # m/s^2, the same
        ("drift", "f8"),  # rad/s, the same about each axis
    ],
    align=True,
)
"""What is estimated again: added to the covariance in the step after the monitors have asked for it."""

STEP = np.dtype(
    [
        ("rate_C", "f8", 3),  # the IMU's sample of the step that ended here
        ("force_C", "f8", 3),
        ("kind", "i8"),  # source of the specific force, of ``thrust_model``
        ("thrust_C", "f8", 3),  # m/s^2, of the commands
        ("torque_C", "f8", 3),  # rad/s^2
        ("regains", "i8"),  # 1: the gyros are used again from this step on
        ("doubts", DOUBTS),  # doubts before this step
        ("rate_variance", "f8"),  # (rad/s)^2 that the drift gains in that step beyond its random walk
        ("hill", HILL_STEP),
        ("akf", AKF_STATE),  # before the poses of this moment
        ("pkf", PKF_STATE),
        ("n_poses", "i8"),
        ("is_start", "i8"),  # 1: the filters were started here, with the first pose, which is not fused
        ("poses", POSE, POSES_PER_STEP),
        ("gated", "i8", POSES_PER_STEP),  # results of the gate: NOT_GATED, or the part that was accepted
    ],
    align=True,
)
"""A step in the memory; parameters and covariance, as many as the error state has, follow it there, then SENSOR_STEP if
there are sensors."""
_STEP_WORDS = STEP.itemsize // 8

SENSOR_STEP = np.dtype(
    [
        ("n", "i8"),
        ("sample", SENSOR_SAMPLE, SAMPLES_PER_STEP),
        ("result", "i8", SAMPLES_PER_STEP),  # as in ``sensor_records``; ``sensor_fusion.NEW`` before gating
        ("arrival", "i8", SAMPLES_PER_STEP),  # place among the arrivals of the cycle in which it came
    ],
    align=True,
)
"""Samples of a step."""
_SENSOR_WORDS = SENSOR_STEP.itemsize // 8


def new_memory(params: np.record) -> np.ndarray:
    """Return the zeroed memory of filters with FUSION_PARAMS ``params``, an array of floats for ``step_at``."""
    return np.zeros(int(params.ring + 1) * _words(params))


def memory_steps(params: np.record, memory: np.ndarray) -> np.ndarray:
    """Return the steps in ``memory`` (of ``new_memory``) as a view, (n,) of STEP."""
    rows = memory.reshape(int(params.ring + 1), -1)
    return rows[:, :_STEP_WORDS].view(STEP)[:, 0]


@kernel
def _filter_words(params):
    """Return the length in the memory of the filters in a step: STEP, parameters, a triangle of the covariance."""
    blocks = (params.errors.n + 7) // 8
    return _STEP_WORDS + 8 * blocks + 64 * (blocks * (blocks + 1) // 2)


@kernel
def _words(params):
    """Return the length in the memory of a step."""
    words = _filter_words(params)
    return words + _SENSOR_WORDS if params.sensors.fused > 0 else words


@kernel
def step_at(params, memory, cycle):
    """Return the STEP of step number ``cycle``, which is in the memory."""
    return record_at(memory, (cycle & params.ring) * _words(params), STEP)


@kernel
def sensor_step_at(params, memory, cycle):
    """Return the SENSOR_STEP of step number ``cycle``, which is in the memory. There are sensors."""
    return record_at(memory, (cycle & params.ring) * _words(params) + _filter_words(params), SENSOR_STEP)


@kernel
def keep_predicted(params, filters, memory, cycle):
    """Keep the filters in the memory as they are before the poses of step ``cycle``."""
    n = params.errors.n
    step = step_at(params, memory, cycle)
    copy_into(step.akf.x, filters.akf.x)
    copy_into(step.akf.w_CH_C, filters.akf.w_CH_C)
    copy_into(step.pkf.x, filters.pkf.x)
    at = (cycle & params.ring) * _words(params) + _STEP_WORDS
    for j in range(0, n, 8):
        copy_eight(memory, at, filters.parameters, j)
        at += 8
    for i in range(n):
        for j in range(i - i % 8, n, 8):
            copy_eight(memory, at, filters.p, i * LANES + j)
            at += 8


@kernel
def return_to(params, filters, memory, cycle):
    """Return the filters to what ``keep_predicted`` has kept."""
    n = params.errors.n
    step = step_at(params, memory, cycle)
    copy_into(filters.akf.x, step.akf.x)
    copy_into(filters.akf.w_CH_C, step.akf.w_CH_C)
    copy_into(filters.pkf.x, step.pkf.x)
    at = (cycle & params.ring) * _words(params) + _STEP_WORDS
    for j in range(0, n, 8):
        copy_eight(filters.parameters, j, memory, at)
        at += 8
    for i in range(n):
        for j in range(i - i % 8, n, 8):
            copy_eight(filters.p, i * LANES + j, memory, at)
            at += 8
        for j in range(i - i % 8):
            filters.p[i, j] = filters.p[j, i]
