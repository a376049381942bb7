"""The rows of the loop, as other processes get them."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from hil.api.jobs import IN_LOCK_STEP
from hil.core.clock import SimulatedClock
from hil.core.messages import CYCLE
from hil.frmn.ring import Ring
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.session_parts import SessionParts
from hil.session import build
from tests.support.run_settings import NEAR, make_job

READER = """
import json, sys
from hil.frmn.ring import Ring
from hil.core.messages import CYCLE
reader, times = Ring(int(sys.argv[1]), CYCLE, 2048).reader(), []
print("attached", flush=True)
while not times or times[-1] < float(sys.argv[2]):
    times += reader.read()["t_s"].tolist()
print(json.dumps({"times": times, "got": reader.got, "lost": reader.lost}))
"""


def test_reader_gets_the_very_rows_of_the_history() -> None:
    job = make_job(2.0)
    ring = Ring.create(CYCLE, 256)
    reader = ring.reader()
    rate = SimulatedRate(SimulatedClock(), job.scenario.value.step_s)
    history = build.in_memory(job, rate, SessionParts(telemetry=ring)).run().history
    assert len(history) == 101
    assert reader.read().tobytes() == history.tobytes()
    ring.close()


@pytest.mark.slow
def test_another_process_attaches_to_a_run_on_wires_and_accounts_for_every_cycle() -> None:
    job = make_job(1.0, (*NEAR, *IN_LOCK_STEP), rig="emulated")
    with build.wired_bench(job) as bench:
        ring = bench.telemetry
        assert isinstance(ring, Ring)
        command = [sys.executable, "-c", READER, str(ring.descriptor), "1.0"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, pass_fds=(ring.descriptor,)) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "attached\n"
            outcome = bench.runner().run()
            assert outcome.stop == "completed"
            found = json.loads(process.communicate(timeout=30.0)[0])
    assert found["got"] + found["lost"] == len(outcome.history) == 51
    assert np.isin(found["times"], outcome.history["t_s"]).all()
    assert found["got"] > 0
