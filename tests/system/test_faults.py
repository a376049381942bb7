"""Faults in the closed loop: each kind in the compiled loop and in the cycle in Python, and what it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from docs.fault_responses import RESPONSES
from hil.config.load import load_rig, load_scenario
from hil.config.tables.faults import TERMS
from hil.core.messages import Array
from hil.maths import quat
from hil.parts.campaigns.case_runner import COMPLETED, CaseRunner
from hil.parts.campaigns.outcome import row_of
from hil.session import build
from tests.support.plain_filters import PLAIN
from tests.support.rows import assert_same_bits
from tests.support.run_settings import faults_setting, make_job

pytestmark = pytest.mark.xdist_group("campaign")

AT_S, UNTIL_S, END_S = 3.0, 6.0, 9.0
VALUES = {
    "vmu.offset": [0.3, -0.1, 0.05],
    "vmu.drift": [0.02, 0.0, 0.01],
    "vmu.outlier": 0.4,
    "vmu.noise_scale": 5.0,
    "vmu.sigma_scale": 3.0,
    "vmu.latency": 0.35,
    "vmu.dimmed": 0.75,
    "imu.bias_step": [0.01, -0.02, 0.03],
    "imu.scale_factor": 1.1,
    "imu.noise_scale": 4.0,
    "monitor.offset": [0.3, -0.1, 0.05],
    "monitor.drift": [0.06, 0.0, 0.02],
    "monitor.outlier": 0.9,
    "monitor.noise_scale": 5.0,
    "monitor.sigma_scale": 3.0,
    "monitor.latency": 0.35,
    "thruster.leak": 0.3,
    "thruster.force_scale": 0.5,
    "thruster.delay": 0.05,
    "thruster.minimum_on": 2.0,
    "axis.slow": 0.0001,
    "axis.offset": 0.01,
    "axis.oscillation": [0.005, 2.0],
    "sensor.offset": 0.3,
    "sensor.drift": 0.06,
    "sensor.outlier": 0.4,
    "sensor.noise_scale": 5.0,
    "sensor.sigma_scale": 3.0,
    "sensor.latency": 0.35,
    "target.jump": [0.1, 0.0, 0.0],
    "target.drift": [0.01, 0.02, 0.0],
    "target.plume": 1.0,
}
NAMES = {"thruster": "thruster.2", "axis": "rails.x", "sensor": "sensor.ranger"}
KINDS = [f"{family}.{kind}" for family, kinds in TERMS.items() for kind in kinds]
MORE = {
    "vmu.outlier": {"size_m": 0.5},
    "vmu.latency": {"stamp": "arrival"},
    "monitor.outlier": {"size_m": 0.5},
    "monitor.latency": {"stamp": "arrival"},
    "sensor.latency": {"stamp": "arrival"},
    "imu.stuck": {"sensor": "accelerometer"},
    "imu.bias_step": {"until_s": UNTIL_S},
}
DISTURBED = ("vmu.latency_s=0.05", "vmu.latency_jitter_s=0.2", "vmu.duplicate_probability=0.2")
"""Frames that arrive out of order and twice."""
WITHOUT_GUARD = ("rig.guard.enabled=false", "rig.rails.following_error_max_m=0.5")
"""Each fault shows its effect."""
NO_DISAGREEMENT = ("monitor.no_pose", "monitor.noise_scale", "monitor.sigma_scale", "monitor.latency")
"""Faults of the docking monitor that leave it in agreement with the navigation."""


def fault(name: str, **keys: Any) -> dict[str, Any]:
    """Return the table of a fault of ``name``, a kind of device and a kind, from AT_S to UNTIL_S."""
    family, _, kind = name.partition(".")
    table = {"device": NAMES.get(family, family), "kind": kind, "at_s": AT_S, "until_s": UNTIL_S}
    if name in VALUES:
        table["value"] = VALUES[name]
    return table | MORE.get(name, {}) | keys


def fly(*faults: dict[str, Any], duration_s: float = END_S, settings: Sequence[str] = ()) -> np.ndarray:
    """Return the rows of a run of scheme-1 with these faults."""
    settings = (*WITHOUT_GUARD, *_devices(*faults), *settings, faults_setting(*faults))
    with build.runner(make_job(duration_s, settings)) as runner:
        return runner.run().history


@pytest.fixture(scope="module", autouse=True)
def _compiled_loop() -> None:
    """Compile the loop: without it in the cache a session runs the cycle in Python."""
    scenario = load_scenario("scheme-1").value
    CaseRunner(scenario, load_rig("mock").value, 2.0 * scenario.step_s).run(scenario, 0)


@pytest.fixture(scope="module")
def healthy() -> np.ndarray:
    """Rows of the same run without a fault."""
    return fly()


def _devices(*faults: dict[str, Any]) -> tuple[str, ...]:
    """Return the settings of a docking monitor or a range finder, if one of ``faults`` is its own."""
    found = {fault["device"] for fault in faults}
    of_monitor = ("monitor.source=model",) if "monitor" in found else ()
    return (*of_monitor, "sensors.ranger.kind=range_finder") if "sensor.ranger" in found else of_monitor


@pytest.mark.parametrize("name", KINDS)
def test_compiled_loop_and_cycle_in_python_and_campaign_have_the_same_bits(name: str) -> None:
    injected = fault(name, at_s=0.5 * AT_S, until_s=0.5 * UNTIL_S)
    settings = (*DISTURBED, *WITHOUT_GUARD, *_devices(injected), faults_setting(injected))
    job = make_job(0.5 * END_S, settings, seed=3)
    rows = []
    for compiled in (True, False):
        with build.runner(replace(job, compiled=compiled)) as runner:
            rows.append(runner.run().history)
    case = np.zeros_like(rows[0])
    CaseRunner(job.scenario.value, job.rig.value, 0.5 * END_S).run(job.scenario.value, 3, case)
    assert len(rows[0]) == job.cycles
    assert_same_bits(*rows)
    assert_same_bits(rows[0], case, without=("on_wire_s",))


@pytest.mark.parametrize("name", sorted(set(KINDS) - {"vmu.sigma_scale", *NO_DISAGREEMENT}))
def test_nothing_differs_before_the_onset_and_something_after_it(healthy: np.ndarray, name: str) -> None:
    found = fly(fault(name))
    if with_device := _devices(fault(name)):
        healthy = fly(settings=with_device)
    before = healthy["t_s"] < AT_S - 1e-9
    assert_same_bits(found[before], healthy[before])
    differs = found[~before].tobytes() != healthy[~before].tobytes()
    assert differs


@pytest.mark.parametrize("name", [name for name, response in RESPONSES.items() if response.detected_by is None])
@pytest.mark.parametrize("onset_s", [20.0, 150.0])
def test_fault_that_is_not_detected_for_sure_stays_within_the_limits(name: str, onset_s: float) -> None:
    injected = fault(name, at_s=onset_s, until_s=1000.0)
    scenario = load_scenario("scheme-1", (*_devices(injected), faults_setting(injected))).value
    stats, stop = CaseRunner(scenario, load_rig("mock", WITHOUT_GUARD).value, scenario.duration_s).run(scenario, 0)
    row = row_of(stats, stop, scenario, scenario)
    assert stop == COMPLETED
    assert row["hmi_cycles"] == 0
    assert row["nearest_m"] > scenario.keep_out.radius_m
    assert row["passed"] or row["reaction"], "without a reaction the approach passes its requirements"


@pytest.mark.parametrize("name", [name for name, response in RESPONSES.items() if response.detected_by is not None])
def test_fault_is_detected_as_the_table_states(name: str) -> None:
    values = {"vmu.outlier": 0.9, "axis.slow": 0.01, "thruster.leak": 0.6}
    sizes = {"value": values[name]} if name in values else {}
    onset_s = 20.0
    injected = fault(name, at_s=onset_s, until_s=100.0, **sizes)
    # a dead thruster is found when it is needed: the filters of the bench paper need this one within 10 s
    plain = PLAIN if name == "thruster.stuck_closed" else ()
    settings = (*plain, *_devices(injected), faults_setting(injected))
    scenario, rig = load_scenario("scheme-1", settings).value, load_rig("mock").value
    stats, stop = CaseRunner(scenario, rig, 50.0).run(scenario, 0)
    row = row_of(stats, stop, scenario, scenario)
    assert row["detected_by"] == RESPONSES[name].detected_by
    assert RESPONSES[name].reaction.startswith(row["reaction"])
    assert onset_s <= row["detected_s"] <= onset_s + 15.0  # a thruster fault is found when the thruster is used


def during(rows: np.ndarray) -> np.ndarray:
    """Return the rows well inside the time of the fault."""
    return rows[(rows["t_s"] > AT_S + 0.5) & (rows["t_s"] < UNTIL_S)]


def measured(rows: np.ndarray) -> Array:
    """Return the errors of the measured positions in H, (n, 3), m, by the truth of the cycle of arrival."""
    fresh = rows[rows["pose"]["fresh"] > 0]
    found = [-quat.transform_back(row["pose"]["q_CH"], row["pose"]["z_TC_C"]) for row in fresh]
    return np.array(found) - fresh["truth"]["r_CT_H"]


def normalised(rows: np.ndarray) -> Array:
    """Return ``measured`` over the standard deviation that the unit reports, (n, 3)."""
    covariance = rows[rows["pose"]["fresh"] > 0]["pose"]["covariance_position"]
    return measured(rows) / np.sqrt(covariance[:, range(3), range(3)])


def test_no_pose_leaves_the_unit_alive_and_the_loop_blind() -> None:
    rows = during(fly(fault("vmu.no_pose")))
    assert not rows["pose"]["fresh"].any()


def test_frozen_poses_have_fresh_stamps() -> None:
    poses = during(fly(fault("vmu.frozen")))["pose"]
    fresh = poses[poses["fresh"] > 0]
    assert (np.ptp(fresh["z_TC_C"], axis=0) == 0.0).all()
    assert (np.diff(fresh["t_s"]) > 0.1).all()


def test_offset_and_drift_displace_the_chaser_in_hill_axes() -> None:
    shifted = measured(during(fly(fault("vmu.offset"))))
    assert np.abs(shifted.mean(axis=0) - VALUES["vmu.offset"]).max() < 0.01
    rows = during(fly(fault("vmu.drift", value=[0.1, 0.0, 0.0])))
    t_s = rows["t_s"][rows["pose"]["fresh"] > 0]
    slope = np.polyfit(t_s, measured(rows)[:, 0], 1)[0]
    assert abs(slope - 0.1) < 0.01


def test_given_fraction_of_the_poses_are_outliers_of_the_given_size() -> None:
    errors = np.linalg.norm(measured(fly(fault("vmu.outlier", until_s=60.0), duration_s=60.0)), axis=1)
    thrown = errors[18:] > 0.25
    assert 0.3 < thrown.mean() < 0.5
    assert np.abs(errors[18:][thrown] - 0.5).max() < 0.05


def test_misidentified_leds_turn_the_attitude_by_sixty_degrees() -> None:
    rows = during(fly(fault("vmu.misidentified")))
    fresh = rows[rows["pose"]["fresh"] > 0]
    for row in fresh:
        turn = quat.multiply(row["pose"]["q_CH"], quat.conjugate(row["truth"]["q_CH"]))
        assert abs(np.degrees(2.0 * np.arccos(abs(turn[3]))) - 60.0) < 0.5


def test_noise_grows_and_sigma_does_not(healthy: np.ndarray) -> None:
    louder = fly(fault("vmu.noise_scale", until_s=60.0), duration_s=60.0)
    quiet = fly(duration_s=60.0)
    late = slice(200, None)
    # relative to the reported noise, which depends on the range: the approach is aborted
    ratio = normalised(louder[late]).std(axis=0) / normalised(quiet[late]).std(axis=0)
    assert (np.abs(ratio - 5.0) < 1.0).all()
    pose = during(fly(fault("vmu.sigma_scale")))["pose"]
    usual = during(healthy)["pose"]
    assert np.allclose(
        np.median(pose["covariance_position"][:, 0, 0] / usual["covariance_position"][:, 0, 0]), 9.0, rtol=0.1
    )


def test_dimmed_leds_are_noisier_and_reported_so_until_they_are_lost(healthy: np.ndarray) -> None:
    dim, usual = during(fly(fault("vmu.dimmed")))["pose"], during(healthy)["pose"]
    ratio = dim["covariance_position"][:, 0, 0] / usual["covariance_position"][:, 0, 0]
    assert np.median(ratio) == pytest.approx(4.0, rel=0.1)
    assert not during(fly(fault("vmu.dimmed", value=0.99)))["pose"]["fresh"].any()  # 5 m away
    assert during(fly(fault("vmu.dimmed", value=0.97)))["pose"]["fresh"].any()


def test_lights_that_go_out_are_vision_lost() -> None:
    dark = fault("vmu.dimmed", at_s=20.0, until_s=100.0, value=1.0)
    scenario, rig = load_scenario("scheme-1", (faults_setting(dark),)).value, load_rig("mock").value
    stats, stop = CaseRunner(scenario, rig, 50.0).run(scenario, 0)
    row = row_of(stats, stop, scenario, scenario)
    assert row["detected_by"] == "navigation"  # it coasts: the protection level is within its limit to the end
    assert 20.0 <= row["detected_s"] <= 30.0


def test_latency_ages_the_poses() -> None:
    rows = during(fly(fault("vmu.latency", stamp="exposure")))
    fresh = rows[rows["pose"]["fresh"] > 0]
    assert np.allclose(fresh["received_s"] - fresh["pose"]["t_s"], 0.35)
    stamped = during(fly(fault("vmu.latency", stamp="arrival")))
    fresh = stamped[stamped["pose"]["fresh"] > 0]
    assert np.allclose(fresh["received_s"], fresh["pose"]["t_s"])


def test_a_bias_step_is_in_the_true_drift_while_it_lasts(healthy: np.ndarray) -> None:
    rows = fly(fault("imu.bias_step"))
    step = np.radians(VALUES["imu.bias_step"])
    inside = during(rows)["imu"]["drift_C"] - during(healthy)["imu"]["drift_C"]
    assert np.allclose(inside, step, atol=1e-12)
    assert np.allclose(rows["imu"]["drift_C"][-1], healthy["imu"]["drift_C"][-1], atol=1e-12)


def test_readings_stick_and_drop_out() -> None:
    stuck = during(fly(fault("imu.stuck", sensor="gyro")))["imu"]
    assert (np.ptp(stuck["rate_C"], axis=0) == 0.0).all()
    assert (np.ptp(stuck["force_C"], axis=0) > 0.0).all()
    lost = during(fly(fault("imu.dropout")))["imu"]
    assert not lost["rate_C"].any()
    assert not lost["force_C"].any()


def test_thrusters_stick_leak_and_come_late() -> None:
    number = 1
    for kind, expected in (("stuck_open", 1.0), ("stuck_closed", 0.0)):
        fraction = during(fly(fault(f"thruster.{kind}")))["truth"]["thrust_fraction"][:, number]
        assert (fraction == expected).all()
    assert during(fly(fault("thruster.leak")))["truth"]["thrust_fraction"][:, number].min() == 0.3
    rows = fly(fault("thruster.delay", at_s=0.0, until_s=60.0), duration_s=60.0)
    commanded, thrust = rows["command"]["on"][:, number], rows["truth"]["thrust_fraction"][:, number]
    assert commanded.sum() > 50
    # 0.05 s at 50 Hz are two steps and a half; the row after a step has its thrust
    assert (thrust[4:] == 0.5 * commanded[1:-3] + 0.5 * commanded[:-4]).all()


def test_axes_stand_still_and_encoders_lie() -> None:
    stuck = during(fly(fault("axis.stuck", at_s=0.0)))["feedback"]["rail_m"][:, 0]
    assert np.ptp(stuck) == 0.0
    rows = during(fly(fault("axis.offset")))
    # the drive follows its encoder: what it shows is right, where it is is not
    assert np.abs(rows["feedback"]["rail_m"][:, 0] - rows["setpoint"]["rail_m"][:, 0]).max() < 0.002
    assert abs(np.abs(measured(rows)[:, 0]).mean() - 0.01) < 0.006


def test_the_target_jumps_and_drifts_away(healthy: np.ndarray) -> None:
    jumped = fly(fault("target.jump"))["truth"]["r_CT_H"] - healthy["truth"]["r_CT_H"]
    onset = round(AT_S / 0.02) + 1
    assert np.allclose(jumped[onset], [-0.1, 0.0, 0.0], atol=1e-6)
    moved = fly(fault("target.drift"))["truth"]["v_CT_H"] - healthy["truth"]["v_CT_H"]
    assert np.allclose(moved[onset], [-0.01, -0.02, 0.0], atol=1e-6)


def test_plumes_push_the_target_without_being_measured() -> None:
    near = ("initial.position_m=[2.0, 0.0, 0.0]",)
    # the chaser brakes with the thrusters whose plumes meet the target
    away = {"at_s": 0.0, "until_s": END_S, "value": 3.0}
    still, pushed = (fly(*faults, settings=near) for faults in ((), (fault("target.plume", **away),)))
    fired = still["truth"]["thrust_fraction"][:, [0, 4, 8, 12]].any(axis=1)
    first = int(fired.argmax())
    gained = pushed["truth"]["v_CT_H"][first + 1] - still["truth"]["v_CT_H"][first + 1]
    assert fired[first]
    assert gained[0] > 1e-7
    assert_same_bits(pushed["imu"][: first + 1], still["imu"][: first + 1])
