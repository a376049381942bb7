"""Bench and GNC in two network namespaces joined by a veth pair: two hosts to either side."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

BENCH, GNC = "10.77.0.1", "10.77.0.2"


@contextmanager
def two_hosts() -> Iterator[tuple[list[str], list[str]]]:
    """Give what to put before a command to have it run on the bench's host, or on the GNC's; skips without rights."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("needs ip (iproute2) and root to make network namespaces")
    names = [f"hil-{side}-{os.getpid()}" for side in ("bench", "gnc")]
    made: list[str] = []
    try:
        for name in names:
            done = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
            if done.returncode:
                pytest.skip(f"no network namespaces on this computer: {done.stderr.strip()}")
            made.append(name)
        wires = [f"hilb{os.getpid()}", f"hilg{os.getpid()}"]
        pair = ["ip", "link", "add", wires[0], "netns", names[0], "type", "veth", "peer", wires[1], "netns", names[1]]
        if (done := subprocess.run(pair, capture_output=True, text=True)).returncode:
            pytest.skip(f"no veth pairs on this computer: {done.stderr.strip()}")
        for name, wire, address in zip(names, wires, (BENCH, GNC), strict=True):
            subprocess.run(["ip", "-n", name, "addr", "add", f"{address}/24", "dev", wire], check=True)
            subprocess.run(["ip", "-n", name, "link", "set", wire, "up"], check=True)
            subprocess.run(["ip", "-n", name, "link", "set", "lo", "up"], check=True)
        yield ["ip", "netns", "exec", names[0]], ["ip", "netns", "exec", names[1]]
    finally:
        for name in made:
            subprocess.run(["ip", "netns", "del", name], check=False)


def fly(folder: Path, *options: str) -> dict[str, Any]:
    """Fly scheme 1 with bench and GNC on two hosts; return what ``hil dss`` reports of it in JSON."""
    hil = [sys.executable, "-m", "hil"]
    result = folder / "dss.json"
    with two_hosts() as (at_bench, at_gnc), (folder / "gnc.log").open("wb") as log:
        gnc = subprocess.Popen(
            [*at_gnc, *hil, "gnc", "scheme-1", "--dss", f"{BENCH}:24500", "--wait", "120"], stdout=log, stderr=log
        )
        try:
            listen = ["--listen", f"{BENCH}:24500", "--wait", "120", "--json", str(result)]
            dss = subprocess.run(
                [*at_bench, *hil, "dss", "scheme-1", *listen, *options], capture_output=True, text=True
            )
            assert dss.returncode == 0, dss.stdout + dss.stderr
            assert gnc.wait(30.0) == 0
        finally:
            gnc.kill()
            gnc.wait()
    found: dict[str, Any] = json.loads(result.read_text())
    return found


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_scheme_1_passes_in_lock_step_and_as_in_one_process(tmp_path: Path) -> None:
    apart = fly(tmp_path, "--lock-step")
    alone_file = tmp_path / "run.json"
    command = [sys.executable, "-m", "hil", "run", "scheme-1", "--json", str(alone_file)]
    subprocess.run(command, check=True, capture_output=True)
    alone = json.loads(alone_file.read_text())
    assert apart["passed"]
    assert {key: apart[key] for key in alone if key != "timing"} == {k: v for k, v in alone.items() if k != "timing"}
    print(apart["gnc_link"])  # noqa: T201


@pytest.mark.wires
@pytest.mark.slow
@pytest.mark.timeout(900)
def test_scheme_1_passes_running_free_with_one_cycle_of_delay(tmp_path: Path) -> None:
    patient = ("--set", "rig.gnc_link.timeout_cycles=50")  # at four times the speed of time, on a busy computer
    apart = fly(tmp_path, "--speed", "4", *patient)
    link = apart["gnc_link"]
    print(link, apart["timing"]["lateness_us"])  # noqa: T201
    assert apart["passed"]
    assert 1.0 <= link["delay_cycles"] < 1.1
    assert link["lost"] == link["reordered"] == 0
    assert abs(link["clock_offset_us"]) < 2000.0  # one kernel has one monotonic clock
