"""Faults of the vision unit: what happens to its frames between the unit and the loop.

They act on frames of any unit: modelled, rendered, emulated or real.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import VMU_FRAME
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, copy_matrix
from hil.models.faults import AT, AT_ARRIVAL, KIND, OPTION, SIZE, VALUE, displace_at_random, is_active, normal
from hil.models.plume import share_at
from hil.sensors.vision_unit.errors import misidentify

NO_POSE, FROZEN, OFFSET, DRIFT, OUTLIER, NOISE_SCALE, SIGMA_SCALE, LATENCY, MISIDENTIFIED, DIMMED = range(10)
"""Option of LATENCY: frames are stamped when they arrive."""

_OUTLIER_LANE, _NOISE_LANE, _PLUME_LANE = 0, 8, 1024

VMU_MEMORY = np.dtype([("has_frame", "i8"), ("frame", VMU_FRAME)], align=True)
"""The last frame that was passed on."""


@kernel
def _displace(mounting, displacement, frame):
    """Displace the chaser that ``frame`` means by ``displacement`` (3,), m, in H: the ring moves against the camera."""
    q_vh, moved = stack.vector(4), stack.vector(3)
    quat.multiply_into(frame.q_vt, mounting.q_th, q_vh)
    quat.transform_into(q_vh, displacement, moved)
    for i in range(3):
        frame.t_v[i] -= moved[i]


@kernel
def _turn(rotation, frame):
    """Turn the ring of ``frame`` by the rotation vector (3,), rad, whose sense is that of a vector's, in v."""
    turn, attitude = stack.vector(4), stack.vector(4)
    for i in range(3):
        rotation[i] = -rotation[i]  # from_rotation_vector turns the frame
    copy_into(attitude, frame.q_vt)
    quat.from_rotation_vector_into(rotation, turn)
    quat.multiply_into(turn, attitude, frame.q_vt)


@kernel
def _add_noise(excess, seed, lane, frame):
    """Add noise that is ``excess`` times the reported one. lane: of random numbers, the first of six."""
    rotation = stack.vector(3)
    for j in range(3):
        sigma_m, sigma_rad = math.sqrt(frame.covariance[j, j]), math.sqrt(frame.covariance[3 + j, 3 + j])
        frame.t_v[j] += excess * sigma_m * normal(seed, frame.counter, lane + j)
        rotation[j] = excess * sigma_rad * normal(seed, frame.counter, lane + 3 + j)
    _turn(rotation, frame)


@kernel
def _scale_covariance(factor, frame):
    for j in range(6):
        for k in range(6):
            frame.covariance[j, k] *= factor


@kernel
def dim(lost, least_light, seed, lane, frame):
    """Take the fraction ``lost`` of the LEDs' light away; return whether they are still visible.

    Centres of spots have a variance in reciprocal proportion to the light, that of its shot noise; the unit, which
    measures the light, reports it. least_light: 1/m^2, least light over the square of the distance, m, in terms of that
    of an LED which is not dimmed. lane: see ``_add_noise``.
    """
    light = 1.0 - lost
    if light < least_light * (frame.t_v[0] ** 2 + frame.t_v[1] ** 2 + frame.t_v[2] ** 2):
        return False
    _add_noise(math.sqrt(lost / light), seed, lane, frame)
    _scale_covariance(1.0 / light, frame)
    return True


@kernel
def see_through_plume(plume, memory, seed, zero_s, frame):
    """Dim the LEDs of ``frame`` (VMU_FRAME) by the plumes at its exposure; return whether they are still visible.

    plume: PLUME_PARAMS. memory: PLUME_MEMORY. seed: of the run. zero_s: bench time of the run's time zero.
    """
    lost = plume.dimming * share_at(plume, memory, frame.t_s - zero_s)
    return lost <= 0.0 or dim(lost, plume.least_light, seed, _PLUME_LANE, frame)


@kernel
def _copy_content(frame, out):
    """Copy pose, covariance, LEDs and status, not counter and times."""
    copy_into(out.t_v, frame.t_v)
    copy_into(out.q_vt, frame.q_vt)
    copy_matrix(out.covariance, frame.covariance)
    out.leds_left, out.leds_right, out.status = frame.leds_left, frame.leds_right, frame.status


@kernel
def disturb_frame(faults, mounting, zero_s, memory, frame):
    """Apply the faults that act at its exposure to ``frame`` (VMU_FRAME); return whether it has a pose.

    faults: FAULTS. mounting: MOUNTING. zero_s: bench time of the run's time zero. memory: VMU_MEMORY. ``received_s``
    of a frame that comes later is later.
    """
    displacement = stack.vector(3)
    is_frozen = is_stamped_late = False
    t_s = frame.t_s - zero_s
    for i in range(faults.n):
        row = faults.row[i]
        if not is_active(row, t_s):
            continue
        kind = row[KIND]
        if kind == NO_POSE:
            return False
        if kind == FROZEN:
            is_frozen = True
        elif kind in (OFFSET, DRIFT):
            for j in range(3):
                displacement[j] = row[VALUE + j] * (t_s - row[AT] if kind == DRIFT else 1.0)
            _displace(mounting, displacement, frame)
        elif kind == OUTLIER:
            displace_at_random(row[VALUE], row[SIZE], faults.seed, frame.counter, _OUTLIER_LANE + 32 * i, frame.t_v)
        elif kind == NOISE_SCALE:
            _add_noise(math.sqrt(row[VALUE] ** 2 - 1.0), faults.seed, _NOISE_LANE + 16 * i, frame)
        elif kind == SIGMA_SCALE:
            _scale_covariance(row[VALUE] ** 2, frame)
        elif kind == DIMMED:
            if not dim(row[VALUE], row[SIZE], faults.seed, _NOISE_LANE + 16 * i, frame):
                return False
        elif kind == MISIDENTIFIED:
            misidentify(row[VALUE], frame.q_vt)
        elif kind == LATENCY:
            frame.received_s += row[VALUE]
            is_stamped_late = is_stamped_late or row[OPTION] == AT_ARRIVAL
    if is_stamped_late:
        frame.t_s = frame.received_s
    if is_frozen and memory.has_frame != 0:
        _copy_content(memory.frame, frame)
    else:
        _copy_content(frame, memory.frame)
        memory.has_frame = 1
    return True
