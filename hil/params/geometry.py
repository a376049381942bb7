"""Geometry of a machine with errors, from a vector of its parameters to the record of the kernels."""

from __future__ import annotations

import numpy as np

from hil.config.rig import Rig
from hil.config.tables.machine import parts_of
from hil.core.messages import Array
from hil.maths import quat

_RAILS = "xyz"
_POWERS = np.array([[0.0, 1.0, 0.0, 0.0], [-0.5, 0.0, 1.5, 0.0], [0.0, -1.5, 0.0, 2.5]])
"""Powers of t in the Legendre polynomials P1, P2, P3."""


def set_geometry(params: np.record, rig: Rig, vector: Array | None) -> None:
    """Write the lever arm and ``geometry`` of ``params`` (BENCH_PARAMS), whose other fields are set.

    vector: (PARAMETERS,), m and rad; None: of an ideal machine.
    """
    params.lever_arm = rig.bench.lever_arm_m
    g = params.geometry
    g.enabled = vector is not None
    if vector is None:
        return
    of = parts_of(vector)
    params.lever_arm = np.array(rig.bench.lever_arm_m) + of["reference_m"]
    g.arm = params.lever_arm
    places = [rig.bench.rails_order.index(letter) for letter in _RAILS]
    g.carries = [[place < other for other in places] for place in places]
    half = 0.5 * (params.high[:3] - params.low[:3])
    g.centre, g.inverse = params.low[:3] + half, [0.0 if each <= 0.0 else 1.0 / each for each in half]
    g.rail = 0.0
    for i, name in enumerate(_RAILS):
        if not g.inverse[i]:  # a fixed rail: its errors are those of its base
            continue
        legendre = np.zeros((3, 6))  # P1, P2, P3
        legendre[:, i] = of[f"{name}_position_m"]
        legendre[:, 3:] = of[f"{name}_rotation_deg"].reshape(3, 3).T
        across = [axis for axis in range(3) if axis != i]
        legendre[1:, across] = of[f"{name}_straightness_m"].reshape(2, 2).T
        terms = [np.multiply.outer(powers, row) for powers, row in zip(_POWERS, legendre, strict=True)]
        g.rail[i] = terms[0] + terms[1] + terms[2]
    moves = g.inverse > 0.0
    g.squareness = of["squareness_deg"] * [moves[1], moves[2], moves[2]]
    outer, middle, inner = params.order
    g.zero[[outer, middle, inner]] = of["turntable_deg"][outer], of["middle_deg"][1], of["reference_deg"][inner]
    g.turntable_tilt, reference = of["turntable_deg"], of["reference_deg"].copy()
    g.turntable_tilt[outer] = reference[inner] = 0.0
    g.q_reference = quat.from_rotation_vector(reference)
    g.middle_tilt, g.middle_offset = of["middle_deg"][0], of["middle_m"][0]
    g.inner_tilt, g.inner_offset = of["inner_deg"][0], of["inner_m"]
    g.base, g.q_base = of["base_m"], quat.from_rotation_vector(of["base_deg"])
