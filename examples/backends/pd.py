"""Plain PD law with pulse modulation as a backend of control, compiled by hil: what a first attempt looks like.

    hil run scheme-1 --set 'gnc.control.backend="examples/backends/pd.py:pd"'

Once per period the acceleration ``-kp e - kd e_dot`` is turned into a burn of whole cycles: less than half a cycle is
no burn. There is no feed-forward and no dead band for noise; the error is cut, to be worked off at a limited rate.
"""

import math

import hil
from hil.maths import quat, stack

SETTINGS = (
    hil.Setting("bandwidth_radps", 0.5, "rad/s", 0.01, 2.0, "of the position"),
    hil.Setting("attitude_bandwidth_radps", 0.6, "rad/s", 0.01, 5.0, "of the attitude"),
    hil.Setting("damping", 1.0, "1", 0.1, 2.0, "ratio"),
    hil.Setting("period_s", 0.4, "s", 0.02, 10.0, "between two decisions of an axis"),
    hil.Setting("largest_rate_mps", 0.006, "m/s", 1e-3, 0.1, "at which a position error is worked off"),
    hil.Setting("largest_rate_degps", 0.4, "deg/s", 0.01, 5.0, "at which an attitude error is worked off"),
)
MEMORY = [("left", "i8", 6), ("wait", "i8")]


@hil.kernel_backend(settings=SETTINGS, memory=MEMORY)
def pd(settings, inp, out, memory):
    """Write the demands of one cycle."""
    nav, ref, dt = inp.navigation, inp.reference, inp.setup.step_s
    error, rate, rotation = stack.vector(6), stack.vector(6), stack.vector(3)
    for i in range(3):
        error[i] = nav.r_CT_H[i] - ref.r_CT_H[i]
        rate[i] = nav.v_CT_H[i] - ref.v_CT_H[i]
    quat.transform_into(nav.q_CH, error[:3], error[:3])
    quat.transform_into(nav.q_CH, rate[:3], rate[:3])
    quat.rotation_between(nav.q_CH, ref.q_CH, rotation)
    period = max(1, round(settings.period_s / dt))
    decides = memory.wait <= 0
    for i in range(6):
        w, largest, a = settings.bandwidth_radps, settings.largest_rate_mps, inp.setup.acceleration_mps2[i % 3]
        if i >= 3:
            error[i], rate[i] = rotation[i - 3], nav.w_CH_C[i - 3]
            w, largest = settings.attitude_bandwidth_radps, math.radians(settings.largest_rate_degps)
            a = inp.setup.angular_acceleration_radps2[i - 3]
        if decides:
            damping = 2.0 * settings.damping * w
            reach = largest * damping / w**2
            wanted = w**2 * min(reach, max(-reach, error[i])) + damping * rate[i]
            memory.left[i] = min(period, max(-period, -round(wanted * period / a)))
        demand = min(1, max(-1, memory.left[i]))
        memory.left[i] -= demand
        if i < 3:
            out.force[i] = demand
        else:
            out.torque[i - 3] = demand
    memory.wait = period - 1 if decides else memory.wait - 1
