"""Two real controllers on one rig: the second is refused before it opens anything, and the first does not notice."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hil.cli.main import BAD_INPUT
from tests.support.run_settings import UNHURRIED
from tests.system.test_killed_processes import Bench, running

pytestmark = [pytest.mark.wires, pytest.mark.slow]


class Watched:
    """Least speed of the rails while the block lasts."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self.slowest = np.inf

    def __enter__(self) -> Watched:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(5.0)

    def _watch(self) -> None:
        while not self._ended.is_set():
            self.slowest = min(self.slowest, self._bench.rails_speed())
            time.sleep(0.002)


def cpu_of_children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.mark.parametrize("lines", [(), ("rig.io.driver=none",)], ids=["with digital lines", "without"])
def test_second_controller_is_refused_within_a_second_and_the_axes_of_the_first_continue(
    tmp_path: Path, lines: tuple[str, ...]
) -> None:
    with running(tmp_path, *UNHURRIED, *lines) as bench:
        bench.wait_for_speed(0.02)
        command = [sys.executable, "-m", "hil", "run", "scheme-1", "--rig", str(tmp_path / "lab.toml")]
        with Watched(bench) as axes:
            began_s, cpu_before_s = time.monotonic(), cpu_of_children_s()
            second = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
            refused_s, cpu_s = time.monotonic() - began_s, cpu_of_children_s() - cpu_before_s
        print(f"refused after {refused_s:.2f} s, {cpu_s:.2f} s of CPU; slowest {1e3 * axes.slowest:.0f} mm/s")  # noqa: T201
        assert cpu_s < 2.0  # on a quiet computer the time of the refusal: start and imports
        assert second.returncode == BAD_INPUT
        for line in second.stderr.splitlines():
            assert f"is in use by process {bench.controller.pid}: " in line
        assert bench.controller.poll() is None
        assert axes.slowest > 0.01
        bench.controller.send_signal(signal.SIGINT)
        _, err = bench.controller.communicate(timeout=30.0)
        assert err.splitlines()[-1] == "safe stop: stopped by the operator"
