"""Receiver of the GNC at the other end of a link: setup acknowledgement, state, and replies cycle by cycle.

Round trips, delays and missing replies are counted, as numbers for JSON.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from hil.core.gnc_records import GncState
from hil.core.messages import IMU, TRUTH, new
from hil.errors import DeviceError
from hil.frmn.mailboxes import GNC_FILTERS, GNC_FLIGHT
from hil.gnc.estimation import navigation
from hil.gnc.estimation.error_state import FILTERS
from hil.gnc.estimation.target_orbit import TARGET_ORBIT
from hil.gnc_backends.output_texts import printable
from hil.parts.links import udp_records
from hil.parts.links.link import Arrival, Link

_SENT: Final = 1024  # inputs whose time of sending is kept


class LinkStats:
    """Counts the outcome of each input. mode: "lock-step" or "free-running"."""

    def __init__(self, link: Link, mode: str) -> None:
        self.mode = mode
        self.coasted = self.closed = 0
        """Cycles without a reply in which the last command was kept; in which all thrusters were closed."""
        self.late = 0
        """Replies that came after the timeout of their cycle."""
        self.resent = 0
        self.losses = 0
        self._link = link
        self._sent_s = np.full(_SENT, math.nan)
        self._round_trips_s: list[float] = []
        self._delays: dict[int, int] = {}

    def sent(self, cycle: int) -> None:
        """Record that the input ``cycle`` is sent now."""
        self._sent_s[cycle % _SENT] = time.monotonic()

    def answered(self, cycle: int, received_s: float) -> None:
        """Record that the reply to input ``cycle`` came at ``received_s``, monotonic time."""
        self._round_trips_s.append(received_s - float(self._sent_s[cycle % _SENT]))
        self._sent_s[cycle % _SENT] = math.nan

    def used(self, delay: int) -> None:
        """Record that a reply acts ``delay`` cycles after its input."""
        self._delays[delay] = self._delays.get(delay, 0) + 1

    def as_json(self) -> dict[str, Any]:
        """Return all statistics; unknown ones are None."""
        trips_us = 1e6 * np.array([trip for trip in self._round_trips_s if math.isfinite(trip)])
        clock, used = self._link.clock, sum(self._delays.values())
        return {
            "mode": self.mode,
            "round_trip_us": {
                name: float(np.percentile(trips_us, percent)) if len(trips_us) else None
                for name, percent in (("p50", 50.0), ("p99", 99.0), ("max", 100.0))
            },
            "delay_cycles": sum(delay * n for delay, n in self._delays.items()) / used if used else None,
            "delay_cycles_max": max(self._delays, default=None),
            "answers": used,
            "coasted_cycles": self.coasted,
            "closed_cycles": self.closed,
            "late": self.late,
            "resent": self.resent,
            "losses": self.losses,
            "joined": self._link.joined,
            "clock_offset_us": 1e6 * clock.offset_s if clock.known else None,
            "clock_round_trip_us": 1e6 * clock.round_trip_s if clock.known else None,
            **self._link.counters(),
            "refused": list(self._link.complaints),
        }


KEPT_CYCLES: Final = 16
"""Cycles whose truth is kept for filter states that come late."""
_PER_CYCLE: Final = 64  # datagrams that are read: a flood must not delay the loop
_STATES: Final = frozenset(state.value for state in GncState)
_BACKLOG: Final = 4096  # the same with the loop open: what came while devices were opened
_SETUP_AGAIN_S: Final = 0.1  # wall time after which a setup that is not answered is sent again
_RESEND_S: Final = 0.05  # wall time after which lock-step in simulated time sends an input again
_TIMEOUT_S: Final = 10.0  # wall time that lock-step in simulated time waits for a reply


class ReceiveBuffers:
    """Newest reply and newest filter states, as records for the kernels."""

    def __init__(self) -> None:
        self._flights, self._filters = np.zeros(1, GNC_FLIGHT), np.zeros(1, GNC_FILTERS)
        flight = self._flights.view(np.recarray)[0]
        self.output, self.navigation, self.command = flight.output, flight.navigation, flight.command
        self.has_flight = False
        self.filters: np.record = new(FILTERS)
        self.filters_of = -1
        """Cycle of filter states that have not been used yet, -1 for none."""
        self._newest_filters = -1
        self._received_filters = self._filters.view(np.recarray)[0]
        self._flight_bytes = self._flights.view(np.uint8).data
        self._filter_bytes = self._filters.view(np.uint8).data
        udp_records.read_flight(self.navigation, self.command, self.navigation, self.command)
        udp_records.read_filters(self._received_filters, self.filters)
        navigation.normalised_errors(self.filters, new(TARGET_ORBIT), new(TRUTH), new(IMU), np.empty(2))

    @staticmethod
    def output_in(arrival: Arrival) -> np.ndarray:
        """Return the output, (1,) of GNC_OUTPUT, in ``arrival``."""
        return arrival.record["output"] if arrival.name == "gnc.flight" else arrival.record

    @staticmethod
    def follows(arrival: Arrival, reference: np.record) -> bool:
        """Return whether ``arrival`` holds a command that brakes if, and only if, ``reference`` does."""
        return arrival.name == "gnc.flight" and int(arrival.record["command"]["boost"][0]) == int(reference.boost)

    def take(self, arrival: Arrival) -> int:
        """Copy ``arrival`` into the records; return the cycle that it answers."""
        self.has_flight = arrival.name == "gnc.flight"
        whole = arrival.record.view(np.uint8).data
        self._flight_bytes[: len(whole)] = whole
        return int(self.output.cycle)

    def take_filters(self, record: np.ndarray) -> None:
        """Keep GNC_FILTERS (1,), once per cycle: a repeated reply repeats them."""
        cycle = int(record["cycle"][0])
        if cycle <= self._newest_filters:
            return
        self._newest_filters = self.filters_of = cycle
        self._filter_bytes[:] = record.view(np.uint8).data
        udp_records.read_filters(self._received_filters, self.filters)


class CycleBuffer:
    """The last KEPT_CYCLES records of ``dtype``, by cycle."""

    def __init__(self, dtype: np.dtype) -> None:
        kept = np.zeros(KEPT_CYCLES, dtype)
        self._records = [kept.view(np.recarray)[i] for i in range(KEPT_CYCLES)]
        self._bytes = kept.view(np.uint8).data
        self._size = dtype.itemsize

    def put(self, cycle: int, record: np.record) -> None:
        """Keep a copy of ``record``."""
        start = cycle % KEPT_CYCLES * self._size
        self._bytes[start : start + self._size] = record.tobytes()

    def at(self, cycle: int) -> np.record:
        """Return the record of ``cycle``, one of the last KEPT_CYCLES."""
        record: np.record = self._records[cycle % KEPT_CYCLES]
        return record


class ReplyReceiver:
    """Receives the replies of the GNC ``name``.

    setup: GNC_SETUP, which is sent until it is answered. lock_step: only the reply to the present input counts, not the
    newest one. timeout_s: wall time that lock-step waits for a reply; None in simulated time.
    """

    def __init__(
        self,
        name: str,
        link: Link,
        buffers: ReceiveBuffers,
        stats: LinkStats,
        setup: np.record,
        lock_step: bool,
        timeout_s: float | None,
    ) -> None:
        self.state = GncState.STARTING
        """State that the GNC has reported."""
        self.used = -1
        """Cycle of the reply that was used last."""
        self._name = name
        self._link = link
        self._buffers = buffers
        self._stats = stats
        self._setup = setup
        self._lock_step = lock_step
        self._limit_s = _TIMEOUT_S if timeout_s is None else timeout_s
        self._again_s = _RESEND_S if timeout_s is None else timeout_s / 2.0
        self._newest: Arrival | None = None  # not used yet
        self._set_up_for = 0  # link.joined of the side that has acknowledged its setup
        self._setup_sent_s = -math.inf

    @property
    def is_set_up(self) -> bool:
        """Whether the present peer has answered the setup."""
        return self._link.joined > 0 and self._set_up_for == self._link.joined

    def poll(self, cycle: int) -> None:
        """Service the link, receive what has come while the loop was open, and set up a new GNC."""
        self._link.service()
        self.receive(cycle, at_most=_BACKLOG)
        self._newest = None
        now_s = time.monotonic()
        alive = self._link.alive(now_s)
        # a peer at a known address may send no hello
        is_due = not self.is_set_up if alive else self._link.expects
        if is_due and now_s - self._setup_sent_s > _SETUP_AGAIN_S:
            self._setup_sent_s = now_s
            self._link.send_setup(self._setup)

    def forget_setup(self) -> None:
        """Require a new setup before any further reply is used."""
        self._set_up_for = 0

    def take(self) -> bool:
        """Copy the newest reply into the buffers; return False if there is none that was not used yet."""
        newest, self._newest = self._newest, None
        if newest is None or not self.is_set_up:
            return False
        self.used = self._buffers.take(newest)
        return True

    def wait(self, cycle: int, send: Callable[[], None], reference: np.record | None = None) -> None:
        """Wait for the reply to the input of ``cycle``; send it again meanwhile.

        send: sends the input. reference: see ``receive``.
        """
        now_s = time.monotonic()
        give_up_s, resend_s = now_s + self._limit_s, now_s + self._again_s
        while True:
            self.receive(cycle, reference)
            if self._newest is not None and self._cycle_of(self._newest) == cycle:
                return
            now_s = time.monotonic()
            gone = self._link.peer is not None and self._link.peer.gone
            if now_s >= give_up_s or gone or not self.is_set_up:
                self._newest = None
                return
            if now_s >= resend_s:
                resend_s = now_s + self._again_s
                self._stats.resent += 1
                send()
            self._link.wait(min(give_up_s, resend_s) - now_s)

    def receive(self, cycle: int, reference: np.record | None = None, at_most: int = _PER_CYCLE) -> None:
        """Receive what has come until ``cycle``. Raises DeviceError if the GNC reports a fault.

        reference: if the cycle's input was sent a second time, the new REFERENCE in it: replies to the first are
        ignored.
        """
        for arrival in self._link.poll(at_most):
            if arrival.name == "gnc.filters":
                self._buffers.take_filters(arrival.record)
            else:
                self._receive_reply(arrival, cycle, reference)

    def _receive_reply(self, arrival: Arrival, cycle: int, reference: np.record | None) -> None:
        output = self._buffers.output_in(arrival)
        of, state = self._cycle_of(arrival), int(output["state"][0])
        if state in _STATES:
            self.state = GncState(state)
        if self.state is GncState.FAULT:
            raise DeviceError(self._name, printable(output["text"][0]) or "reports a fault")
        if not self.is_set_up:
            if of == -1:
                self._set_up_for = self._link.joined
            return
        self._stats.answered(of, arrival.received_s)
        if not self.used < of <= cycle:
            return  # repeated, or not of a cycle
        if self._lock_step and of < cycle:
            self._stats.late += 1
            return
        if reference is not None and not self._buffers.follows(arrival, reference):
            return  # to the input before the reference changed
        self._newest = arrival

    def _cycle_of(self, arrival: Arrival) -> int:
        return int(self._buffers.output_in(arrival)["cycle"][0])
