"""Cost of recording: microseconds per cycle in the loop, and data rate on disk.

python benchmarks/recording.py [--seconds 20]

A paced loop puts rows of a real run of scheme 1 into the rings of the recorder process, as a run on wires does, at
50 Hz and at 1 kHz, with a frame of the vision unit at 12.5 Hz. In alternation: the same loop with a ring
without a reader, as in every run on wires. The difference is the cost of recording.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np

import hil
from hil.config.load import load_rig, load_scenario
from hil.core.messages import ARRIVAL, CYCLE
from hil.frmn.ring import Ring, Telemetry
from hil.recording.session import recording
from hil.session import build

FRAME_HZ = 12.5
RATES_HZ = (50.0, 1000.0)


def flown() -> np.ndarray:
    """Return rows of a run on the mock rig, with realistic compressibility."""
    return hil.run("scheme-1", duration_s=20.0).history


def paced(
    rows: np.ndarray, rate_hz: float, seconds: float, cycles: Telemetry, arrivals: Telemetry | None
) -> np.ndarray:
    """Write a row each period, and periodically a frame; return the cost of each cycle, us."""
    n, each = round(rate_hz * seconds), round(rate_hz / FRAME_HZ)
    cost_us = np.empty(n)
    row, frame = rows[:1].copy(), np.zeros(1, ARRIVAL)
    begun = time.monotonic()
    for k in range(n):
        row[0] = rows[k % len(rows)]
        row["t_s"] = k / rate_hz
        time.sleep(max(0.0, begun + k / rate_hz - time.monotonic()))
        before = time.perf_counter_ns()
        cycles.put(row)
        if arrivals is not None and k % each == 0:
            frame["cycle"] = k
            arrivals.put(frame)
        cost_us[k] = 1e-3 * (time.perf_counter_ns() - before)
    return cost_us


def shown(cost_us: np.ndarray) -> str:
    p50, p99, p999 = np.percentile(cost_us, [50.0, 99.0, 99.9])
    return f"mean {cost_us.mean():5.2f}  p50 {p50:5.2f}  p99 {p99:6.2f}  p99.9 {p999:7.2f} us a cycle"


def cpu_s() -> float:
    """Return the CPU time of the children that have ended, s."""
    times = os.times()
    return times.children_user + times.children_system


def measure(rows: np.ndarray, rate_hz: float, seconds: float) -> None:
    job = build.Job(load_scenario("scheme-1", [f"step_s={1.0 / rate_hz}"]), load_rig("emulated"), 0, seconds, 1.0)
    ring = Ring.create(CYCLE, 2048)
    alone = paced(rows, rate_hz, seconds, ring, None)
    ring.close()
    with tempfile.TemporaryDirectory() as folder:
        before_s = cpu_s()
        with recording(job, "emulated", Path(folder), lambda _: None) as taken:
            recorded = paced(rows, rate_hz, seconds, taken.sinks["cycles"], taken.sinks["arrivals"])
            account = taken.break_off("benchmark")
        used_s = cpu_s() - before_s
    print(f"\n{rate_hz:g} Hz, {seconds:g} s")
    print(f"  ring without a reader  {shown(alone)}")
    print(f"  recorded                {shown(recorded)}")
    print(f"  recording adds          {np.median(recorded) - np.median(alone):+.2f} us at the median")
    print(
        f"  file {account.size_bytes / 1e6 / seconds:.3f} MB/s ({3.6 * account.size_bytes / 1e6 / seconds:.2f} GB/h), "
        f"{account.cycles} cycles, {account.dropped} messages dropped; "
        f"recorder process {100.0 * used_s / seconds:.0f} % of a CPU, its start included"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    rows = flown()
    for rate_hz in RATES_HZ:
        measure(rows, rate_hz, options.seconds)


if __name__ == "__main__":
    main()
