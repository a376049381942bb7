"""Gyros on the bench in place of the virtual ones."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from hil.config.rig import Rig
from hil.core.messages import Array
from hil.loop.core_memory import CoreMemory
from hil.maths import quat
from hil.params import bench as bench_params


class RateSource(Protocol):
    """An IMU on the innermost gimbal."""

    def mean_rate(self) -> Array:
        """Return the mean rate of the last cycle in the axes of the IMU, (3,), rad/s; raise DeviceError."""

    def close(self) -> None:
        """Release the wire."""


class BenchGyros:
    """Rates of ``source``, the IMU of ``rig.imu``, as the gyros of a chaser in orbit would measure them.

    It has one sample a cycle. The table turns against the laboratory as the chaser does against H. Its true drift is
    nan: it is not known.
    """

    def __init__(self, source: RateSource, rig: Rig, memory: CoreMemory) -> None:
        assert rig.imu is not None
        self._source, self._now = source, memory.now
        self._to_c = quat.conjugate(quat.from_rotation_vector(np.radians(rig.imu.rotation_deg)))
        self._earth_H = bench_params.earth_rate(rig)

    def measure(self) -> None:
        """Write the rate of the cycle that has ended over that of the virtual gyros. Raises DeviceError."""
        truth, imu = self._now.truth, self._now.imu
        of_H = quat.transform(truth.q_CH, truth.w_HI_H - self._earth_H)
        imu.rate_C = quat.transform(self._to_c, self._source.mean_rate()) + of_H
        imu.drift_C = math.nan

    def close(self) -> None:
        """Release the wire."""
        self._source.close()
