"""Lateness of the loop's wake-ups and of cyclictest, interleaved in one run, alone and with other load.

python benchmarks/lateness.py [--rounds 5] [--seconds 12] [--rate-hz 1000] [--without-cycle]

Two rows of the product: the bare loop (wait and one row into the telemetry ring) and the whole cycle on
the mock rig. Lateness is the clock just after the wait minus the deadline. Reference: Debian's rt-tests,
``cyclictest --policy=fifo -p 90 -m --default-system``. Without --default-system it holds
/dev/cpu_dma_latency at 0, which on a virtual machine increases the lateness and makes the comparison unfair.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.core.clock import WallClock
from hil.core.messages import CYCLE
from hil.core.realtime import RealTime, no_garbage_collection
from hil.frmn.ring import Ring
from hil.loop.rate_keeper import Tick, WallClockRate
from hil.loop.session_parts import SessionParts
from hil.session import build
from hil.session.warm_up import warm_up

ROWS = 2048
LONGEST_US = 20_000  # cyclictest's histogram; larger values count as this
GOAL = {"p50": 0.05, "p99": 0.15, "p99.9": 0.5}  # of cyclictest's
GOAL_MISSED_PPM = 300  # more than cyclictest, on a shared virtual machine
SITUATIONS = ("alone", "two readers", "two readers and a hog on each CPU")

READER = """
import sys, time
from hil.frmn.ring import Ring
from hil.core.messages import CYCLE
ring = Ring(int(sys.argv[1]), CYCLE, int(sys.argv[2]))
reader, path, pause_s = ring.reader(), sys.argv[3], float(sys.argv[4])
with open(path, "wb") as out:
    while True:
        rows = reader.read()
        out.write(rows.tobytes())
        if len(rows):
            str(rows[-1])
        out.seek(0)
        out.write(b"%d %d \\n" % (reader.got, reader.lost))
        out.flush()
        time.sleep(pause_s)
"""


@dataclass
class Tally:
    """Pooled blocks of one row in one situation: lateness and end of the cycle after its deadline, us."""

    late_us: list[np.ndarray] = field(default_factory=list)
    end_us: list[np.ndarray] = field(default_factory=list)
    put_us: list[np.ndarray] = field(default_factory=list)
    missed: int = 0
    steal_ms: float = 0.0

    def percentiles(self) -> list[float]:
        return [float(value) for value in np.percentile(np.concatenate(self.late_us), [50.0, 99.0, 99.9])]

    @property
    def missed_ppm(self) -> float:
        return 1e6 * self.missed / (self.missed + sum(map(len, self.late_us)))


class MeasuredRate(WallClockRate):
    """Rate keeper that records how long after its deadline each cycle ended."""

    def __init__(self, clock: WallClock, step_s: float) -> None:
        self.ends_ns: list[int] = []
        super().__init__(clock, step_s)

    def wait(self) -> Tick:
        self.ends_ns.append(time.monotonic_ns() - self._deadline_ns)
        return super().wait()


def bare_block(cycles: int, rate_hz: float, ring: Ring, tally: Tally) -> None:
    """Wait and put a row, ``cycles`` times."""
    late_s, put_ns = np.zeros(cycles), np.zeros(cycles)
    row = np.zeros(1, CYCLE)
    now_ns = time.perf_counter_ns
    with RealTime() as real_time, no_garbage_collection(), real_time.realtime_priority():
        rate = WallClockRate(WallClock(), 1.0 / rate_hz)
        rate.restart()
        for k in range(cycles):
            tick = rate.wait()
            late_s[k] = tick.lateness_s
            before_ns = now_ns()
            ring.put(row)
            put_ns[k] = now_ns() - before_ns
    tally.late_us.append(1e6 * late_s)
    tally.put_us.append(1e-3 * put_ns)
    tally.missed += rate.skipped_periods


def cycle_block(cycles: int, rate_hz: float, ring: Ring, tally: Tally) -> None:
    """Run scheme 1 on the mock rig, its steps paced to ``rate_hz`` in real time."""
    scenario = load_scenario("scheme-1")
    step_s = scenario.value.step_s
    job = build.Job(scenario, load_rig("mock"), 0, (cycles - 1) * step_s, 1.0)
    with RealTime() as real_time:
        rate = MeasuredRate(WallClock(speed=rate_hz * step_s), step_s)
        outcome = build.in_memory(job, rate, SessionParts(scheduling=real_time, telemetry=ring)).run()
    tally.late_us.append(1e6 * outcome.history["lateness_s"])
    tally.end_us.append(1e-3 * np.array(rate.ends_ns[-len(outcome.history) + 1 :]))
    tally.missed += outcome.skipped_periods
    if outcome.faults:
        print(f"    the whole cycle ended early: {outcome.stop}")


def cyclictest_block(cycles: int, rate_hz: float, _ring: Ring, tally: Tally) -> None:
    """Run cyclictest and read its histogram, 1 us per bucket."""
    period_us = round(1e6 / rate_hz)
    command = ["cyclictest", "--policy=fifo", "-p", "90", "-m", "--default-system", "-q", "-t", "1"]
    command += ["-i", str(period_us), "-l", str(cycles), "-h", str(LONGEST_US)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"cyclictest ended with {done.returncode}: {done.stderr.strip()}")
    counts = np.zeros(LONGEST_US + 1, dtype=int)
    for line in done.stdout.splitlines():
        if line.startswith("# Histogram Overflows:"):
            counts[LONGEST_US] += int(line.split()[-1])
        elif line[:1].isdigit():
            bucket, count = line.split()
            counts[int(bucket)] += int(count)
    late_us = np.repeat(np.arange(LONGEST_US + 1), counts)
    tally.late_us.append(late_us.astype(float))
    tally.missed += int((late_us // period_us).sum())


LINES: dict[str, Callable[[int, float, Ring, Tally], None]] = {
    "cyclictest": cyclictest_block,
    "bare loop and ring": bare_block,
    "whole cycle and ring": cycle_block,
}


@contextmanager
def company(situation: str, ring: Ring) -> Iterator[list[str]]:
    """Start the processes that run with the loop; yield the files with the readers' received and lost rows."""
    with ExitStack() as stack:
        notes = []
        if situation != SITUATIONS[0]:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            for name, pause_s in (("recorder", 0.01), ("console", 0.05)):
                notes.append(os.path.join(folder, name))
                arguments = [str(ring.descriptor), str(ROWS), notes[-1], str(pause_s)]
                start(stack, [sys.executable, "-c", READER, *arguments], ring.descriptor)
        if situation == SITUATIONS[2]:
            for _ in range(os.cpu_count() or 1):
                start(stack, [sys.executable, "-c", "while True: pass"])
        time.sleep(0.5)
        yield notes


def start(stack: ExitStack, command: list[str], *descriptors: int) -> None:
    process = stack.enter_context(subprocess.Popen(command, pass_fds=descriptors))
    stack.callback(process.kill)


def check_readers(notes: list[str], ring: Ring) -> int:
    """Return how many rows the slower reader lost; every row must be accounted for."""
    lost = 0
    for note in notes:
        give_up_s = time.monotonic() + 10.0
        while True:
            with open(note, "rb") as file:
                words = file.readline().split()
            if len(words) == 2 and sum(map(int, words)) == ring.written:
                break
            if time.monotonic() > give_up_s:
                sys.exit(f"rows unaccounted for: {ring.written} written, a reader reports {words}")
            time.sleep(0.05)
        lost = max(lost, int(words[1]))
    return lost


def steal_ms() -> float:
    """Return the time that the host took from this virtual machine since it was started."""
    with open("/proc/stat", encoding="ascii") as stat:
        return 1e3 * int(stat.readline().split()[8]) / os.sysconf("SC_CLK_TCK")


def measure(situation: str, lines: list[str], rounds: int, cycles: int, rate_hz: float) -> tuple[dict[str, Tally], int]:
    """Return the pooled blocks of each row, taken in changing order, and the rows that a reader lost."""
    tallies = {line: Tally() for line in lines}
    order, lost = random.Random(1), 0
    for _ in range(rounds):
        for line in order.sample(lines, len(lines)):
            ring = Ring.create(CYCLE, ROWS)
            with company(situation, ring) as notes:
                before_ms = steal_ms()
                LINES[line](cycles, rate_hz, ring, tallies[line])
                tallies[line].steal_ms += steal_ms() - before_ms
                lost += check_readers(notes, ring)
            ring.close()
    return tallies, lost


def show(situation: str, tallies: dict[str, Tally], lost: int) -> None:
    print(f"\n{situation}" + (f" (rows that a reader lost: {lost})" if situation != SITUATIONS[0] else ""))
    reference = tallies.get("cyclictest")
    for line, tally in tallies.items():
        found = tally.percentiles()
        text = f"  {line:<22}" + "".join(f"{value:9.1f}" for value in found)
        text += f"   missed {tally.missed_ppm:7.0f} ppm   steal {tally.steal_ms:6.0f} ms"
        if reference is not None and tally is not reference:
            ratios = [own / max(other, 1.0) for own, other in zip(found, reference.percentiles(), strict=True)]
            good = [ratio <= goal for ratio, goal in zip(ratios, GOAL.values(), strict=True)]
            good.append(tally.missed_ppm <= reference.missed_ppm + GOAL_MISSED_PPM)
            text += "   ratio " + " ".join(f"{ratio:.2f}" for ratio in ratios)
            text += (
                "  goals met"
                if all(good)
                else "  goal missed: "
                + ", ".join(name for name, met in zip((*GOAL, "missed periods"), good, strict=True) if not met)
            )
        print(text)
        if tally.put_us:
            p50, p99 = np.percentile(np.concatenate(tally.put_us), [50.0, 99.0])
            print(f"  {'':<22} putting a row: p50 {p50:.2f} p99 {p99:.2f} us (goal: p50 3 us)")
        if tally.end_us:
            p50, p99, p999 = np.percentile(np.concatenate(tally.end_us), [50.0, 99.0, 99.9])
            print(f"  {'':<22} end of the cycle after its deadline: p50 {p50:.0f} p99 {p99:.0f} p99.9 {p999:.0f} us")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=12.0, help="of each block of each round")
    parser.add_argument("--rate-hz", type=float, default=1000.0)
    parser.add_argument("--without-cycle", action="store_true", help="omit the whole cycle")
    options = parser.parse_args()
    lines = [line for line in LINES if line != "whole cycle and ring" or not options.without_cycle]
    if shutil.which("cyclictest") is None:
        print("cyclictest is not installed, so there is nothing to compare with: apt-get install rt-tests")
        lines.remove("cyclictest")
    if not options.without_cycle:
        warm_up(build.Job(load_scenario("scheme-1"), load_rig("mock"), 0, 1.0, 1.0))
    with RealTime() as real_time, real_time.realtime_priority():
        print("; ".join(map(str, real_time.grants)))
    print(f"{options.rate_hz:g} Hz, {options.rounds} rounds of {options.seconds:g} s a line, in turn; us p50 p99 p99.9")
    print(f"goals, of cyclictest's: {GOAL}; missed periods at most its own + {GOAL_MISSED_PPM} ppm")
    for situation in SITUATIONS:
        cycles = round(options.seconds * options.rate_hz)
        show(situation, *measure(situation, lines, options.rounds, cycles, options.rate_hz))


if __name__ == "__main__":
    main()
