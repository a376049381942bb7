"""Parameters of the bench's kinematics and limits, from the rig's units to SI."""

from __future__ import annotations

import math

import numpy as np

from hil.bench.kinematics import BENCH_PARAMS
from hil.config.rig import Rig
from hil.core.messages import new


def bench(rig: Rig, step_s: float) -> np.record:
    """Return BENCH_PARAMS: geometry and limits of the six axes. step_s: period of the cycle."""
    params = new(BENCH_PARAMS)
    params.dt_s = step_s / rig.ticks(step_s)
    params.lever_arm = rig.bench.lever_arm_m
    params.order = ["xyz".index(letter) for letter in rig.bench.gimbal_order]
    rails = (rig.rails.x, rig.rails.y, rig.rails.z)
    gimbals = (rig.turntable.roll, rig.turntable.pitch, rig.turntable.yaw)
    params.low = [*(a.travel_m[0] for a in rails), *(math.radians(a.travel_deg[0]) for a in gimbals)]
    params.high = [*(a.travel_m[1] for a in rails), *(math.radians(a.travel_deg[1]) for a in gimbals)]
    params.rate_max = [*(a.rate_max_mps for a in rails), *(math.radians(a.rate_max_degps) for a in gimbals)]
    params.acceleration_max = [
        *(a.acceleration_max_mps2 for a in rails),
        *(math.radians(a.acceleration_max_degps2) for a in gimbals),
    ]
    params.lead = [a.lead_s for a in (*rails, *gimbals)]
    return params
