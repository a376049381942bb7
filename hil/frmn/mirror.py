"""Mirror of each cycle's records to the other side of a link, as the mailboxes that it requests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from hil.frmn.link import Link
from hil.frmn.mailboxes import HEALTH
from hil.frmn.ring import Telemetry

_OF_THE_CYCLE: Final = ("truth", "imu", "pose", "command", "setpoint", "feedback")
MIRRORED: Final = (*_OF_THE_CYCLE, "health")
"""Mailboxes that a side can request besides those of the GNC."""


class Mirror:
    """Passes each row of CYCLE on to ``inner``, and its records to the other side if its hello requested them.

    mode: returns the bench's mode; overruns: returns the number of overruns so far. cycles: per row that is sent.
    """

    def __init__(
        self, inner: Telemetry, link: Link, mode: Callable[[], str], overruns: Callable[[], int], cycles: int = 1
    ) -> None:
        self._inner = inner
        self._link = link
        self._mode = mode
        self._overruns = overruns
        self._health = np.zeros(1, HEALTH)
        self._cycles = cycles
        self._cycle = -1

    def put(self, row: np.ndarray) -> None:
        """Copy ``row``, shape (1,) of CYCLE."""
        self._inner.put(row)
        self._cycle += 1
        peer = self._link.peer
        if peer is None or peer.hello is None or self._cycle % self._cycles:
            return
        for cell in peer.hello.wants.intersection(_OF_THE_CYCLE):
            self._link.send(cell, row[cell])
        if "health" in peer.hello.wants:
            t_s, late_s = row["t_s"][0], row["lateness_s"][0]
            self._health[0] = (self._cycle, t_s, self._mode().encode(), late_s, self._overruns())
            self._link.send("health", self._health)
