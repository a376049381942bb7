"""Requirements on a run: limits that may be exceeded for a stated time only."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.api.results import Run, RunData
from hil.api.runs import run as run_scenario
from hil.core.messages import CYCLE
from hil.errors import BadInput
from hil.parts.campaigns.api.requirements import write_run_evidence

STEP_S = 0.02
SCENARIO = hil.load_scenario("scheme-1")


def run_with(values: Any, ready_time_s: float | None = None) -> Run:
    """Return a run whose truth is ``values`` off the axis, (n,)."""
    history = np.zeros(len(values), CYCLE)
    history["t_s"] = STEP_S * np.arange(len(values))
    history["truth"]["r_CT_H"][:, 1] = values
    summary = {"scenario": "scheme-1", "rig": "mock", "seed": 0, "ready_time_s": ready_time_s, "passed": True}
    data = RunData(SCENARIO, hil.load_rig("mock"), history, summary | {"stop": "completed"}, [], [], np.zeros(0))
    return Run(data, lambda: pytest.fail("not read"))


def never_more(**options: Any) -> hil.RunRequirement:
    return hil.RunRequirement("R-1", "stays", "|truth.r_CT_H[1]|", at_most=0.01, **options)


def test_limit_may_be_exceeded_for_the_stated_time_and_no_cycle_longer() -> None:
    values = np.zeros(500)
    values[100:150] = -0.02  # 1 s
    assert never_more(for_s=1.0).check(run_with(values)).verified
    values[150] = -0.015
    found = never_more(for_s=1.0).check(run_with(values))
    assert (found.status, found.step, found.method) == ("not verified", "mock", "test")
    assert found.margin == pytest.approx(-0.005)
    assert "limit exceeded for 1.02 s" in found.result
    assert never_more(for_s=1.1).check(run_with(values)).margin == pytest.approx(0.01)
    assert not never_more().check(run_with(values)).verified


def test_two_short_times_beyond_the_limit_are_not_one_long_one() -> None:
    values = np.zeros(500)
    values[100:140] = values[141:181] = 0.02
    assert never_more(for_s=1.0).check(run_with(values)).verified


def test_lower_limit_ready_phase_and_function() -> None:
    values = np.linspace(1.0, 0.0, 500)
    least = hil.RunRequirement("R-2", "far", "truth.r_CT_H[1]", at_least=0.5, from_s="ready")
    assert least.check(run_with(values)).result == "not reached"
    found = least.check(run_with(values, ready_time_s=0.0))
    assert (found.verified, found.margin) == (False, pytest.approx(-0.5))
    squared = hil.RunRequirement("R-3", "small", lambda run: run.truth.r_CT_H[:, 1] ** 2, at_most=1.0)
    assert squared.check(run_with(values)).margin == pytest.approx(0.0)
    wrong = hil.RunRequirement("R-3", "small", lambda run: run.truth.r_CT_H, at_most=1.0)
    with pytest.raises(BadInput, match=r"R-3.*\(500, 3\).*one number per cycle"):
        wrong.check(run_with(values))


def test_value_that_is_no_number_and_a_run_that_is_too_short_verify_nothing() -> None:
    values = np.zeros(500)
    values[7] = np.nan
    found = never_more().check(run_with(values))
    assert (found.verified, found.margin) == (False, None)
    assert never_more(for_s=0.1).check(run_with(values)).verified
    assert never_more(for_s=60.0).check(run_with(values)).result == "not reached"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"quantity": "truth.r_CT[1]", "at_most": 1.0}, "R-9.*quantity.*truth.r_CT.*known here.*r_CT_H"),
        ({"quantity": "truth.r_CT_H", "at_most": 1.0}, r"R-9.*index \[0\] to \[2\]"),
        ({"quantity": "truth.r_CT_H[3]", "at_most": 1.0}, r"R-9.*index \[0\] to \[2\]"),
        ({"quantity": "truth", "at_most": 1.0}, "R-9.*one of its fields"),
        ({"quantity": "truth.r_CT_H[0]"}, "R-9.*one of them must be given"),
        ({"quantity": "truth.r_CT_H[0]", "at_most": 1.0, "at_least": 0.0}, "R-9.*one of them"),
        ({"quantity": "truth.r_CT_H[0]", "at_most": 1.0, "for_s": -1.0}, "R-9.*for_s.*-1.0"),
        ({"quantity": "truth.r_CT_H[0]", "at_most": 1.0, "from_s": "later"}, "R-9.*from_s.*later"),
    ],
)
def test_requirement_that_cannot_be_checked_is_one_line(options: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInput, match=words) as raised:
        hil.RunRequirement("R-9", "x", **options)
    assert len(str(raised.value).splitlines()) == 1


def test_procedure_has_verdicts_and_files(tmp_path: Path) -> None:
    far = hil.RunRequirement("R-4", "is far", "truth.r_CT_H[0]", at_least=100.0)
    with hil.Bench("mock", SCENARIO, overrides={"duration_s": 2.0}) as bench:
        bench.require(never_more(for_s=60.0), far)
        with pytest.raises(hil.errors.BenchError, match="no run has been started"):
            _ = bench.evidence
        bench.arm()
        bench.start(until=1.0)
        assert [row.status for row in bench.evidence] == ["not verified", "not verified"]
        bench.resume()
    assert bench.evidence[0].result == "not reached"
    bench.write_evidence(tmp_path / "evidence")
    written = json.loads((tmp_path / "evidence" / "requirements.json").read_text())
    assert [(row["id"], row["step"]) for row in written["evidence"]][:2] == [("R-1", "mock"), ("R-1", "emulated")]
    assert 'failures="2"' in (tmp_path / "evidence" / "requirements.xml").read_text()
    with pytest.raises(BadInput, match="cannot be written"):
        write_run_evidence(__file__, run_scenario(SCENARIO, duration_s=0.1), [])
