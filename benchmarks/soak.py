"""Soak: memory, handles, lateness and missed periods of one long run and of its replay, as one JSON.

    python benchmarks/soak.py --minutes 31 [--rig emulated] [--out FOLDER]     # on the wall clock
    python benchmarks/soak.py --bench-hours 24 --rig mock [--out FOLDER]       # in simulated time

Runs ``hil run SCENARIO --until-stopped`` with a recording, samples memory and handles of its processes every 30 s,
stops it as Ctrl-C does, and replays the recording unless ``--no-replay`` is given; with ``--bench-hours`` the run
ends by itself, and samples are taken every 2 s. Start a soak on the wall clock on an otherwise quiet
computer and without a real-time policy of its own: the loop, drivers and emulators take theirs, and a second real-time
process that fills a processor makes the kernel pause all of them for 50 ms per second
(docs/explanation/processes.md).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

PERIOD_S, SHORT_PERIOD_S = 30.0, 2.0
SETTLED_S, SHORT_SETTLED_S = 60.0, 10.0
"""After the start, at most a tenth of the run: the processes have allocated what they need."""


def processes_of(parent: int) -> dict[int, str]:
    """Return the processes that ``parent`` has started, itself included, by number: their names."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                above = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            children.setdefault(above, []).append(int(entry.name))
    found, pending = [], [parent]
    while pending:
        found.append(pending.pop())
        pending += children.get(found[-1], [])
    return {number: name for number in found if (name := name_of(number))}


def name_of(number: int) -> str:
    """Return the module and first argument of a process, "" if it has ended."""
    try:
        words = Path(f"/proc/{number}/cmdline").read_text().split("\0")
    except OSError:
        return ""
    return " ".join(words[words.index("-m") + 1 :][:2]) if "-m" in words else ""


def use_of(number: int) -> dict[str, float] | None:
    """Return resident memory, MB, and open handles of a process; None if it has ended."""
    try:
        status = Path(f"/proc/{number}/status").read_text()
        handles = len(os.listdir(f"/proc/{number}/fd"))
    except OSError:
        return None
    resident = next((line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")), None)
    return None if resident is None else {"memory_mb": int(resident) / 1024.0, "handles": handles}


def soak(command: list[str], log: Path, duration_s: float = math.inf) -> tuple[dict[str, dict[str, Any]], int]:
    """Run ``command``, its output in ``log``, for at most ``duration_s``; return the use of its processes, exit code.

    It is interrupted then; if no time is given it ends by itself, and is sampled more often.
    """
    uses: dict[str, dict[str, Any]] = {}
    begun_s = time.monotonic()
    period_s, settled_s = PERIOD_S, min(SETTLED_S, 0.1 * duration_s)
    if math.isinf(duration_s):
        period_s, settled_s = SHORT_PERIOD_S, SHORT_SETTLED_S
    with log.open("w") as lines, subprocess.Popen(command, stdout=lines, stderr=lines) as run:
        while run.poll() is None:
            elapsed_s = time.monotonic() - begun_s
            if elapsed_s >= duration_s:
                run.send_signal(signal.SIGINT)
                run.wait()
                break
            for number, name in processes_of(run.pid).items():
                if elapsed_s < settled_s or (use := use_of(number)) is None:
                    continue
                entry = uses.setdefault(name, {"begin": use, "largest_mb": 0.0})
                entry["end"], entry["largest_mb"] = use, max(entry["largest_mb"], use["memory_mb"])
            time.sleep(min(period_s, settled_s, max(0.1, duration_s - elapsed_s)))
    return uses, run.returncode


def cpu_s() -> float:
    """Return the processor time of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="scheme-1")
    parser.add_argument("--minutes", type=float, default=31.0)
    parser.add_argument("--bench-hours", type=float, help="of simulated time, in place of --minutes")
    parser.add_argument("--rig", default="emulated")
    parser.add_argument("--out", type=Path, default=Path("soak"))
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="passed on to hil run")
    parser.add_argument("--no-replay", action="store_true")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    result, folder = options.out / "run.json", options.out / "recording"
    command = [sys.executable, "-m", "hil", "run", options.scenario, "--rig", options.rig]
    if options.bench_hours is None:
        command += ["--until-stopped"]
    else:
        command += ["--duration", str(3600.0 * options.bench_hours)]
    command += ["--record", str(folder), "--json", str(result)]
    command += [word for setting in options.set for word in ("--set", setting)]
    load = os.getloadavg()[0]
    uses, _ = soak(
        command, options.out / "run.txt", 60.0 * options.minutes if options.bench_hours is None else math.inf
    )
    run = json.loads(result.read_text()) if result.exists() else {}
    timing = run.get("timing", {})
    kept = ("cycles", "overruns", "skipped_periods", "lateness_us", "devices")
    report: dict[str, Any] = {"minutes": timing.get("cycles", 0) / timing.get("rate_hz", 50.0) / 60.0}
    report |= {"stop": run.get("stop"), "faults": run.get("faults")} | {key: timing.get(key) for key in kept}
    report |= {"load": {"begin": load, "end": os.getloadavg()[0]}, "cpu_s": cpu_s(), "processes": uses}
    if not options.no_replay and folder.exists():
        recordings = sorted(path for path in folder.glob("*.mcap") if ".part" not in path.name)
        replay = [sys.executable, "-m", "hil", "replay", str(recordings[-1])]
        before_s = cpu_s()
        uses, report["replay_exit_code"] = soak(replay, options.out / "replay.txt")
        report["replay"] = {
            "verdict": (options.out / "replay.txt").read_text().strip().splitlines()[-1:],
            "cpu_s": cpu_s() - before_s,
            "processes": uses,
        }
    print(json.dumps(report, indent=2))
    return 0 if report["stop"] == "completed" and not report.get("replay_exit_code") else 1


if __name__ == "__main__":
    sys.exit(main())
