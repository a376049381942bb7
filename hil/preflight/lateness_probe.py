"""Lateness probe: keeps the rate of an empty loop for some seconds and sends the lateness of each cycle.

``python -m hil.preflight.lateness_probe`` is started by ``hil.preflight.lateness``.
"""

from hil.core.child_process import Message, Parent
from hil.core.clock import WallClock
from hil.core.realtime import FIFO, FIFO_PRIORITY, RealTime, no_garbage_collection
from hil.loop.rate_keeper import WallClockRate


def measure(period_s: float, duration_s: float) -> Message:
    """Keep the rate for ``duration_s``; a lost period counts as lateness of the cycle after it."""
    rate = WallClockRate(WallClock(), period_s)
    lateness_s = []
    with RealTime() as realtime, realtime.realtime_priority(), no_garbage_collection():
        scheduling = f"SCHED_FIFO {FIFO_PRIORITY}" if realtime.granted(FIFO) else "SCHED_OTHER"
        rate.restart()
        for _ in range(max(1, round(duration_s / period_s))):
            skipped = rate.skipped_periods
            late_s = rate.wait().lateness_s
            lateness_s.append(late_s + (rate.skipped_periods - skipped) * period_s)
    return {"lateness_s": lateness_s, "skipped": rate.skipped_periods, "scheduling": scheduling}


def main() -> None:
    """Measure with the configured period and duration."""
    parent = Parent()
    parent.send(**measure(**parent.configuration))


if __name__ == "__main__":
    main()
