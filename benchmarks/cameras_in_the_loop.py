"""Run through two emulated GigE Vision cameras on the emulated rig in real time: verdict, losses, latency as JSON.

    python benchmarks/cameras_in_the_loop.py [--duration 400] [--loss 0.01] [--end left] [--set KEY=VALUE ...]

loss: fraction of lost packets of both cameras. end: the emulator of this camera is killed in the middle of the run, as
by an unplugged cable; the run then ends by a safe stop that names it. Start it on an otherwise quiet computer: what
else runs there pauses cameras and solver (docs/explanation/processes.md).
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import sys
import threading
import time
from typing import Any

from hil.api.runs import judged_run
from hil.config.load import load_rig, load_scenario
from hil.parts.wires.wired import WiredBench
from hil.session.build import Job, check, wired_bench
from hil.session.warm_up import compile_kernels

SIDES = ("left", "right")


def set_fault(bench: WiredBench, side: str, command: str) -> None:
    """Send a command to the control port of a camera's emulator."""
    host, port = bench.addresses[f"vmu.{side}.faults"].rsplit(":", 1)
    with socket.create_connection((host, int(port))) as control:
        control.sendall(f"{command}\n".encode())
        if control.recv(100) != b"ok\n":
            raise SystemExit(f"{command!r} is refused")


def run(job: Job, loss: float, end: str) -> dict[str, Any]:
    """Run ``job``; return its numbers."""
    check(job)
    compile_kernels(job, lambda text: print(text, file=sys.stderr))
    load = os.getloadavg()[0]
    with wired_bench(job) as bench:
        if loss > 0.0:
            for side in SIDES:
                set_fault(bench, side, f"on drop {loss}")
        runner = bench.runner()
        if end:
            threading.Thread(target=kill_later, args=(bench, runner, end, job), daemon=True).start()
        outcome = runner.run()
    found = judged_run(job, "emulated", outcome).summary
    exposures = found["timing"]["cycles"] * job.scenario.value.step_s * job.rig.value.vmu.rate_hz
    return {
        "passed": found["passed"],
        "stop": found["stop"],
        "cycles": found["timing"]["cycles"],
        "overruns": found["timing"]["overruns"],
        "lateness_us": found["timing"]["lateness_us"],
        "exposures": round(exposures),
        "vision": {name: count for name, count in found["vision"].items() if count},
        "latency": found["latency"],
        "load_before": load,
        "load_after": os.getloadavg()[0],
    }


def kill_later(bench: WiredBench, runner: Any, end: str, job: Job) -> None:
    """Kill the camera's emulator in the middle of the run."""
    while runner.loop.done < 0.5 * job.cycles:
        time.sleep(0.05)
    os.kill(bench.pids[f"vmu.{end}"], signal.SIGKILL)


def main() -> None:
    """Print the numbers of a run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="scheme-1")
    parser.add_argument("--duration", type=float, default=400.0)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--end", choices=SIDES, default="")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    arguments = parser.parse_args()
    settings = ["vmu.source=cameras", *arguments.set]
    job = Job(load_scenario(arguments.scenario, settings), load_rig("emulated", settings), 0, arguments.duration, 1.0)
    print(json.dumps(run(job, arguments.loss, arguments.end), indent=2))


if __name__ == "__main__":
    main()
