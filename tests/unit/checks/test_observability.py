"""A bench without a vision unit: which states its sensors observe, and what is refused."""

from __future__ import annotations

import pytest

from hil.checks.observability import check_observability, observed_by, state_sigmas
from hil.config.load import load_rig, load_scenario
from hil.session.build import check
from tests.support.run_settings import make_job

NONE = ("rig.vmu.driver=none",)
START = ("gnc.navigation.handover.sigma_m=0.02", "gnc.navigation.handover.sigma_deg=0.5")
TRACKER = ("sensors.tracker.kind=pose",)


def problem(*settings: str) -> str:
    (found,) = check_observability(load_scenario("scheme-1", (*START, *settings)), load_rig("mock", NONE))
    return str(found)


def test_a_tracker_of_poses_observes_every_state() -> None:
    scenario = load_scenario("scheme-1", TRACKER).value
    states = {state.name: state for state in state_sigmas(scenario)}
    assert all(state.is_observed and state.sensors == ("tracker",) for state in states.values())
    assert states["position x"].sigma < 2.0  # mm, of a tracker of 2 mm
    assert len(observed_by(scenario, load_rig("mock", NONE).value)) == len(states)
    assert observed_by(scenario, load_rig("mock").value) == []


def test_a_bench_without_sensors_is_refused_with_the_states() -> None:
    text = problem()
    assert 'rig.vmu.driver: "none": position x, position y' in text
    assert "gyro drift z not observed by the fused sensors (none)" in text


def test_attitude_and_drift_are_missing_with_positions_alone() -> None:
    text = problem("sensors.gnss.kind=relative_gnss", "sensors.gnss.range_min_m=0.1")
    assert "attitude x, attitude y, attitude z, gyro drift x" in text
    assert "position" not in text


def test_a_witness_observes_nothing() -> None:
    assert "(none)" in problem(*TRACKER, "sensors.tracker.use=witness")


def test_the_filters_need_a_start() -> None:
    (found,) = check_observability(load_scenario("scheme-1", TRACKER), load_rig("mock", NONE))
    assert 'gnc.navigation.handover: is missing: rig "mock" has no vision unit' in str(found)


def test_cameras_do_not_go_with_a_bench_without_a_vision_unit() -> None:
    text = problem(*TRACKER, "vmu.source=rendered")
    assert 'vmu.source: "rendered": rig "mock" has no vision unit' in text


@pytest.mark.parametrize("rig", ["mock", "emulated"])
def test_scenario_with_a_tracker_passes_all_checks_of_a_run(rig: str) -> None:
    check(make_job(1.0, (*NONE, *TRACKER, *START), rig=rig))
