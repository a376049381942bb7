"""Setpoints of the groups of axes that one robot stands for."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hil.core.messages import Array


class JoinedSetpoints:
    """Setpoints of ``groups``, given one group after the other, that go to their robot together."""

    def __init__(self, groups: Iterable[str]) -> None:
        self._given: dict[str, tuple[Array, Array, float] | None] = dict.fromkeys(groups)

    def forget(self, group: str) -> None:
        """Discard the setpoint of a group that waits for the others."""
        self._given[group] = None

    def joined(self, group: str, position: Array, rate: Array, now_s: float) -> tuple[Array, Array] | None:
        """Take the setpoint of a group; return positions and rates (n,) of all once they are of one time, else None."""
        self._given[group] = position, rate, now_s
        given = [each for each in self._given.values() if each is not None and each[2] == now_s]
        if len(given) < len(self._given):
            return None
        return np.concatenate([each[0] for each in given]), np.concatenate([each[1] for each in given])
