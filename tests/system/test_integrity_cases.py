"""What stops the bench when something fails: no case ends nearer to the target than the keep-out."""

from __future__ import annotations

import math

import pytest

from hil.api.jobs import IN_LOCK_STEP
from hil.config.load import load_rig, load_scenario
from hil.parts.campaigns.case_runner import CaseRunner
from sims.integrity_cases import CASES, IntegrityCase, run, run_emulated

KEEP_OUT_M = 0.25
PUSHED = "GNC that pushes at the target"
FAST = ("vision unit frozen from 15 s", "thruster 2 stuck open at 60 s", "rails.y stuck at 60 s")
DETECTED_WITHIN_S = {
    "vision unit frozen from 15 s": 4.0,
    "range wrong by 0.3 m from 60 s": 1.0,
    "range wrong by -0.3 m from 60 s": 1.0,
    "range drifts by 2 mm/s from 60 s": 30.0,
    "rails.x stuck at 60 s": 0.5,
    "rails.y stuck at 60 s": 0.5,
    "rails.z stuck at 60 s": 0.6,  # it should move at 1.9 mm/s
}


@pytest.fixture(autouse=True, scope="module")
def _compiled_loop() -> None:
    """Compile the loop: without it in the cache a session runs the cycle in Python."""
    scenario = load_scenario("scheme-1").value
    CaseRunner(scenario, load_rig("mock").value, 2.0 * scenario.step_s).run(scenario, 0)


def marked(case: IntegrityCase) -> object:
    """Return ``case`` as a parameter; all but a few cases are slow."""
    return pytest.param(case, id=case.name, marks=() if case.name in FAST else pytest.mark.slow)


@pytest.mark.xdist_group("campaign")
@pytest.mark.parametrize("case", [marked(case) for case in CASES])
def test_no_case_ends_within_the_keep_out(case: IntegrityCase) -> None:
    found = run(case)
    assert found.nearest_m >= KEEP_OUT_M
    assert found.bench_end_m >= KEEP_OUT_M
    assert not found.hmi_cycles
    if found.go_error_m is not None:
        assert found.go_error_m < 0.1
    if case.name in DETECTED_WITHIN_S:
        at_s = 15.0 if "15 s" in case.name else 60.0
        assert found.detected_s is not None
        assert found.detected_s - at_s <= DETECTED_WITHIN_S[case.name]
    if not case.fault and case.name != PUSHED:
        assert found.stop == "completed"
        assert found.go_error_m is not None
    if case.name == PUSHED:
        assert found.stop != "completed"


@pytest.mark.slow
def test_stuck_rails_of_the_emulated_rig_are_found_with_its_shipped_limits() -> None:
    # the approach begins at rest: a rail is found once it should have moved by 0.6 mm
    for reaction in run_emulated(IN_LOCK_STEP):
        assert reaction.as_expected, reaction
        assert f"rails.{reaction.case.line[-1]}: distance from the demand" in reaction.alarm
        assert (reaction.detected_s or math.inf) < 5.0
