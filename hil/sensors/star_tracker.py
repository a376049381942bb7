"""Star tracker: attitude of the chaser against the target's Hill frame, with the ephemeris of the target.

Noise of an autonomous star tracker: a few arc seconds across its boresight, ten times as much about it, alignment of
some ten arc seconds (Jena-Optronik ASTRO APS: 1 arcsec and 8 arcsec, 1 sigma; Ball CT-2020: 1.5 arcsec). Boresight is z
of the chaser.
"""

from __future__ import annotations

from hil.core.settings import Setting
from hil.maths import quat, stack
from hil.sensors.module import Component, SensorError, SensorModule


class StarTracker(SensorModule):
    """Star tracker: rotation of the chaser against H, from inertial attitude and ephemeris; boresight z of c."""

    kind = "star_tracker"
    components = (
        Component("rx_rad", "rad", "rotation vector from H to c"),
        Component("ry_rad", "rad"),
        Component("rz_rad", "rad"),
    )
    settings = (
        Setting("sigma_rad", 2e-5, "rad", 1e-8, 0.1, "noise across the boresight, 1 sigma per axis"),
        Setting("sigma_boresight_rad", 1e-4, "rad", 1e-8, 0.1, "noise about the boresight"),
        Setting("misalignment_x_rad", 0.0, "rad", -0.1, 0.1, "true misalignment about the axes of c"),
        Setting("misalignment_y_rad", 0.0, "rad", -0.1, 0.1),
        Setting("misalignment_z_rad", 0.0, "rad", -0.1, 0.1),
        Setting("misalignment_sigma_rad", 1e-4, "rad", 0.0, 0.1, "its standard deviation, as the filters assume it"),
    )
    errors = tuple(SensorError("misalignment", i, "misalignment_sigma_rad") for i in range(3))
    faults = {
        "no_sample": "no measurement: known at once; the gyros carry on",
        "frozen": "gate and CUSUM of the innovations once the chaser has turned",
        "drift": "CUSUM of the innovations, against gyros and vision",
        "noise_scale": "mean NIS",
        "sigma_scale": "mean NIS, if smaller; a larger one wastes information",
        "latency": "innovations in motion, if stamped with the arrival",
    }
    sees = "truth"
    rate_hz = 2.0

    @staticmethod
    def measure(settings, truth, out):
        """Write the attitude, turned by misalignment and noise."""
        turn, rotation, q = stack.vector(3), stack.vector(4), stack.vector(4)
        turn[0] = settings.misalignment_x_rad + settings.sigma_rad * truth.normal[0]
        turn[1] = settings.misalignment_y_rad + settings.sigma_rad * truth.normal[1]
        turn[2] = settings.misalignment_z_rad + settings.sigma_boresight_rad * truth.normal[2]
        quat.from_rotation_vector_into(turn, rotation)
        quat.multiply_into(rotation, truth.q_CH, q)
        quat.to_rotation_vector_into(q, turn)
        for i in range(3):
            out.sample.value[i] = turn[i]
        out.sample.covariance[0, 0] = out.sample.covariance[1, 1] = settings.sigma_rad**2
        out.sample.covariance[2, 2] = settings.sigma_boresight_rad**2

    @staticmethod
    def innovate(settings, estimate, out):
        """The innovation is the small rotation from the estimated to the measured attitude, three components."""
        q, turn = stack.vector(4), stack.vector(3)
        quat.from_rotation_vector_into(out.sample.value[0:3], q)
        quat.rotation_between(q, estimate.q_CH, turn)
        for i in range(3):
            out.value[i] = turn[i]
            out.h[i, 6 + i] = 1.0
