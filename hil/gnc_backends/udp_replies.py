"""What the GNC at the other end of a link says: its answer to the setup, its state, and its answers cycle by cycle."""

from __future__ import annotations

import math
import time
from typing import Final

import numpy as np

from hil.core.gnc_records import GncState
from hil.errors import DeviceError
from hil.frmn.link import Arrival, Link
from hil.gnc_backends.external import printable
from hil.gnc_backends.udp_receiver import ReceiveBuffers
from hil.gnc_backends.udp_stats import LinkStats

_IN_A_CYCLE: Final = 64  # datagrams that are looked at: a flood must not keep the loop
_STATES: Final = frozenset(state.value for state in GncState)
_BACKLOG: Final = 4096  # with the loop open: what came while devices were opened
_AGAIN_S: Final = 0.1  # wall time from one setup that is not answered to the next
_RESEND_S: Final = 0.05  # wall time after which an input of lock-step in simulated time goes out again
_PATIENCE_S: Final = 10.0  # wall time that lock-step in simulated time waits for an answer


class ReplyReceiver:
    """Hears the GNC called ``name``. lock_step: only the answer to the present input counts, not the newest one.

    setup: GNC_SETUP, which is sent until it is answered. patience_s: wall time that lock-step waits for an answer;
    None in simulated time, where it waits until it is hopeless.
    """

    def __init__(
        self,
        name: str,
        link: Link,
        inbox: ReceiveBuffers,
        account: LinkStats,
        setup: np.record,
        lock_step: bool,
        patience_s: float | None,
    ) -> None:
        self.state = GncState.STARTING
        """What the GNC says of itself."""
        self.used = -1
        """Cycle of the answer that was used last."""
        self._name = name
        self._link = link
        self._inbox = inbox
        self._account = account
        self._setup = setup
        self._lock_step = lock_step
        self._limit_s = _PATIENCE_S if patience_s is None else patience_s
        self._again_s = _RESEND_S if patience_s is None else patience_s / 2.0
        self._newest: Arrival | None = None  # not used yet
        self._set_up_for = 0  # link.joined of the side that has acknowledged its setup
        self._setup_sent_s = -math.inf

    @property
    def is_set_up(self) -> bool:
        """Whether who sits at the other end has answered the setup."""
        return self._link.joined > 0 and self._set_up_for == self._link.joined

    def poll(self, cycle: int) -> None:
        """Say what is due, hear what has come while the loop was open, and set up a GNC that is new."""
        self._link.service()
        self.hear(cycle, at_most=_BACKLOG)
        self._newest = None
        now_s = time.monotonic()
        alive = self._link.alive(now_s)
        # one at a known address may say no hello
        wanted = not self.is_set_up if alive else self._link.expects
        if wanted and now_s - self._setup_sent_s > _AGAIN_S:
            self._setup_sent_s = now_s
            self._link.send("gnc.setup", self._setup)

    def forget_setup(self) -> None:
        """Set the GNC up anew before anything else is taken from it."""
        self._set_up_for = 0

    def take(self) -> bool:
        """Bring the newest answer into the inbox; False where none is there that was not used yet."""
        newest, self._newest = self._newest, None
        if newest is None or not self.is_set_up:
            return False
        self.used = self._inbox.take(newest)
        return True

    def wait(self, cycle: int, asked: np.record, reference: np.record | None = None) -> None:
        """Wait for the answer to ``asked`` (GNC_INPUT), the input of ``cycle``, and ask again meanwhile.

        reference: see ``hear``.
        """
        now_s = time.monotonic()
        give_up_s, resend_s = now_s + self._limit_s, now_s + self._again_s
        while True:
            self.hear(cycle, reference)
            if self._newest is not None and self._cycle_of(self._newest) == cycle:
                return
            now_s = time.monotonic()
            gone = self._link.peer is not None and self._link.peer.gone
            if now_s >= give_up_s or gone or not self.is_set_up:
                self._newest = None
                return
            if now_s >= resend_s:
                resend_s = now_s + self._again_s
                self._account.resent += 1
                self._link.send("gnc.input", asked)
            self._link.wait(min(give_up_s, resend_s) - now_s)

    def hear(self, cycle: int, reference: np.record | None = None, at_most: int = _IN_A_CYCLE) -> None:
        """Take what has come until ``cycle``. Raises DeviceError where the GNC reports a fault.

        reference: where the cycle's input has gone out a second time with another REFERENCE, that one: answers to
        the input before it are passed over.
        """
        for arrival in self._link.poll(at_most):
            if arrival.name == "gnc.filters":
                self._inbox.take_filters(arrival.record)
            else:
                self._hear_answer(arrival, cycle, reference)

    def _hear_answer(self, arrival: Arrival, cycle: int, reference: np.record | None) -> None:
        output = self._inbox.output_in(arrival)
        of, state = self._cycle_of(arrival), int(output["state"][0])
        if state in _STATES:
            self.state = GncState(state)
        if self.state is GncState.FAULT:
            raise DeviceError(self._name, printable(output["text"][0]) or "reports a fault")
        if not self.is_set_up:
            if of == -1:
                self._set_up_for = self._link.joined
            return
        self._account.answered(of, arrival.received_s)
        if not self.used < of <= cycle:
            return  # told again, or none of a cycle
        if self._lock_step and of < cycle:
            self._account.late += 1
            return
        if reference is not None and not self._inbox.is_of(arrival, reference):
            return  # asked for before the reference changed
        self._newest = arrival

    def _cycle_of(self, arrival: Arrival) -> int:
        return int(self._inbox.output_in(arrival)["cycle"][0])
