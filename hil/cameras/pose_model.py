"""What the cameras of a bench without cameras see: the pose of the axes, with the vision unit's noise."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.config.scenario import VisionNoise
from hil.core.messages import Array, PoseFrame
from hil.drivers.vmu.transport import Transport
from hil.dynamics.vision import VISION_NOISE, see
from hil.maths.random_streams import NormalRows, stream


class PoseSensor(Protocol):
    """Whatever turns the bench's encoders into what the vision unit would report."""

    def look(self, rail_m: Array, gimbal_rad: Array, t_s: float) -> PoseFrame | None:
        """Return the measured pose of axes that stand at ``rail_m`` (3,) and ``gimbal_rad`` (3,) at ``t_s``.

        None where the unit would find none.
        """


class PoseModel:
    """Turns axis positions into the pose frame that the vision unit would report."""

    def __init__(self, bench: np.record, stations: np.record, vision: np.record, seed: int) -> None:
        self._bench = bench
        self._stations = stations
        self._vision = vision
        self._noise = NormalRows(stream(seed, "vision"), VISION_NOISE)
        self._r = np.empty(3)
        self._q = np.empty(4)

    def look(self, rail_m: Array, gimbal_rad: Array, t_s: float) -> PoseFrame:
        """Return the measured pose of axes that stand at ``rail_m`` (3,) and ``gimbal_rad`` (3,) at ``t_s``."""
        t_v, q_vt, covariance = np.empty(3), np.empty(4), np.empty((6, 6))
        pose_of_axes(self._bench, rail_m, gimbal_rad, self._r, self._q)
        see(self._vision, self._stations, self._r, self._q, self._noise.next_row(), t_v, q_vt, covariance)
        return PoseFrame(0, t_s, t_s, t_v, q_vt, covariance, leds_left=0x3F, leds_right=0x3F)


def transport(vmu: VisionNoise, seed: int) -> Transport:
    """Return how the frames of a vision unit that is not there travel."""
    return Transport(
        stream(seed, "transport"), vmu.latency_s, vmu.latency_jitter_s, vmu.duplicate_probability, vmu.loss_probability
    )
