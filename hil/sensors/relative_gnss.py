"""Relative GNSS: position and velocity of the chaser against the target by receivers on both.

Carrier-phase differential navigation in orbit reaches 1 cm to 5 cm with fixed ambiguities and 10 cm to 30 cm with float
ones (PRISMA: D'Amico, Ardaens, Larsson 2012, J. Guidance 35(2), on-board errors of 5 cm 3D rms and 1 mm/s; ATV: 10 m
class by C/A code beyond 1 km). Errors are correlated over the minutes in which ambiguities and multipath change. Near a
large target the sky is in its shadow: fixes are lost.
"""

from __future__ import annotations

import math

from hil.core.settings import Setting
from hil.maths import elementary, special
from hil.sensors.module import FUSED_FAULTS, Component, SensorError, SensorModule

_AXES = "xyz"


class RelativeGnss(SensorModule):
    """Relative GNSS: position and velocity in H, correlated errors, none in the target's shadow of the sky."""

    kind = "relative_gnss"
    components = (
        *(Component(f"{axis}_m", "m", "position of the chaser in H") for axis in _AXES),
        *(Component(f"v{axis}_mps", "m/s", "velocity of the chaser as seen in H") for axis in _AXES),
    )
    settings = (
        Setting("sigma_m", 0.02, "m", 1e-4, 100.0, "white noise of the position, 1 sigma per axis"),
        Setting("sigma_mps", 0.002, "m/s", 1e-5, 10.0, "white noise of the velocity"),
        Setting("correlated_sigma_m", 0.05, "m", 0.0, 100.0, "correlated error of the position, true and as known"),
        Setting("correlation_time_s", 120.0, "s", 1.0, 1e5, "its correlation time"),
        Setting("bias_x_m", 0.0, "m", -100.0, 100.0, "true constant error of the position"),
        Setting("bias_y_m", 0.0, "m", -100.0, 100.0),
        Setting("bias_z_m", 0.0, "m", -100.0, 100.0),
        Setting("range_min_m", 10.0, "m", 0.0, 1e5, "nearer, the target shadows too much of the sky"),
        Setting("shadow_probability", 0.02, "1", 0.0, 0.99, "of a measurement farther out to be lost"),
    )
    errors = tuple(SensorError("correlated", i, "correlated_sigma_m", "correlation_time_s") for i in range(3))
    faults = FUSED_FAULTS | {
        "frozen": "a position that stands still: gate and CUSUM of the innovations once the chaser has moved",
        "offset": "a wrong ambiguity is 0.1 to 0.2 m: gate beyond its sigmas, below the CUSUM of the innovations",
    }
    sees = "truth"
    rate_hz = 1.0

    @staticmethod
    def measure(settings, truth, out):
        """Write position and velocity; ``memory``: 1 once started, then the correlated error of each axis, m."""
        kept = elementary.exp(-truth.dt_s / settings.correlation_time_s) if truth.memory[0] != 0.0 else 0.0
        fresh = settings.correlated_sigma_m * math.sqrt(1.0 - kept * kept)
        truth.memory[0] = 1.0
        bias = (settings.bias_x_m, settings.bias_y_m, settings.bias_z_m)
        square = 0.0
        for i in range(3):
            truth.memory[1 + i] = kept * truth.memory[1 + i] + fresh * truth.normal[i]
            square += truth.r_CT_H[i] ** 2
            out.sample.value[i] = (
                truth.r_CT_H[i] + truth.memory[1 + i] + bias[i] + settings.sigma_m * truth.normal[3 + i]
            )
            out.sample.value[3 + i] = truth.v_CT_H[i] + settings.sigma_mps * truth.normal[6 + i]
            out.sample.covariance[i, i] = settings.sigma_m**2
            out.sample.covariance[3 + i, 3 + i] = settings.sigma_mps**2
        is_lost = special.normal_probability(-truth.normal[9]) < settings.shadow_probability
        if is_lost or square < settings.range_min_m**2:
            out.valid = 0

    @staticmethod
    def innovate(settings, estimate, out):
        """Position and velocity come from the estimate."""
        for i in range(3):
            out.value[i] = out.sample.value[i] - estimate.r_CT_H[i]
            out.value[3 + i] = out.sample.value[3 + i] - estimate.v_CT_H[i]
            out.h[i, i] = out.h[3 + i, 3 + i] = 1.0
