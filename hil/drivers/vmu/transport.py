"""Transport of frames of an emulated vision unit: delays, duplicates, reordering, losses."""

from __future__ import annotations

import numpy as np

from hil.core.messages import new
from hil.maths.random_streams import NoiseSource, UniformRows
from hil.models.camera_timing import TRAVEL, TRAVEL_DRAWS, delays


class Transport:
    """Draws for each frame how long after its exposure it arrives; the same generator, the same fate.

    latency_s: constant part. jitter_s: largest random part, uniform. duplicate_probability, loss_probability: 0..1 of
    the frames that come twice, or never.
    """

    def __init__(
        self,
        generator: NoiseSource,
        latency_s: float = 0.0,
        jitter_s: float = 0.0,
        duplicate_probability: float = 0.0,
        loss_probability: float = 0.0,
    ) -> None:
        self.draws = UniformRows(generator, TRAVEL_DRAWS)
        """One row per exposure."""
        self._travel = new(TRAVEL)
        self._travel.latency_s, self._travel.jitter_s = latency_s, jitter_s
        self._travel.duplicate_probability, self._travel.loss_probability = duplicate_probability, loss_probability
        self._delays = np.empty(2)

    @property
    def longest_s(self) -> float:
        """The longest delay that can be drawn."""
        return float(self._travel.latency_s + self._travel.jitter_s)

    def delays(self) -> tuple[float, ...]:
        """Return the delays of the next frame, s: one, two for a repeated frame, none for a lost one."""
        count = delays(self._travel, self.draws.next_row(), self._delays)
        return tuple(float(delay) for delay in self._delays[:count])
