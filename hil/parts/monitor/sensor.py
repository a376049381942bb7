"""Docking monitor: pose of the docking target in its television camera.

A statistical model of the measurements that the docking monitor makes from its images
(``docs/explanation/docking-monitor.md``): range, line of sight and attitude, each with its standard deviation. Far from
the target, pitch and yaw are not observable; outside the image and outside the ranges at which the target can be
measured there is no measurement. The short form of such a sensor is the table ``[monitor]`` of a scenario, whose
measurements can also come from images.
"""

from __future__ import annotations

import math
from typing import Final

from hil.core.jit import kernel
from hil.core.settings import Setting
from hil.maths import quat, stack
from hil.maths.arrays import copy_into
from hil.sensors.module import Component, SensorError, SensorModule
from hil.sensors.mounting import target_pose

AXES: Final = (0.5, -0.5, -0.5, 0.5)
"""Quaternion from c to the camera's axes v, x1 = -y_c, x2 = z_c, x3 = -x_c, and from H to those of the target."""
UNOBSERVED_RAD: Final = 1.0
"""Standard deviation of an angle that is not observed."""


@kernel
def _see(settings, r_CT_H, q_CH, t_v, q_vt):
    """Write the pose of the target in the camera of a chaser at ``r_CT_H`` with ``q_CH``."""
    camera, target, axes = stack.vector(3), stack.vector(3), stack.vector(4)
    camera[0], camera[1], camera[2] = settings.camera_x_m, settings.camera_y_m, settings.camera_z_m
    target[0], target[1], target[2] = settings.target_x_m, settings.target_y_m, settings.target_z_m
    copy_into(axes, AXES)
    target_pose(camera, axes, target, axes, r_CT_H, q_CH, t_v, q_vt)


class DockingMonitorSensor(SensorModule):
    """Pose of the docking target in the television camera: position in v and rotation vector from t to v."""

    kind = "docking_monitor"
    rate_hz = 1.25
    components = (
        Component("tx_m", "m", "to the right, target in the camera"),
        Component("ty_m", "m", "upwards, target in the camera"),
        Component("tz_m", "m", "along the line of sight, target in the camera"),
        Component("rx_rad", "rad", "pitch, rotation of the target in the camera"),
        Component("ry_rad", "rad", "yaw, rotation of the target in the camera"),
        Component("rz_rad", "rad", "roll, rotation of the target in the camera"),
    )
    settings = (
        Setting("camera_x_m", 0.8, "m", -10.0, 10.0, "camera from the chaser's reference point, in c"),
        Setting("camera_y_m", 0.0, "m", -10.0, 10.0),
        Setting("camera_z_m", -0.5, "m", -10.0, 10.0),
        Setting("target_x_m", -0.3, "m", -10.0, 10.0, "target's disc from the target's reference point, in H"),
        Setting("target_y_m", 0.0, "m", -10.0, 10.0),
        Setting("target_z_m", -0.5, "m", -10.0, 10.0),
        Setting("error_m", 0.005, "m", 0.0, 10.0, "error of the mounting of camera and target: position"),
        Setting("error_rad", 0.00175, "rad", 0.0, 1.0, "the same of the attitude, and of the line of sight"),
        Setting("reference_range_m", 8.0, "m", 1e-3, 1e4, "range beyond which the sigmas grow in proportion"),
        Setting("sigma_range_scale", 3e-5, "1", 1e-9, 1.0, "noise of the range, as a fraction of it"),
        Setting("sigma_sight_rad", 1e-5, "rad", 1e-9, 1.0, "noise of the line of sight"),
        Setting("sigma_angle_rad", 1.6e-4, "rad", 1e-9, 1.0, "noise of the attitude, per axis"),
        Setting("range_min_m", 1.0, "m", 0.0, 1e4, "nearer than this the target is not measured"),
        Setting("near_range_m", 40.0, "m", 0.0, 1e4, "up to this range pitch and yaw are measured as well"),
        Setting("range_max_m", 40.0, "m", 0.0, 1e4, "farther than this the target is not measured"),
        Setting("field_right", 0.35, "1", 1e-3, 10.0, "tangent of the half angle of the image, to the right"),
        Setting("field_up", 0.26, "1", 1e-3, 10.0, "the same upwards"),
    )
    errors = (
        *(SensorError("mounting", i, "error_m") for i in range(3)),
        *(SensorError("mounting", 3 + i, "error_rad") for i in range(3)),
    )
    faults = {
        "no_sample": "no measurement: known at once; nothing is unseen",
        "frozen": "the interlock, or the CUSUM of its innovations, once the chaser has moved that far",
        "offset": "the interlock beyond its sigmas, or the CUSUM: unseen up to them",
        "drift": "the same, once larger",
        "outlier": "the interlock, if two in a row are outliers; the gate",
        "noise_scale": "the interlock, if two measurements in a row are beyond it; mean NIS",
        "sigma_scale": "mean NIS; as a witness a larger one only makes the interlock less strict",
        "latency": "innovations in motion, if stamped with the arrival",
    }

    @staticmethod
    def measure(settings, truth, out):
        """Write the pose with its noise, and its covariance."""
        t_v, q_vt, sight = stack.vector(3), stack.vector(4), stack.vector(3)
        rotation, turn, noisy = stack.vector(3), stack.vector(4), stack.vector(4)
        _see(settings, truth.r_CT_H, truth.q_CH, t_v, q_vt)
        distance = math.sqrt(t_v[0] ** 2 + t_v[1] ** 2 + t_v[2] ** 2)
        is_outside = (
            abs(t_v[0]) > settings.field_right * t_v[2]
            or abs(t_v[1]) > settings.field_up * t_v[2]
            or t_v[2] <= 0.0  # behind the camera
        )
        if is_outside or not settings.range_min_m <= distance <= settings.range_max_m:
            out.valid = 0
            return
        factor = max(1.0, distance / settings.reference_range_m)
        along, across = factor * settings.sigma_range_scale * distance, factor * settings.sigma_sight_rad * distance
        angle, product = factor * settings.sigma_angle_rad, 0.0
        value, covariance, normal = out.sample.value, out.sample.covariance, truth.normal
        for i in range(3):
            sight[i] = t_v[i] / distance
            product += sight[i] * normal[1 + i]
        for i in range(3):
            value[i] = t_v[i] + along * normal[0] * sight[i] + across * (normal[1 + i] - product * sight[i])
            for j in range(3):
                covariance[i, j] = (along**2 - across**2) * sight[i] * sight[j]
            covariance[i, i] += across**2
            is_observed = i == 2 or distance <= settings.near_range_m
            covariance[3 + i, 3 + i] = angle**2 if is_observed else UNOBSERVED_RAD**2
            rotation[i] = angle * normal[4 + i]
        quat.from_rotation_vector_into(rotation, turn)
        quat.multiply_into(turn, q_vt, noisy)
        quat.to_rotation_vector_into(noisy, rotation)
        copy_into(value[3:6], rotation)

    @staticmethod
    def innovate(settings, estimate, out):
        """With ``w = A (target - r)`` in c and v's axes V: ``t = V (w - camera)``, ``dt = -V A dr + V [w x] theta``.

        The rotation that is left between both attitudes is ``V theta``.
        """
        t_v, q_vt, q, turn = stack.vector(3), stack.vector(4), stack.vector(4), stack.vector(3)
        arm, v, a, q_vc = stack.vector(3), stack.matrix(3, 3), stack.matrix(3, 3), stack.vector(4)
        _see(settings, estimate.r_CT_H, estimate.q_CH, t_v, q_vt)
        arm[0] = settings.target_x_m - estimate.r_CT_H[0]
        arm[1] = settings.target_y_m - estimate.r_CT_H[1]
        arm[2] = settings.target_z_m - estimate.r_CT_H[2]
        quat.transform_into(estimate.q_CH, arm, arm)
        copy_into(q_vc, AXES)
        quat.to_matrix_into(q_vc, v)
        quat.to_matrix_into(estimate.q_CH, a)
        quat.from_rotation_vector_into(out.sample.value[3:6], q)
        quat.rotation_between(q, q_vt, turn)
        distance = math.sqrt(t_v[0] ** 2 + t_v[1] ** 2 + t_v[2] ** 2)
        for i in range(3):
            out.value[i] = out.sample.value[i] - t_v[i]
            out.value[3 + i] = turn[i]
            out.tolerance[i] = settings.error_m + settings.error_rad * distance
            out.tolerance[3 + i] = settings.error_rad
            for j in range(3):
                following, last = (j + 1) % 3, (j + 2) % 3
                out.h[i, j] = -(v[i, 0] * a[0, j] + v[i, 1] * a[1, j] + v[i, 2] * a[2, j])
                out.h[i, 6 + j] = v[i, following] * arm[last] - v[i, last] * arm[following]
                out.h[3 + i, 6 + j] = v[i, j]
