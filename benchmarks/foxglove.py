"""Foxglove at a running console: rate and latency of each topic, lateness of the loop with and without a client.

    python benchmarks/foxglove.py [RIG] [SECONDS]

One session on RIG (default: emulated) with rendered images: SECONDS (default: 20) without a client, as many with one
that has subscribed to all topics, and as many without. Latency: from the log time, the start of a cycle or the exposure
of an image, to the client.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from hil.recording.read import load
from plugins.foxglove.tests.foxglove_client import FoxgloveClient

_PERCENTILES = (50.0, 99.0, 100.0)
_PATIENT = ("rig.console.lease_s=60", "rig.safety.command_age_max_s=10", "vmu.source=rendered")


def main(rig: str = "emulated", phase_s: float = 20.0) -> None:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hil", "console", "--port", "0", "--foxglove", "0", "--rig", rig]
        settings = [argument for setting in _PATIENT for argument in ("--set", setting)]
        with subprocess.Popen([*command, "--record", folder, *settings], stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            lines = [process.stderr.readline() for _ in range(3)]
            found = re.search(r"foxglove on (ws\S+); code to take the command: (\w+)", lines[1])
            assert found is not None, lines
            threading.Thread(target=process.stderr.read, daemon=True).start()
            try:
                bounds, late = _session(found[1], found[2], phase_s)
            finally:
                process.terminate()
            process.wait(60.0)
        recorded = load(next(Path(folder).glob("*.mcap")))
    print(f"{'topic':34}{'per s':>8}{'p50 ms':>9}{'p99 ms':>9}{'max ms':>9}")
    for topic, (rate, *latency) in sorted(late.items()):
        print(f"{topic:34}{rate:8.1f}" + "".join(f"{1e3 * value:9.2f}" for value in latency))
    lateness, t_s = 1e6 * recorded.cycles["lateness_s"], recorded.cycles["t_s"]
    print(f"\n{'lateness of the loop, us':34}{'cycles':>8}{'p50':>9}{'p99':>9}{'max':>9}")
    for name, (begin_s, end_s) in zip(("without", "with a client", "without"), bounds, strict=True):
        chosen = lateness[(t_s >= begin_s) & (t_s < end_s)]
        print(f"{name:34}{len(chosen):8}" + "".join(f"{np.percentile(chosen, p):9.2f}" for p in _PERCENTILES))
    assert recorded.summary is None or recorded.summary["timing"]["overruns"] >= 0
    print(f"\noverruns: {recorded.summary['timing']['overruns'] if recorded.summary else '-'}")


def _session(address: str, code: str, phase_s: float) -> tuple[list[tuple[float, float]], dict[str, tuple[float, ...]]]:
    """Return the times of the run that bound the phases, and rate and latencies, s, of each topic in the second."""
    bench = frozenset({"/bench"})
    with FoxgloveClient(address, bench) as operator:

        def state(name: str) -> object:
            found = operator.of("/bench")
            return found[-1].json[name] if found else None

        def until(mode: str) -> None:
            operator.until(lambda: state("mode") == mode, mode, 120.0)

        def order(service: str) -> None:
            answer = operator.confirm(f"/hil/{service}")
            assert answer["ok"], (service, answer)

        operator.until(lambda: bool(operator.of("/bench")), "the console", 60.0)
        assert operator.call("/hil/take", name="benchmark", code=code)["ok"]
        order("open")
        until("standby")
        order("arm")
        until("armed")
        order("start")
        until("running")
        operator.during(3.0)
        bounds = []
        late: dict[str, tuple[float, ...]] = {}
        for with_client in (False, True, False):
            begin_s = float(str(state("run_s")))
            if with_client:
                late = _watch(address, operator, phase_s)
            else:
                operator.during(phase_s)
            bounds.append((begin_s, float(str(state("run_s")))))
        assert operator.call("/hil/stop")["ok"]
        operator.until(lambda: not state("open"), "the end")
    return bounds, late


def _watch(address: str, operator: FoxgloveClient, phase_s: float) -> dict[str, tuple[float, ...]]:
    """Return rate and latencies of each topic for a client that has subscribed to all."""
    with FoxgloveClient(address) as client:
        stop = threading.Event()

        def keep() -> None:
            while not stop.is_set():
                operator.take(0.1)

        keeper = threading.Thread(target=keep)
        keeper.start()
        client.during(1.0)
        client.messages.clear()
        begin_s = time.monotonic()
        client.during(phase_s - 1.0)
        passed_s = time.monotonic() - begin_s
        stop.set()
        keeper.join()
        found: dict[str, tuple[float, ...]] = {}
        for topic in list(client.messages):
            latency = [1e-9 * (message.arrived_ns - message.time_ns) for message in client.of(topic)]
            found[topic] = (len(latency) / passed_s, *(float(np.percentile(latency, p)) for p in _PERCENTILES))
    return found


if __name__ == "__main__":
    main(*sys.argv[1:2], *map(float, sys.argv[2:3]))
