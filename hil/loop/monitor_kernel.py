"""Docking monitor in the loop: its measurements, with their faults and delays, and the interlock that compares them.

The stage in Python and the compiled loop call the same kernels: ``measure_bench`` for the measurements of the
statistical model, ``put_frame`` for those of another source, then ``compare_received``.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import VMU_FRAME
from hil.dynamics.docking_monitor import MONITOR_MODEL, is_due, measure_target
from hil.dynamics.vision_faults import VMU_MEMORY, disturb_frame
from hil.maths.arrays import copy_into
from hil.models.camera_timing import TIME_SLACK_S
from hil.models.faults import FAULTS
from hil.monitor.kernels.interlock import INTERLOCK_PARAMS, INTERLOCK_STATE, compare_estimate

_WAITING_MAX = 32  # measurements between exposure and arrival; further ones are lost

MONITOR_PARAMS = np.dtype(
    [
        ("acts", "i8"),  # 1: measurements arrive in the loop
        ("models", "i8"),  # 1: those of the statistical model
        ("model", MONITOR_MODEL),  # its latency and mounting are those of any source
        ("faults", FAULTS),
        ("interlock", INTERLOCK_PARAMS),
    ],
    align=True,
)

MONITOR_STATE = np.dtype(
    [
        ("next", "i8"),  # number of the next measurement of the model
        ("faulty", VMU_MEMORY),
        ("frame", VMU_FRAME),  # the last measurement, times of the run
        ("waiting", "i8"),  # measurements that have not arrived yet
        ("measured_s", "f8", _WAITING_MAX),
        ("received_s", "f8", _WAITING_MAX),
        ("t_v", "f8", (_WAITING_MAX, 3)),
        ("q_vt", "f8", (_WAITING_MAX, 4)),
        ("variance", "f8", (_WAITING_MAX, 6)),
        ("interlock", INTERLOCK_STATE),
    ],
    align=True,
)


@kernel
def is_measured(params, state, t_s):
    """Return whether the model measures at ``t_s`` of the run."""
    return params.models != 0 and is_due(params.model, state.next, t_s)


@kernel
def measure_bench(params, state, t_s, r_CT_H, q_CH, noise, first):
    """Measure the bench's pose at ``t_s`` of the run, at which ``is_measured`` holds.

    noise: (n, MONITOR_NOISE), of the measurements from number ``first`` on.
    """
    frame, number = state.frame, state.next
    while is_due(params.model, state.next, t_s):
        state.next += 1
    if measure_target(params.model, r_CT_H, q_CH, noise[number - first], frame.t_v, frame.q_vt, frame.covariance):
        frame.counter, frame.t_s = number, t_s
        frame.received_s = t_s + params.model.latency_s
        put_frame(params, state)


@kernel
def put_frame(params, state):
    """Take the measurement ``state.frame`` on its way to the loop, with the faults that act on it."""
    frame, k = state.frame, state.waiting
    if not disturb_frame(params.faults, params.model.mounting, 0.0, state.faulty, frame) or k == _WAITING_MAX:
        return
    state.measured_s[k], state.received_s[k] = frame.t_s, frame.received_s
    copy_into(state.t_v[k], frame.t_v)
    copy_into(state.q_vt[k], frame.q_vt)
    for i in range(6):
        state.variance[k, i] = frame.covariance[i, i]
    state.waiting += 1


@kernel
def compare_received(params, state, t_s, estimate):
    """Compare the measurements that have arrived by ``t_s`` with ``estimate`` (NAVIGATION) of the cycle before.

    Returns 1 if the interlock is set, else 0.
    """
    while True:
        found = -1
        for k in range(state.waiting):
            if state.received_s[k] <= t_s + TIME_SLACK_S and (
                found < 0 or state.received_s[k] < state.received_s[found]
            ):
                found = k
        if found < 0:
            return state.interlock.disagrees
        compare_estimate(
            params.interlock, params.model.mounting, state.interlock, t_s, state.measured_s[found],
            state.t_v[found], state.q_vt[found], state.variance[found], estimate,
        )  # fmt: skip
        state.waiting -= 1
        last = state.waiting
        state.measured_s[found], state.received_s[found] = state.measured_s[last], state.received_s[last]
        copy_into(state.t_v[found], state.t_v[last])
        copy_into(state.q_vt[found], state.q_vt[last])
        copy_into(state.variance[found], state.variance[last])
