"""Check that an abort stays clear of the target with any one thruster failed."""

from __future__ import annotations

import pytest

from hil.checks.abort import check_abort, failed_thrusters
from hil.config.load import load_scenario

FAST = (
    "gnc.corridor.closing_rate_mps=0.08",
    "gnc.corridor.closing_rate_max_mps=0.08",
)


@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2", "scheme-3"])
def test_shipped_scenarios_can_be_aborted_with_any_one_thruster_failed(scheme: str) -> None:
    scenario = load_scenario(scheme)
    assert check_abort(scenario) == []
    failed = failed_thrusters(scenario.value)
    assert len(failed) == 2 * len(scenario.value.chaser.thrusters.position_m)
    # four thrusters of 5 N brake a ton; one that pushes at the target is cancelled by one of them or two
    assert min(each.braking_mps2 for each in failed) == pytest.approx(0.01)
    assert max(each.push_mps2 for each in failed) == pytest.approx(0.005)


def test_permitted_speed_that_no_abort_stops_before_the_keep_out_is_rejected_whatever_is_planned() -> None:
    scenario = load_scenario("scheme-1", FAST)
    (problem,) = check_abort(scenario)
    assert "gnc.abort.one_thruster_failed: true: with thruster." in str(problem)
    assert "at 0.40 m and 0.08 m/s an abort stops at" in str(problem)
    assert check_abort(load_scenario("scheme-1", (*FAST, "gnc.abort.one_thruster_failed=false"))) == []


def test_bank_whose_isolation_leaves_a_demand_without_thrusters_is_rejected() -> None:
    banks = [1] * 8 + [2] * 8  # those on the y axis, those on the z axis
    scenario = load_scenario("scheme-1", ("chaser.thrusters.isolation=bank", f"chaser.thrusters.bank={banks}"))
    (problem,) = check_abort(scenario)
    assert str(problem).endswith('isolation = "bank" of thruster.1 leaves no thrusters for the -Fz demand')
    each = load_scenario("scheme-1", ("chaser.thrusters.isolation=each",))
    assert check_abort(each) == []
