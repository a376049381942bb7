"""Lateness of an empty loop on this host, measured with the loop's own rate keeper in a child process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.core.child_process import ChildProcess
from hil.core.messages import Array
from hil.errors import DeviceError
from hil.loop.overrun_monitor import lateness_histogram, lateness_percentiles_us
from hil.preflight.check import PreflightCheck

DURATION_S = 5.0
WIRED_S = 30.0
"""Of the measurement for a rig on emulated wires: a pause of a shared computer comes once in many seconds."""
FRACTION_OF_PERIOD = 0.1
"""Limit of the 99.9th percentile of the lateness, as a fraction of the period."""

_START_S = 60.0
_BAR = 40


@dataclass(frozen=True, slots=True)
class Lateness:
    """Measured lateness of an empty loop.

    histogram: see ``lateness_histogram``, up to the last bin with cycles; skipped: complete periods lost.
    """

    period_s: float
    cycles: int
    skipped: int
    scheduling: str
    percentiles_us: dict[str, float]
    histogram: list[dict[str, float | int | None]]


def measure(period_s: float, duration_s: float = DURATION_S) -> Lateness:
    """Return the lateness of an empty loop over ``duration_s``, with the privileges that this user gets.

    Raises RuntimeError if the measurement fails.
    """
    configuration = {"period_s": period_s, "duration_s": duration_s}
    try:
        with ChildProcess("lateness probe", "hil.preflight.lateness_probe", configuration) as child:
            reply = child.receive(duration_s + _START_S)
    except DeviceError as error:
        raise RuntimeError(f"the lateness could not be measured: {error}") from error
    return summarise(period_s, np.array(reply["lateness_s"]), reply["skipped"], reply["scheduling"])


def summarise(period_s: float, lateness_s: Array, skipped: int, scheduling: str) -> Lateness:
    """Return the percentiles and the histogram of ``lateness_s`` (n,)."""
    percentiles = lateness_percentiles_us(lateness_s)
    return Lateness(
        period_s, len(lateness_s), skipped, scheduling, percentiles, _occupied(lateness_histogram(lateness_s))
    )


def _occupied(bins: list[dict[str, float | int | None]]) -> list[dict[str, float | int | None]]:
    """Return the bins up to the last one with cycles."""
    return bins[: max((i + 1 for i, b in enumerate(bins) if b["cycles"]), default=0)]


def lateness_check(lateness: Lateness) -> PreflightCheck:
    """Return the check that the loop can keep its rate on this host."""
    p = lateness.percentiles_us
    allowed_us = FRACTION_OF_PERIOD * lateness.period_s * 1e6
    fine = p["p999"] < allowed_us
    value = (
        f"p50 {p['p50']:.0f}, p99 {p['p99']:.0f}, p99.9 {p['p999']:.0f}, max {p['max']:.0f} us "
        f"under {lateness.scheduling}, {lateness.cycles} cycles at {1.0 / lateness.period_s:g} Hz, "
        f"{lateness.skipped} periods lost; "
        f"p99.9 allowed below {allowed_us:.0f} us ({FRACTION_OF_PERIOD:.0%} of the period)"
    )
    advice = "" if fine else "stop other processes, see scheduling and governor, or use a dedicated host"
    return PreflightCheck("lateness", fine, value, advice)


def pause_check(lateness: Lateness, pump_timeout_s: float | None, on_hardware: bool) -> PreflightCheck:
    """Return the check that no pause of the host would have opened the safety chain.

    pump_timeout_s: after which the relay opens without an edge of the charge pump; None without digital I/O.
    """
    longest_s, measured_s = 1e-6 * lateness.percentiles_us["max"], lateness.cycles * lateness.period_s
    value = f"longest {1e3 * longest_s:.1f} ms in {measured_s:.0f} s"
    if pump_timeout_s is None:
        return PreflightCheck("host pauses", None, value)
    fine = longest_s < pump_timeout_s
    value += f", allowed below io.pump_timeout_s, {1e3 * pump_timeout_s:g} ms"
    advice = "" if fine else "end other programs and virtual machines, or use a host of the bench's own"
    return PreflightCheck("host pauses", fine or (False if on_hardware else None), value, advice)


def histogram_lines(lateness: Lateness) -> list[str]:
    """Return the histogram as lines of text; the bars are proportional to the logarithm of the counts."""
    counts = [int(b["cycles"] or 0) for b in lateness.histogram]
    lines = []
    for entry, count in zip(lateness.histogram, counts, strict=True):
        bar = "#" * max(1, round(_BAR * np.log1p(count) / np.log1p(max(counts)))) if count else ""
        edge = f"below {entry['below_us']:>6.0f} us" if entry["below_us"] is not None else "later".ljust(15)
        lines.append(f"{edge} {count:>7} {bar}".rstrip())
    return lines
