"""kill -9 of either side of a split run: the other one detects it within three cycles; a restarted side joins."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil.core.modes import Mode
from hil.core.operator_commands import AutoResumeOperator
from tests.support.split_bench import LOCAL, Split, gnc_thread, split_bench

pytestmark = pytest.mark.wires

CYCLES = 3


@contextmanager
def gnc_process(bench: tuple[str, int], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Give ``hil gnc`` for the bench at ``bench``; it writes to ``log``."""
    command = [sys.executable, "-m", "hil", "gnc", "scheme-1", "--dss", f"{bench[0]}:{bench[1]}", "--wait", "20"]
    with log.open("wb") as out, subprocess.Popen(command, stderr=out, stdout=out) as process:
        try:
            yield process
        finally:
            process.kill()


def after_cycle(bench: Split, cycle: int, happens: object) -> None:
    bench.each_cycle = lambda k: happens() if k == cycle else None  # type: ignore[operator]


@pytest.mark.slow
@pytest.mark.parametrize("cycles", [CYCLES, 15])
def test_killed_gnc_stops_the_bench_within_the_cycles_that_are_configured(tmp_path: Path, cycles: int) -> None:
    """Three, the default, wants a computer without other work."""
    with (
        split_bench("scheme-1", 5.0, (f"rig.gnc_link.timeout_cycles={cycles}",), lock_step=False) as bench,
        gnc_process(bench.link.address, tmp_path / "gnc") as gnc,
    ):
        after_cycle(bench, 50, gnc.kill)
        outcome = bench.fly()
    assert outcome.mode is Mode.SAFE_STOP
    assert re.fullmatch(
        r"gnc: hil gnc scheme-1 at 127\.0\.0\.1:\d+ (has not answered for \d+ cycles|its port is closed)",
        outcome.stop.partition(" (the host paused")[0],
    )
    assert 51 <= len(outcome.history) <= 51 + cycles


@pytest.mark.slow
def test_killed_gnc_that_comes_back_during_the_hold_joins_without_a_step(tmp_path: Path) -> None:
    settings = ('rig.gnc_link.on_loss="hold"',)
    with (
        split_bench("scheme-1", 5.0, settings, lock_step=False, operator=AutoResumeOperator()) as bench,
        gnc_process(bench.link.address, tmp_path / "first") as first,
    ):
        after_cycle(bench, 60, first.kill)

        def come_back() -> None:
            first.wait()
            with gnc_thread("scheme-1", bench.link.address):
                pass

        second = threading.Thread(target=come_back)
        second.start()
        outcome = bench.fly()
        second.join()
    assert outcome.faults == []
    assert len(outcome.history) == 251
    assert bench.account()["joined"] == 2
    assert any(event.text.startswith("resumed after") for event in outcome.events)
    assert outcome.history["navigation"]["valid"][-100:].all()
    rails, gimbals = bench.largest_jerks()
    assert rails < 0.6 * 1.001  # the mock rig's limits
    assert gimbals < math.radians(80.0) * 1.001


DSS = """
import sys
from tests.support.split_bench import split_bench
with split_bench("scheme-1", 60.0, lock_step=False) as bench:
    print(bench.link.address[1], flush=True)  # noqa: T201
    bench.each_cycle = lambda k: print(k, flush=True)
    bench.fly()
"""


@pytest.mark.slow
def test_killed_bench_is_missed_by_the_gnc_within_three_cycles() -> None:
    told: list[tuple[float, str]] = []
    command = [sys.executable, "-c", DSS]
    path = os.pathsep.join([str(Path(__file__).parents[2]), *sys.path])
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": path}) as dss:
        assert dss.stdout is not None
        port = int(dss.stdout.readline())
        with gnc_thread("scheme-1", (LOCAL[0], port), patience_s=2.0) as gnc:
            gnc._announce = lambda text: told.append((time.monotonic(), text))
            for line in dss.stdout:
                if int(line) == 100:
                    break
            told.clear()
            dss.send_signal(signal.SIGKILL)
            killed_s = time.monotonic()
            dss.wait()
    silent = [(t_s - killed_s, text) for t_s, text in told if "silent" in text]
    print(silent)  # noqa: T201
    assert silent
    assert silent[0][0] < CYCLES * 0.02 + 0.1  # and what a busy computer takes
