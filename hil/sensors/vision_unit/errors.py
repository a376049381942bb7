"""Error model of the virtual vision unit beyond white noise: systematic errors, correlated noise, outliers, view.

Random numbers depend on the run's seed and the number of the exposure; they leave the noise of the run as it is.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, quat, stack
from hil.maths.arrays import copy_into
from hil.models.faults import displace_at_random, normal, uniform
from hil.sensors.vision_unit.camera import edge_distance

VISION_ERRORS = np.dtype(
    [
        ("enabled", "i8"),  # 1: any of the errors below
        ("needs_view", "i8"),  # 1: a pose needs LEAST_LEDS in both images
        ("seed", "i8"),
        ("bias", "f8", 3),  # m, in v, of t_v
        ("q_misaligned", "f8", 4),  # from the camera's axes to those that the unit assumes
        ("scale_error", "f8"),  # relative error of the distance
        ("correlated_fraction", "f8"),  # of the variance of the noise
        ("correlation_s", "f8"),
        ("outlier_probability", "f8"),
        ("outlier_size", "f8"),  # m
        ("misidentified_probability", "f8"),
    ],
    align=True,
)

VISION_MEMORY = np.dtype(
    [("exposures", "i8"), ("t_s", "f8"), ("correlated", "f8", 6), ("view_margin", "f8")], align=True
)
"""exposures: so far. t_s: of the last one. correlated: the Gauss-Markov process there, of unit variance. view_margin:
least distance of an LED from an edge of an image there, px."""

LEAST_LEDS = 3
"""LEDs that both images must show; with fewer the pose of a ring is not determined."""
PLACES = 6  # positions of the LEDs on the ring
_CORRELATED_LANE, _OUTLIER_LANE, _MISIDENTIFIED_LANE = 2048, 8192, 8196  # beyond those of the faults


@kernel
def misidentify(places, q_vt):
    """Take each LED for the one ``places`` further round the ring, whose axis is z of t."""
    turn, attitude = stack.vector(4), stack.vector(4)
    copy_into(attitude, q_vt)
    angle = places * math.pi / 3.0
    turn[0] = turn[1] = 0.0
    turn[2], turn[3] = elementary.sin(0.5 * angle), elementary.cos(0.5 * angle)
    quat.multiply_into(attitude, turn, q_vt)


@kernel
def correlate(errors, memory, t_s, noise, out):
    """Write standard normals (6,) whose correlated fraction is a first-order Gauss-Markov process.

    noise: (6,), the white part, standard normals. memory: VISION_MEMORY, moved on to the exposure at ``t_s``.
    """
    white, correlated = math.sqrt(1.0 - errors.correlated_fraction), math.sqrt(errors.correlated_fraction)
    kept = 0.0 if memory.exposures == 0 else elementary.exp(-(t_s - memory.t_s) / errors.correlation_s)
    fresh = math.sqrt(1.0 - kept * kept)
    for i in range(6):
        drawn = normal(errors.seed, memory.exposures, _CORRELATED_LANE + i)
        memory.correlated[i] = kept * memory.correlated[i] + fresh * drawn
        out[i] = white * noise[i] + correlated * memory.correlated[i]


@kernel
def distort(errors, number, t_v, q_vt):
    """Apply the systematic errors and the blunders of exposure ``number`` to a pose t -> v, in place."""
    attitude = stack.vector(4)
    quat.transform_into(errors.q_misaligned, t_v, t_v)
    copy_into(attitude, q_vt)
    quat.multiply_into(errors.q_misaligned, attitude, q_vt)
    for i in range(3):
        t_v[i] += errors.scale_error * t_v[i] + errors.bias[i]
    displace_at_random(errors.outlier_probability, errors.outlier_size, errors.seed, number, _OUTLIER_LANE, t_v)
    if uniform(errors.seed, number, _MISIDENTIFIED_LANE) < errors.misidentified_probability:
        misidentify(1.0 + math.floor((PLACES - 1) * uniform(errors.seed, number, _MISIDENTIFIED_LANE + 1)), q_vt)


@kernel
def leds_in_view(camera, leds, baseline, t_v, q_vt):
    """Return the mask of the LEDs, of the first 62, in the image of a camera at ``baseline``, m, along x of v.

    camera: CAMERA. leds: (n, 3), m, in t. t_v: (3,), m, and q_vt: (4,), the true pose t -> v.
    """
    mask = 0
    p = stack.vector(3)
    for j in range(min(62, leds.shape[0])):
        quat.transform_into(q_vt, leds[j], p)
        if edge_distance(camera, p[0] + t_v[0] - baseline, p[1] + t_v[1], p[2] + t_v[2]) >= 0.0:
            mask |= 1 << j
    return mask


@kernel
def count_leds(mask):
    """Return the number of LEDs in ``mask``."""
    count = 0
    while mask != 0:
        count += mask & 1
        mask >>= 1
    return count
