"""What the rows of a run give does not depend on how they are handed over."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.report.tally import Tally
from hil.session import build
from tests.support.run_settings import make_job

LENGTH_S = 70.0


class Flown:
    """A run that is aborted, and its numbers of all rows at once."""

    def __init__(self) -> None:
        job = make_job(LENGTH_S, ("gnc.abort.at_s=45.0",), seed=4)
        with build.runner(job) as runner:
            self.rows = runner.run().history.copy()
        self.scenario, self.rig = job.scenario.value, job.rig.value
        self.whole = self.numbers([])

    def numbers(self, cuts: list[int]) -> tuple[str, bytes]:
        """Return the JSON and the statistics of the rows, cut before the rows ``cuts``."""
        tally = Tally(self.scenario, self.rig)
        for rows in np.split(self.rows, sorted(cuts)):
            tally.add(rows)
        return json.dumps(tally.numbers()[0].as_json()), tally.stats.tobytes()


@pytest.fixture(scope="module")
def flown() -> Flown:
    return Flown()


@settings(max_examples=15, deadline=None)
@given(cuts=st.lists(st.integers(0, round(50 * LENGTH_S)), max_size=8))
def test_any_split_of_the_rows_gives_the_same_bytes(flown: Flown, cuts: list[int]) -> None:
    assert flown.numbers(cuts) == flown.whole


def test_rows_may_be_overwritten_once_they_are_added(flown: Flown) -> None:
    tally, memory = Tally(flown.scenario, flown.rig), np.empty(700, flown.rows.dtype)
    for begin in range(0, len(flown.rows), 700):
        part = flown.rows[begin : begin + 700]
        memory[: len(part)] = part
        tally.add(memory[: len(part)])
        memory[:] = np.zeros((), memory.dtype)
    tally.end()
    assert tally.stats.tobytes() == flown.whole[1]


def test_the_course_of_an_abort_is_followed_to_the_end(flown: Flown) -> None:
    abort = json.loads(flown.whole[0])["verdict"]["security"]["abort"]
    assert abort["cause"] == "ordered"
    assert abort["at_s"] == pytest.approx(45.0)
    assert abort["drift_from_end"]["from_s"] == pytest.approx(LENGTH_S)


def test_each_row_counts_once(flown: Flown) -> None:
    found, rows = json.loads(flown.whole[0]), flown.rows
    late = rows[rows["navigation"]["valid"] == 1]  # the run ends before the navigation counts as settled
    error = late["truth"]["r_CT_H"] - late["navigation"]["r_CT_H"]
    sigma = np.degrees(late["navigation"]["sigma_attitude_rad"])
    rail = (rows["setpoint"]["rail_m"] - rows["feedback"]["rail_m"])[1:]
    for name, values in (("position_rmse_m", error), ("attitude_sigma_deg", sigma)):
        assert found["navigation"][name] == pytest.approx(np.sqrt(np.mean(values**2, axis=0)), rel=1e-12)
    assert found["navigation"]["nees_pkf"] == pytest.approx(np.nanmean(late["nees_position"]), rel=1e-12)
    assert found["bench"]["rail_error_rms_m"] == pytest.approx(np.sqrt(np.mean(rail**2, axis=0)), rel=1e-12)
    assert found["bench"]["rail_error_max_m"] == np.abs(rail).max(axis=0).tolist()
    on = rows["command"]["torque"] != 0
    assert found["thrusters"]["torque_on_time_s"] == pytest.approx(0.02 * np.count_nonzero(on, axis=0))
    assert found["timing"]["cycles"] == len(rows)
