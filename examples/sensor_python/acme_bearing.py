"""Bearing-only camera: direction of a beacon on the target, as two tangents of the angles in the camera."""

import hil
from hil.maths import quat, stack


class BearingCamera(hil.SensorModule):
    """Bearing-only camera, looking along -x of the chaser at a beacon in the target's reference point."""

    kind = "bearing_camera"
    components = (
        hil.Component("right", "1", "tangent of the angle to the right, y over distance ahead"),
        hil.Component("up", "1", "tangent of the angle upwards, z over distance ahead"),
    )
    settings = (
        hil.Setting("sigma", 5e-4, "1", 1e-7, 0.1, "noise of both tangents, 1 sigma"),
        hil.Setting("bias_right", 0.0, "1", -0.1, 0.1, "true misalignment"),
        hil.Setting("bias_up", 0.0, "1", -0.1, 0.1),
        hil.Setting("bias_sigma", 1e-3, "1", 0.0, 0.1, "its standard deviation, as the filters assume it"),
        hil.Setting("range_min_m", 0.2, "m", 0.0, 1e3, "shortest distance ahead"),
    )
    errors = (hil.SensorError("bias", 0, "bias_sigma"), hil.SensorError("bias", 1, "bias_sigma"))
    faults = {
        "no_sample": "no measurement: nothing is unseen",
        "frozen": "gate and CUSUM of the innovations once the chaser has moved",
        "offset": "gate beyond its sigmas, below the CUSUM of the innovations",
        "drift": "CUSUM of the innovations",
    }
    rate_hz = 5.0

    @staticmethod
    def measure(settings, truth, out):
        """Write both tangents with noise."""
        sight = stack.vector(3)
        quat.transform_into(truth.q_CH, truth.r_CT_H, sight)  # from the target to the camera, in c
        if sight[0] < settings.range_min_m:
            out.valid = 0
        out.sample.value[0] = sight[1] / sight[0] + settings.bias_right + settings.sigma * truth.normal[0]
        out.sample.value[1] = sight[2] / sight[0] + settings.bias_up + settings.sigma * truth.normal[1]
        for i in range(2):
            out.sample.covariance[i, i] = settings.sigma**2

    @staticmethod
    def innovate(settings, estimate, out):
        """With ``s = A r``: ``ds = A dr - theta x s``."""
        s, a = stack.vector(3), stack.matrix(3, 3)
        quat.transform_into(estimate.q_CH, estimate.r_CT_H, s)
        quat.to_matrix_into(estimate.q_CH, a)
        for k in range(2):
            i = k + 1
            out.value[k] = out.sample.value[k] - s[i] / s[0]
            for j in range(3):
                out.h[k, j] = (a[i, j] - a[0, j] * s[i] / s[0]) / s[0]
        out.h[0, 6], out.h[0, 7], out.h[0, 8] = s[2] / s[0], s[1] * s[2] / s[0] ** 2, -1.0 - (s[1] / s[0]) ** 2
        out.h[1, 6], out.h[1, 7], out.h[1, 8] = -s[1] / s[0], 1.0 + (s[2] / s[0]) ** 2, -s[1] * s[2] / s[0] ** 2
