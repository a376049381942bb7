"""How frames travel in an emulated vision unit: late, twice, out of order, or not at all."""

from __future__ import annotations

import numpy as np


class Transport:
    """Draws for each frame how long after its exposure it arrives; the same generator, the same fate.

    latency_s: constant part. jitter_s: largest random part, uniform. duplicate_share, loss_share: 0..1 of
    the frames that come twice, or never.
    """

    def __init__(
        self,
        generator: np.random.Generator,
        latency_s: float = 0.0,
        jitter_s: float = 0.0,
        duplicate_share: float = 0.0,
        loss_share: float = 0.0,
    ) -> None:
        self._generator = generator
        self._latency_s = latency_s
        self._jitter_s = jitter_s
        self._duplicate_share = duplicate_share
        self._loss_share = loss_share

    @property
    def longest_s(self) -> float:
        """The longest delay that can be drawn."""
        return self._latency_s + self._jitter_s

    def delays(self) -> tuple[float, ...]:
        """Return the delays of the next frame, s: one, two for a repeated frame, none for a lost one."""
        lost, twice, first, second = self._generator.random(4)
        if lost < self._loss_share:
            return ()
        delays = (self._latency_s + first * self._jitter_s, self._latency_s + second * self._jitter_s)
        return delays if twice < self._duplicate_share else delays[:1]
