"""Execution times of the cycle and of each device, from the rows of a run."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.core.messages import CYCLE
from hil.report.latency import count_beyond, execution_times_s, judge_times, limits_s

STEP_S = 0.02


@pytest.fixture
def rows() -> np.ndarray:
    """Six cycles: command 3 ms after the wake-up, samples 5 and 7 ms old, one pose of 30 ms, one line 4 ms later."""
    rows = np.zeros(6, CYCLE)
    rows["t_s"] = STEP_S * np.arange(6)
    rows["lateness_s"] = 1e-4
    rows["commanded_s"] = rows["t_s"] + 1e-4 + 0.003
    rows["sampled_s"][:, 0] = rows["t_s"] + 1e-4 - 0.005
    rows["sampled_s"][:, 1] = rows["t_s"] + 1e-4 - 0.007
    rows["on_wire_s"] = -1.0
    rows["pose"]["fresh"][4] = 1
    rows["pose"]["t_s"][4], rows["received_s"][4] = 0.04, 0.07
    rows["command"]["on"][2:, 0] = 1
    rows["on_wire_s"][3:] = rows["commanded_s"][2] + 0.004
    return rows


def test_each_time_is_that_of_its_rows(rows: np.ndarray) -> None:
    times = execution_times_s(rows)
    assert times["cycle"] == pytest.approx(np.full(6, 0.003))
    assert times["rails"] == pytest.approx(np.full(6, 0.005))
    assert times["turntable"] == pytest.approx(np.full(6, 0.007))
    assert times["vmu"] == pytest.approx([0.03])
    assert times["io"] == pytest.approx([0.004])


def test_times_beyond_their_limits_are_counted(rows: np.ndarray) -> None:
    rig = load_rig("emulated", ("rig.host.exchange_max_s=0.006",)).value
    times = execution_times_s(rows)
    beyond = count_beyond(times, rig, STEP_S)
    assert beyond == {"cycle": 0, "rails": 0, "turntable": 6, "vmu": 0, "io": 0}
    found = judge_times(times, beyond, rig, STEP_S).turntable
    assert found.p50_ms == pytest.approx(7.0)
    assert (found.limit_ms, found.beyond) == (6.0, 6)


def test_limits_follow_cycle_and_unit() -> None:
    rig = load_rig("emulated").value
    assert limits_s(rig, STEP_S) == {"cycle": 0.02, "rails": 0.04, "turntable": 0.04, "vmu": 0.4, "io": 0.04}


def test_a_run_that_hardly_began_has_no_times() -> None:
    times = execution_times_s(np.zeros(0, CYCLE))
    rig = load_rig("mock").value
    assert judge_times(times, count_beyond(times, rig, STEP_S), rig, STEP_S).io.p50_ms is None
