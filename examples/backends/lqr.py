"""LQR with pulse modulation as a backend of control, compiled by hil.

    hil run scheme-1 --set 'gnc.control.backend="examples/backends/lqr.py:lqr"'

Each of the six axes is a double integrator with the feedback that minimises the integral of bandwidth^4 e^2 + u^2. Once
per period the acceleration that it asks for is turned into a burn of whole cycles: less than half a cycle is no burn.
"""

import math

import hil
from hil.maths import quat, stack

SETTINGS = (
    hil.Setting("bandwidth_radps", 0.25, "rad/s", 0.01, 2.0, "of the position"),
    hil.Setting("attitude_bandwidth_radps", 0.6, "rad/s", 0.01, 5.0, "of the attitude"),
    hil.Setting("period_s", 0.4, "s", 0.02, 10.0, "between two decisions of an axis"),
    hil.Setting("largest_rate_mps", 0.006, "m/s", 1e-3, 0.1, "at which a position error is worked off"),
    hil.Setting("largest_rate_degps", 0.4, "deg/s", 0.01, 5.0, "at which an attitude error is worked off"),
)
MEMORY = [("left", "i8", 6), ("wait", "i8", 6), ("pending", "f8", 6)]


@hil.kernel_backend(settings=SETTINGS, memory=MEMORY)
def lqr(settings, inp, out, memory):
    """Write the demands of one cycle. pending: change of rate that the reference has asked for, not yet fired."""
    nav, ref, dt = inp.navigation, inp.reference, inp.setup.step_s
    error, rate, feed, rotation = stack.vector(6), stack.vector(6), stack.vector(6), stack.vector(3)
    for i in range(3):
        error[i] = nav.r_CT_H[i] - ref.r_CT_H[i]
        rate[i] = nav.v_CT_H[i] - ref.v_CT_H[i]
        feed[i] = ref.a_CT_H[i] + inp.feed_force_mps2[i]
    for part in (error, rate, feed):
        quat.transform_into(nav.q_CH, part[:3], part[:3])
    quat.rotation_between(nav.q_CH, ref.q_CH, rotation)
    period = max(1, round(settings.period_s / dt))
    for i in range(6):
        bandwidth, largest, a = settings.bandwidth_radps, settings.largest_rate_mps, inp.setup.acceleration_mps2[i % 3]
        if i >= 3:
            error[i], rate[i] = rotation[i - 3], nav.w_CH_C[i - 3] - inp.reference_rate_radps[i - 3]
            feed[i], a = inp.feed_torque_radps2[i - 3], inp.setup.angular_acceleration_radps2[i - 3]
            bandwidth, largest = settings.attitude_bandwidth_radps, math.radians(settings.largest_rate_degps)
        if memory.wait[i] <= 0:
            to_rate = math.sqrt(2.0) * bandwidth
            reach = largest * to_rate / bandwidth**2
            wanted = bandwidth**2 * min(reach, max(-reach, error[i])) + to_rate * (rate[i] + memory.pending[i])
            ahead = round((memory.pending[i] + feed[i] * period * dt) / (a * dt))
            memory.pending[i] -= ahead * a * dt
            memory.left[i] = min(period, max(-period, ahead - round(wanted * period / a)))
            memory.wait[i] = period
        memory.pending[i] += feed[i] * dt
        memory.wait[i] -= 1
        demand = min(1, max(-1, memory.left[i]))
        memory.left[i] -= demand
        if i < 3:
            out.force[i] = demand
        else:
            out.torque[i - 3] = demand
