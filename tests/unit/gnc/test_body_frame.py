"""Filters and control in the axes of a target that tumbles."""

from __future__ import annotations

import numpy as np

from hil.config.load import load_scenario
from hil.core.messages import IMU, REFERENCE, new
from hil.gnc.estimation import body_frame, fusion, target_motion
from hil.gnc.estimation.akf import AKF_STATE
from hil.gnc.estimation.body_frame import AXES_STEP
from hil.gnc.estimation.error_state import FILTER_ERRORS, FILTERS
from hil.gnc.estimation.fusion import FUSION_STATE
from hil.gnc.estimation.step_memory import new_memory
from hil.gnc.estimation.target_orbit import HILL_STEP, move_hill_frame
from hil.models.rotating_frame import frame_acceleration, tumble_rate
from hil.params import gnc as gnc_params
from hil.params.target import known_tumble
from tests.support.plain_filters import PLAIN

SCENARIO = load_scenario("tumbling-5", PLAIN).value
DT = SCENARIO.step_s
ORBIT = gnc_params.navigation(SCENARIO).fusion.orbit
ORBIT.estimated = 0  # the motion of the axes is that of the start


def test_accelerations_of_rotating_axes_are_those_of_a_point_at_rest_in_inertial_space() -> None:
    tumble = known_tumble(SCENARIO, 0.0)
    w, dw, after, aside = (np.empty(3) for _ in range(4))
    tumble_rate(tumble, 10.0, w, dw)
    tumble_rate(tumble, 10.001, after, aside)
    r = np.array([0.9, -0.2, 0.3])
    v = -np.cross(w, r)
    moved = r + 0.001 * v
    # the velocity of the point in the rotating axes changes by what the axes ask, negative
    change = (-np.cross(after, moved) - v) / 0.001
    found = np.empty(3)
    frame_acceleration(w, dw, r, v, found)
    np.testing.assert_allclose(-change, found, atol=2e-5)


def test_filter_follows_a_free_point_without_poses() -> None:
    """The step of the filter, with its rotating axes, keeps a point that moves evenly in inertial space."""
    params = gnc_params.navigation(SCENARIO).fusion
    state, memory, hill = new(FUSION_STATE), new_memory(params), new(HILL_STEP)
    state.started = 1
    filters = state.filters
    filters.akf.x[:4], filters.akf.x[4:] = [0.0, 0.0, 0.0, 1.0], params.akf.initial_drift
    filters.p[:15, :15] = np.diag(np.repeat([1e-6, 1e-8], [9, 6]))
    target_motion.start(params.orbit, params.errors, 0.0, filters.parameters)
    w, aside = np.empty(3), np.empty(3)
    tumble_rate(known_tumble(SCENARIO, 0.0), 0.0, w, aside)
    r = np.array([0.9, -0.2, 0.3])
    filters.pkf.x[:3], filters.pkf.x[3:6] = r, -np.cross(w, r)
    sample, axes = new(IMU), np.eye(3)
    sample.rate_C = params.akf.initial_drift
    for k in range(1, 1001):
        state.cycle = k
        fusion.advance(params, state, memory, sample)  # c is at rest in inertial space
        move_hill_frame(ORBIT, (k - 1) * DT, DT, hill)
        size = np.linalg.norm(hill.rotation)
        n = hill.rotation / size
        cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
        axes = (np.eye(3) - np.sin(size) * cross + (1.0 - np.cos(size)) * cross @ cross) @ axes
    np.testing.assert_allclose(filters.pkf.x[:3], axes @ r, atol=1e-6)
    assert np.linalg.norm(axes - np.eye(3)) > 1.0
    p = filters.p[:15, :15]
    np.testing.assert_allclose(p, p.T, atol=1e-12)
    assert np.linalg.eigvalsh(p).min() > 0.0


def test_covariance_is_transformed_as_the_state_is(rng: np.random.Generator) -> None:
    """The transformation of a sample of states has the transformed covariance."""
    hill = new(HILL_STEP)
    move_hill_frame(ORBIT, 5.0, DT, hill)
    body_frame.correct_motion(hill, new(AKF_STATE), np.zeros(3), DT, axes := new(AXES_STEP))
    root = rng.standard_normal((9, 9))
    first, columns = new(FILTERS), np.empty((9, 9))
    first.p[:9, :9] = root @ root.T
    for j in range(9):
        each = new(FILTERS)
        each.pkf.x = root[:, j]
        body_frame.enter_middle(axes, each, FILTER_ERRORS, 0)
        body_frame.leave_middle(axes, each, FILTER_ERRORS, 0)
        columns[:, j] = each.pkf.x
    body_frame.enter_middle(axes, first, FILTER_ERRORS, 0)
    body_frame.leave_middle(axes, first, FILTER_ERRORS, 0)
    np.testing.assert_allclose(first.p[:9, :9], columns @ columns.T, atol=1e-12)


def test_feed_forward_keeps_a_rigid_body_on_the_axes() -> None:
    tumble, inertia = known_tumble(SCENARIO, 0.0), np.array(SCENARIO.chaser.inertia_kg_m2)
    w, dw, out, rest = np.empty(3), np.empty(3), np.empty(6), np.zeros(3)
    tumble_rate(tumble, 7.0, w, dw)
    reference = new(REFERENCE)
    reference.r_CT_H = [0.9, 0.0, 0.0]
    body_frame.feed_forward(w, dw, inertia, np.array([0.0, 0.0, 0.0, 1.0]), rest, rest, reference, out)
    torque = out[3:] * np.diag(inertia)
    np.testing.assert_allclose(np.linalg.solve(inertia, torque - np.cross(w, inertia @ w)), dw, atol=1e-15)
    np.testing.assert_allclose(
        out[:3], np.cross(w, np.cross(w, [0.9, 0.0, 0.0])) + np.cross(dw, [0.9, 0.0, 0.0]), atol=1e-15
    )
