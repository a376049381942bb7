"""Poses of another estimator or of a motion capture, in addition to the vision unit.

Its datagrams carry position and attitude with a covariance. A modelled one has the noise of the settings, so that a
scenario can be tried before the other program is there. What a time stamp means is the key ``stamp`` of every sensor;
which point is tracked is the offset of the settings.
"""

from __future__ import annotations

from hil.core.settings import Setting
from hil.maths import quat, stack
from hil.sensors.module import FUSED_FAULTS, Component, SensorError, SensorModule


class ExternalPose(SensorModule):
    """Pose of another estimator or of a motion capture: position in H and rotation from H to c, with covariance."""

    kind = "pose"
    components = (
        *(Component(f"{axis}_m", "m", "tracked point in H, from the target's reference point") for axis in "xyz"),
        *(Component(f"r{axis}_rad", "rad", "rotation vector from H to c") for axis in "xyz"),
    )
    settings = (
        Setting("sigma_m", 0.002, "m", 1e-7, 10.0, "noise of a modelled position, 1 sigma per axis"),
        Setting("sigma_rad", 0.001, "rad", 1e-8, 1.0, "noise of a modelled rotation"),
        Setting("bias_x_m", 0.0, "m", -1.0, 1.0, "true error of a modelled position"),
        Setting("bias_y_m", 0.0, "m", -1.0, 1.0),
        Setting("bias_z_m", 0.0, "m", -1.0, 1.0),
        Setting("bias_sigma_m", 0.001, "m", 0.0, 1.0, "its standard deviation, as the filters assume it"),
        Setting("point_x_m", 0.0, "m", -10.0, 10.0, "tracked point from the chaser's reference point, in c"),
        Setting("point_y_m", 0.0, "m", -10.0, 10.0),
        Setting("point_z_m", 0.0, "m", -10.0, 10.0),
    )
    errors = tuple(SensorError("bias", i, "bias_sigma_m") for i in range(3))
    faults = FUSED_FAULTS

    @staticmethod
    def measure(settings, truth, out):
        """Write position of the tracked point and rotation with noise."""
        point, arm, turn, rotation, q = (
            stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(4), stack.vector(4),
        )  # fmt: skip
        point[0], point[1], point[2] = settings.point_x_m, settings.point_y_m, settings.point_z_m
        bias = (settings.bias_x_m, settings.bias_y_m, settings.bias_z_m)
        quat.transform_back_into(truth.q_CH, point, arm)
        for i in range(3):
            turn[i] = settings.sigma_rad * truth.normal[3 + i]
            out.sample.value[i] = truth.r_CT_H[i] + arm[i] + bias[i] + settings.sigma_m * truth.normal[i]
            out.sample.covariance[i, i] = settings.sigma_m**2
            out.sample.covariance[3 + i, 3 + i] = settings.sigma_rad**2
        quat.from_rotation_vector_into(turn, rotation)
        quat.multiply_into(rotation, truth.q_CH, q)
        quat.to_rotation_vector_into(q, turn)
        for i in range(3):
            out.sample.value[3 + i] = turn[i]

    @staticmethod
    def innovate(settings, estimate, out):
        """Point ``r + A.T p``: ``dr + A.T (theta x p)``; rotation: the small one between both attitudes."""
        point, arm, turn, q = stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(4)
        a = stack.matrix(3, 3)
        point[0], point[1], point[2] = settings.point_x_m, settings.point_y_m, settings.point_z_m
        quat.transform_back_into(estimate.q_CH, point, arm)
        quat.to_matrix_into(estimate.q_CH, a)
        quat.from_rotation_vector_into(out.sample.value[3:6], q)
        quat.rotation_between(q, estimate.q_CH, turn)
        for i in range(3):
            out.value[i] = out.sample.value[i] - estimate.r_CT_H[i] - arm[i]
            out.value[3 + i] = turn[i]
            out.h[i, i] = out.h[3 + i, 6 + i] = 1.0
            # A.T (theta x p)
            out.h[i, 6] = a[1, i] * -point[2] + a[2, i] * point[1]
            out.h[i, 7] = a[0, i] * point[2] - a[2, i] * point[0]
            out.h[i, 8] = -a[0, i] * point[1] + a[1, i] * point[0]
