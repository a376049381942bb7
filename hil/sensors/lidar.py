"""Scanning lidar: range and two bearings of a retroreflector on the target.

Noise of a rendezvous lidar: range bias and noise below 0.1 m and 0.02 m at 100 m, bearing 0.1 deg and better (RVS on
ATV and HTV, Jena-Optronik: range noise 0.01 m to 0.5 m and line of sight 0.1 deg over 1 m to 730 m; DragonEye and VNS
are of the same class).
"""

from __future__ import annotations

import math

from hil.core.jit import kernel
from hil.core.settings import Setting
from hil.maths import elementary, quat, stack
from hil.sensors.module import FUSED_FAULTS, Component, SensorError, SensorModule


@kernel
def _sight(settings, r_CT_H, q_CH, sight):
    """Write the vector from the lidar to the retroreflector into ``sight`` (3,), m, in c: ``A (b - r) - a``."""
    line = stack.vector(3)
    line[0] = settings.reflector_x_m - r_CT_H[0]
    line[1] = settings.reflector_y_m - r_CT_H[1]
    line[2] = settings.reflector_z_m - r_CT_H[2]
    quat.transform_into(q_CH, line, sight)
    sight[0] -= settings.aperture_x_m
    sight[1] -= settings.aperture_y_m
    sight[2] -= settings.aperture_z_m


class Lidar(SensorModule):
    """Scanning lidar: range and bearing of a retroreflector, looking along -x of the chaser."""

    kind = "lidar"
    components = (
        Component("range_m", "m", "from the lidar to the retroreflector"),
        Component("azimuth_rad", "rad", "atan2(y, -x) of the line of sight in c"),
        Component("elevation_rad", "rad", "atan2(z, |x, y|) of the line of sight in c"),
    )
    settings = (
        Setting("sigma_range_m", 0.005, "m", 1e-5, 10.0, "noise of the range, 1 sigma"),
        Setting("sigma_range_scale", 1e-4, "1", 0.0, 0.1, "and this much more per metre"),
        Setting("sigma_bearing_rad", 5e-4, "rad", 1e-7, 0.1, "noise of both bearings"),
        Setting("bias_range_m", 0.0, "m", -10.0, 10.0, "true offset of the range"),
        Setting("bias_azimuth_rad", 0.0, "rad", -0.1, 0.1, "true misalignment"),
        Setting("bias_elevation_rad", 0.0, "rad", -0.1, 0.1),
        Setting("bias_range_sigma_m", 0.01, "m", 0.0, 10.0, "their standard deviations, as the filters assume them"),
        Setting("bias_bearing_sigma_rad", 8e-4, "rad", 0.0, 0.1),
        Setting("aperture_x_m", 0.0, "m", -10.0, 10.0, "lidar from the chaser's reference point, in c"),
        Setting("aperture_y_m", 0.0, "m", -10.0, 10.0),
        Setting("aperture_z_m", -0.3, "m", -10.0, 10.0),
        Setting("reflector_x_m", 0.0, "m", -10.0, 10.0, "retroreflector from the target's reference point, in H"),
        Setting("reflector_y_m", 0.0, "m", -10.0, 10.0),
        Setting("reflector_z_m", -0.3, "m", -10.0, 10.0),
        Setting("range_min_m", 2.0, "m", 0.0, 1e4, "shortest range"),
        Setting("range_max_m", 100.0, "m", 1.0, 1e5, "longest range"),
        Setting("half_field_rad", 0.35, "rad", 0.01, 1.5, "half angle of the scanned field"),
    )
    errors = (
        SensorError("bias", 0, "bias_range_sigma_m"),
        SensorError("bias", 1, "bias_bearing_sigma_rad"),
        SensorError("bias", 2, "bias_bearing_sigma_rad"),
    )
    faults = FUSED_FAULTS | {
        "offset": "another reflector is decimetres off: gate; below its sigmas the CUSUM of the innovations",
    }
    rate_hz = 5.0

    @staticmethod
    def measure(settings, truth, out):
        """Write range and bearings with offsets and noise."""
        sight = stack.vector(3)
        _sight(settings, truth.r_CT_H, truth.q_CH, sight)
        x, y, z = sight[0], sight[1], sight[2]
        flat = math.sqrt(x * x + y * y)
        distance = math.sqrt(x * x + y * y + z * z)
        sigma = settings.sigma_range_m + settings.sigma_range_scale * distance
        bearing = settings.sigma_bearing_rad
        azimuth, elevation = elementary.atan2(y, -x), elementary.atan2(z, flat)
        if not settings.range_min_m <= distance <= settings.range_max_m:
            out.valid = 0
        if max(abs(azimuth), abs(elevation)) > settings.half_field_rad:
            out.valid = 0
        out.sample.value[0] = distance + settings.bias_range_m + sigma * truth.normal[0]
        out.sample.value[1] = azimuth + settings.bias_azimuth_rad + bearing * truth.normal[1]
        out.sample.value[2] = elevation + settings.bias_elevation_rad + bearing * truth.normal[2]
        out.sample.covariance[0, 0] = sigma * sigma
        out.sample.covariance[1, 1] = out.sample.covariance[2, 2] = bearing * bearing

    @staticmethod
    def innovate(settings, estimate, out):
        """With ``s = A (b - r) - a``: ``ds = -A dr - theta x (s + a)``; range, azimuth, elevation by the chain rule."""
        sight, g = stack.vector(3), stack.matrix(3, 3)
        a = stack.matrix(3, 3)
        _sight(settings, estimate.r_CT_H, estimate.q_CH, sight)
        quat.to_matrix_into(estimate.q_CH, a)
        x, y, z = sight[0], sight[1], sight[2]
        square, flat_2 = x * x + y * y + z * z, max(1e-18, x * x + y * y)
        distance, flat = math.sqrt(square), math.sqrt(flat_2)
        out.value[0] = out.sample.value[0] - distance
        out.value[1] = out.sample.value[1] - elementary.atan2(y, -x)
        out.value[2] = out.sample.value[2] - elementary.atan2(z, flat)
        g[0, 0], g[0, 1], g[0, 2] = x / distance, y / distance, z / distance
        g[1, 0], g[1, 1], g[1, 2] = y / flat_2, -x / flat_2, 0.0
        g[2, 0], g[2, 1], g[2, 2] = -x * z / (square * flat), -y * z / (square * flat), flat / square
        px, py, pz = x + settings.aperture_x_m, y + settings.aperture_y_m, z + settings.aperture_z_m
        for i in range(3):
            for j in range(3):
                out.h[i, j] = -(g[i, 0] * a[0, j] + g[i, 1] * a[1, j] + g[i, 2] * a[2, j])
            # g . (p x theta) = theta . (g x p), with -theta x p = p x theta
            out.h[i, 6] = g[i, 1] * pz - g[i, 2] * py
            out.h[i, 7] = g[i, 2] * px - g[i, 0] * pz
            out.h[i, 8] = g[i, 0] * py - g[i, 1] * px
