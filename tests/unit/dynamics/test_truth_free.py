"""The truth without a field: a straight line, momentum to the bit, thrust alone changes it."""

from __future__ import annotations

import numpy as np
import pytest

from hil.checks.truth import check_truth
from hil.config.load import load_scenario
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import truth as kernels
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths import quat
from hil.params import dynamics as dynamics_params

FREE = (
    'truth.relative_motion="free"',
    "truth.gravity_gradient=false",
    "truth.solar_pressure=false",
    "truth.flexible_array=false",
    "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]",
    "initial.velocity_mps=[0.004, -0.006, 0.003]",
    "initial.rate_degps=[0.3, -0.2, 0.1]",
)


def after(span_s: float, on: np.ndarray) -> tuple[np.record, np.record]:
    """Return TRUTH at the start and after ``span_s`` with the valves ``on``."""
    scenario = load_scenario("scheme-1", FREE).value
    params, field, memory = dynamics_params.dss(scenario), dynamics_params.field(scenario), new(TRUTH_MEMORY)
    start, truth = dynamics_params.initial_truth(scenario), dynamics_params.initial_truth(scenario)
    for _ in range(round(span_s / params.dt_s)):
        kernels.step(params, field, memory, truth, on)
    return start, truth


def test_free_vehicle_goes_straight_and_keeps_its_momentum() -> None:
    start, truth = after(20.0, np.zeros(MAX_THRUSTERS, np.int64))
    assert np.array_equal(truth.v_CT_H, start.v_CT_H)
    np.testing.assert_allclose(truth.r_CT_H, start.r_CT_H + 20.0 * start.v_CT_H, atol=1e-12)
    assert np.array_equal(truth.q_HI, start.q_HI)
    assert not truth.w_HI_H.any()
    inertia = np.array(load_scenario("scheme-1", FREE).value.chaser.inertia_kg_m2)
    momentum = [quat.to_matrix(each.q_CH).T @ inertia @ each.w_CI_C for each in (start, truth)]
    np.testing.assert_allclose(momentum[1], momentum[0], rtol=1e-9)


def test_thrust_alone_changes_the_velocity() -> None:
    on = np.zeros(MAX_THRUSTERS, np.int64)
    on[0] = 1
    start, truth = after(1.0, on)
    speed = np.linalg.norm(truth.v_CT_H - start.v_CT_H)
    assert speed == pytest.approx(5.0 / 1000.0, rel=1e-3)


@pytest.mark.parametrize("effect", ["gravity_gradient", "drag", "third_bodies"])
def test_what_needs_a_field_is_refused(effect: str) -> None:
    settings = (*FREE, 'orbit.body="earth"', "truth.gravity_degree=0", f"truth.{effect}=true")
    (problem,) = check_truth(load_scenario("scheme-1", settings))
    assert problem.key == f"truth.{effect}"
    assert 'does not act on truth.relative_motion = "free", allowed "nonlinear"' in problem.message
