"""Truth of a run on a bench whose geometry was measured and that has no tracker: what its pose is worth."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from hil.loop.outcome import Outcome
from hil.loop.session_parts import PartResult, SessionParts
from hil.params.bench_budget import BenchSigma
from hil.parts.tracker.margins import table_iii_margins
from hil.session.assembly import Job


@contextmanager
def attach(job: Job, parts: SessionParts) -> Iterator[None]:
    """Add the table ``bench_truth`` to the results of the run."""
    scenario, worth = job.scenario.value, BenchSigma(job.rig.value, job.scenario.value.step_s)

    def result(outcome: Outcome) -> PartResult | None:
        if not len(outcome.history):
            return None
        numbers, withheld = table_iii_margins(scenario, worth, outcome)
        return PartResult("bench_truth", numbers | {"off_m": [None] * 3, "off_deg": [None] * 3}, {}, withheld)

    parts.results.append(result)
    yield
