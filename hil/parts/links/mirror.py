"""Mirror of each cycle's records to the other side of a link, as the mailboxes that it requests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from hil.frmn.mailboxes import HEALTH
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.parts.links.link import Link

_OF_THE_CYCLE: Final = ("truth", "imu", "pose", "command", "setpoint", "feedback")
MIRRORED: Final = (*_OF_THE_CYCLE, "health")
"""Mailboxes that a side can request besides the GNC's."""


class Mirror:
    """Telemetry that also sends the records of a row of CYCLE to the other side if its hello requested them.

    cycles: per row that is sent.
    """

    def __init__(self, link: Link, cycles: int = 1) -> None:
        self._inner: Telemetry = NoTelemetry()
        self._link = link
        self._mode: Callable[[], str] = str
        self._overruns: Callable[[], int] = int
        self._health = np.zeros(1, HEALTH)
        self._cycles = cycles
        self._cycle = -1

    def over(self, rows: Telemetry) -> Telemetry:
        """Return this telemetry, which passes each row on to ``rows``."""
        self._inner = rows
        return self

    def begin(self, mode: Callable[[], str], overruns: Callable[[], int]) -> None:
        """Take what returns the bench's mode and the number of overruns so far."""
        self._mode, self._overruns = mode, overruns

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


def mirror_to(link: Link, parts: SessionParts, cycles: int = 1) -> None:
    """Let the session of ``parts`` send the other side of ``link`` the mailboxes that it requests.

    cycles: per row that is sent.
    """
    mirror = Mirror(link, cycles)
    parts.layers.append(mirror.over)

    def begin(runner: Runner) -> None:
        modes, rate = runner.safety.modes, runner.rate
        mirror.begin(lambda: modes.mode.value, lambda: rate.overruns)

    parts.on_built.append(begin)
