"""Laser range finder: distance from an aperture on the chaser to a reflector on the target.

Noise and offset of an industrial phase-comparison sensor: 1 mm repeatability and +-2 mm accuracy to 100 m on a
reflector, 10 Hz to 250 Hz (data sheet of the Dimetix DxE series: repeatability 0.3 to 0.5 mm, accuracy 1 to 3 mm at
2 sigma).

Dimetix, command set of the DLS-A, DLS-C and FLS-C series (Technical Reference Manual DLS-C/FLS-C), device number 0:
``s0h`` measures continuously, each measurement is a line ``g0h+xxxxxxxx`` in 1/10 mm, an error ``g0@Ezzz``; ``s0c``
stops, which is acknowledged by ``g0?``. Lines end with carriage return and line feed; 19,200 baud, seven bits, even
parity as delivered.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final

from hil.core.jit import kernel
from hil.core.line_protocol import LineProtocol
from hil.core.settings import Setting
from hil.maths import quat, stack
from hil.sensors.module import FUSED_FAULTS, Component, SensorError, SensorModule

_DISTANCE: Final = re.compile(rb"g\du?h\+(\d{8})")
_ERROR: Final = re.compile(rb"g\d@E(\d{3})")
_ACKNOWLEDGED: Final = re.compile(rb"g\d\?")
_UNIT_M: Final = 1e-4
_MOST: Final = 99_999_999


class DimetixLines(LineProtocol):
    """Continuous measurement of one distance."""

    baud = 19_200
    bytesize = 7
    parity = "E"
    start = b"s0h\r\n"
    stop = b"s0c\r\n"

    def encode(self, values: Sequence[float]) -> bytes:
        """Return the line of a distance."""
        return b"g0h+%08d\r\n" % min(_MOST, max(0, round(values[0] / _UNIT_M)))

    def decode(self, line: bytes) -> tuple[float, ...] | None:
        """Return the distance of a line."""
        if match := _DISTANCE.fullmatch(line):
            return (int(match[1]) * _UNIT_M,)
        if _ACKNOWLEDGED.fullmatch(line):
            return None
        if match := _ERROR.fullmatch(line):
            raise ValueError(f"the sensor reports error {match[1].decode()}")
        raise ValueError("no line of a distance sensor")


@kernel
def line_of_sight(settings, r_CT_H, q_CH, line):
    """Write the vector from the reflector to the aperture into ``line`` (3,), m, in H."""
    arm = stack.vector(3)
    arm[0], arm[1], arm[2] = settings.aperture_x_m, settings.aperture_y_m, settings.aperture_z_m
    quat.transform_back_into(q_CH, arm, line)
    line[0] += r_CT_H[0] - settings.reflector_x_m
    line[1] += r_CT_H[1] - settings.reflector_y_m
    line[2] += r_CT_H[2] - settings.reflector_z_m


class RangeFinder(SensorModule):
    """Laser range finder: distance from its aperture to a reflector on the target."""

    kind = "range_finder"
    components = (Component("range_m", "m", "from the aperture to the reflector"),)
    settings = (
        Setting("sigma_m", 5e-4, "m", 1e-6, 10.0, "noise of a measurement, 1 sigma"),
        Setting("bias_m", 0.0, "m", -1.0, 1.0, "true offset"),
        Setting("bias_sigma_m", 1e-3, "m", 0.0, 1.0, "its standard deviation, as the filters assume it"),
        Setting("aperture_x_m", 0.3, "m", -10.0, 10.0, "aperture from the chaser's reference point, in c"),
        Setting("aperture_y_m", 0.0, "m", -10.0, 10.0),
        Setting("aperture_z_m", 0.0, "m", -10.0, 10.0),
        Setting("reflector_x_m", 0.0, "m", -10.0, 10.0, "reflector from the target's reference point, in H"),
        Setting("reflector_y_m", 0.0, "m", -10.0, 10.0),
        Setting("reflector_z_m", 0.0, "m", -10.0, 10.0),
        Setting("range_min_m", 0.05, "m", 0.0, 1e3, "shortest distance that is measured"),
        Setting("range_max_m", 100.0, "m", 0.1, 1e5, "longest distance that is measured"),
    )
    errors = (SensorError("bias", 0, "bias_sigma_m"),)
    wire = DimetixLines()
    faults = FUSED_FAULTS | {
        "frozen": "a distance that stands still: gate and CUSUM of the innovations once the chaser has moved by sigmas",
    }

    @staticmethod
    def measure(settings, truth, out):
        """Write the true distance with offset and noise."""
        line = stack.vector(3)
        line_of_sight(settings, truth.r_CT_H, truth.q_CH, line)
        distance = math.sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2)
        if not settings.range_min_m <= distance <= settings.range_max_m:
            out.valid = 0
        out.sample.value[0] = distance + settings.bias_m + settings.sigma_m * truth.normal[0]
        out.sample.covariance[0, 0] = settings.sigma_m**2

    @staticmethod
    def innovate(settings, estimate, out):
        """Distance ``d = |r + A.T a - b|``: ``dd = u . dr + u . A.T (theta x a)``, u the line of sight in H."""
        line, arm, in_c = stack.vector(3), stack.vector(3), stack.vector(3)
        line_of_sight(settings, estimate.r_CT_H, estimate.q_CH, line)
        distance = max(1e-9, math.sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2))
        arm[0], arm[1], arm[2] = settings.aperture_x_m, settings.aperture_y_m, settings.aperture_z_m
        out.value[0] = out.sample.value[0] - distance
        if out.noise[0, 0] <= 0.0:  # of a line, which does not report it
            out.noise[0, 0] = settings.sigma_m**2
        for i in range(3):
            line[i] /= distance
            out.h[0, i] = line[i]
        quat.transform_into(estimate.q_CH, line, in_c)
        # u_c . (theta x a) = theta . (a x u_c)
        out.h[0, 6] = arm[1] * in_c[2] - arm[2] * in_c[1]
        out.h[0, 7] = arm[2] * in_c[0] - arm[0] * in_c[2]
        out.h[0, 8] = arm[0] * in_c[1] - arm[1] * in_c[0]
