"""Bench of a test: ``hil.Bench`` whose trips are raised, and which returns to its start after the test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hil.api.results import Run
from hil.core.alarms import HIGH, Alarm
from hil.core.modes import Mode
from hil.errors import BenchError
from hil.parts.campaigns.api.bench import Bench, Until


def latest_trip(alarms: Sequence[Alarm]) -> Alarm | None:
    """Return the newest alarm that has stopped the bench; None if there is none."""
    trips = [alarm for alarm in alarms if alarm.priority == HIGH]
    return max(trips, key=lambda alarm: alarm.number) if trips else None


def completed(run: Run) -> Run:
    """Return ``run``; raise BenchError with the text of its alarm if a trip has ended it."""
    trip = latest_trip(run.alarms)
    if trip is not None:
        raise BenchError(trip.text)
    return run


class ProcedureBench(Bench):
    """``hil.Bench`` for one test: ``start`` and ``resume`` raise a trip, which ``hil.Bench`` returns in the run."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._raised = False

    @property
    def latest(self) -> Run | None:
        """The whole run, or the run so far; None before the first ``start``."""
        return self.result or self._latest

    def start(self, until: Until = "end", timeout_s: float = float("inf")) -> Run:
        """Close the loop as ``hil.Bench.start`` does. Raises BenchError also for a trip during the run."""
        return self._unless_tripped(lambda: super(ProcedureBench, self).start(until, timeout_s))

    def resume(self, until: Until = "end", timeout_s: float = float("inf")) -> Run:
        """Continue a run as ``hil.Bench.resume`` does. Raises BenchError also for a trip during the run."""
        return self._unless_tripped(lambda: super(ProcedureBench, self).resume(until, timeout_s))

    def _unless_tripped(self, fly: Any) -> Run:
        run: Run = fly()
        self._raised = latest_trip(run.alarms) is not None
        return completed(run)

    def _execute_step(self, step: Any) -> bool:
        try:
            return super()._execute_step(step)
        except BenchError:
            self._raised = True
            raise

    def return_to_start(self) -> bool:
        """Move to the park position if this session can; return whether the bench is there. Raises BenchError."""
        if self.mode is Mode.ARMED:
            self.disarm()
        if self.mode is not Mode.STANDBY:
            return False
        self.park()
        return True

    def raise_unseen_trip(self) -> None:
        """Raise BenchError if the bench has tripped and no method has raised it."""
        trip = latest_trip(self.alarms)
        if trip is not None and not self._raised:
            raise BenchError(trip.text)
