"""What came last from a GNC elsewhere, as records for the kernels, and the truth of the cycles that it is about."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.core.messages import IMU, TRUTH, new
from hil.frmn.link import Arrival
from hil.frmn.mailboxes import GNC_FILTERS, GNC_FLIGHT
from hil.gnc import navigation
from hil.gnc.fusion import FILTERS
from hil.gnc_backends import udp_records

REMEMBERED: Final = 16
"""Cycles whose truth is kept for filters that come late."""


class ReceiveBuffers:
    """What came last, as records for the kernels."""

    def __init__(self) -> None:
        self._flights, self._filters = np.zeros(1, GNC_FLIGHT), np.zeros(1, GNC_FILTERS)
        flight = self._flights.view(np.recarray)[0]
        self.output, self.navigation, self.command = flight.output, flight.navigation, flight.command
        self.has_flight = False
        self.filters: np.record = new(FILTERS)
        self.filters_of = -1
        """Cycle of the filters that were not used yet, -1 for none."""
        self._newest_filters = -1
        self._told_filters = self._filters.view(np.recarray)[0]
        self._flight_bytes = self._flights.view(np.uint8).data
        self._filter_bytes = self._filters.view(np.uint8).data
        udp_records.take_flight(self.navigation, self.command, self.navigation, self.command)
        udp_records.take_filters(self._told_filters, self.filters)
        navigation.normalised_errors(self.filters, new(TRUTH), new(IMU), np.empty(2))

    @staticmethod
    def output_in(arrival: Arrival) -> np.ndarray:
        """Return the output, (1,) of GNC_OUTPUT, that ``arrival`` holds."""
        return arrival.record["output"] if arrival.name == "gnc.flight" else arrival.record

    @staticmethod
    def is_of(arrival: Arrival, reference: np.record) -> bool:
        """Return whether ``arrival`` holds a command of our control that braked, or did not, as ``reference`` says."""
        return arrival.name == "gnc.flight" and int(arrival.record["command"]["boost"][0]) == int(reference.boost)

    def take(self, arrival: Arrival) -> int:
        """Make ``arrival`` the present one; return the cycle that it answers."""
        self.has_flight = arrival.name == "gnc.flight"
        whole = arrival.record.view(np.uint8).data
        self._flight_bytes[: len(whole)] = whole
        return int(self.output.cycle)

    def take_filters(self, record: np.ndarray) -> None:
        """Keep GNC_FILTERS (1,), each cycle's once: an answer that is told again brings them again."""
        cycle = int(record["cycle"][0])
        if cycle <= self._newest_filters:
            return
        self._newest_filters = self.filters_of = cycle
        self._filter_bytes[:] = record.view(np.uint8).data
        udp_records.take_filters(self._told_filters, self.filters)


class Past:
    """The last records of ``dtype``, by cycle."""

    def __init__(self, dtype: np.dtype) -> None:
        kept = np.zeros(REMEMBERED, dtype)
        self._records = [kept.view(np.recarray)[i] for i in range(REMEMBERED)]
        self._bytes = kept.view(np.uint8).data
        self._size = dtype.itemsize

    def put(self, cycle: int, record: np.record) -> None:
        start = cycle % REMEMBERED * self._size
        self._bytes[start : start + self._size] = record.tobytes()

    def at(self, cycle: int) -> np.record:
        record: np.record = self._records[cycle % REMEMBERED]
        return record
