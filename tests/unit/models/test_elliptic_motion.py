"""Relative motion on an ellipse: the transition matrix against the two-body motion and against the filters' steps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from hil.config.scenario import Scenario
from hil.core.messages import new
from hil.dynamics import hill, orbit
from hil.gnc.estimation import pkf
from hil.gnc.estimation.target_orbit import HILL_STEP, move_hill_frame
from hil.maths.kepler import mean_anomaly, true_anomaly
from hil.models import elliptic_motion
from hil.params import gnc as gnc_params
from tests.support.two_body import AXIS_M, GM, ORBIT_S, N, two_body

START = np.array([5.0, -0.3, 0.3, 0.01, -0.02, 0.005])


@pytest.mark.parametrize("e", [0.0, 0.005, 0.03, 0.09, 0.4])
@pytest.mark.parametrize("t_s", [400.0, ORBIT_S])
def test_transition_is_that_of_two_bodies_close_together(e: float, t_s: float) -> None:
    found, expected = elliptic_motion.transition(N, e, 1.1, t_s) @ START, two_body(e, 1.1, START, t_s)
    # what is quadratic in range: (10 m)^2 / orbit radius, which grows along the orbit
    error_m = 10.0 * max(1.0, np.abs(found[:3]).max()) ** 2 / AXIS_M + 1e-5
    np.testing.assert_allclose(found[:3], expected[:3], atol=error_m)
    np.testing.assert_allclose(found[3:], expected[3:], atol=N * error_m)


def test_transition_on_a_circle_is_hills() -> None:
    np.testing.assert_allclose(elliptic_motion.transition(N, 0.0, 0.7, 1000.0), hill.transition(N, 1000.0), atol=1e-9)


@pytest.mark.parametrize("e", [0.0, 0.005, 0.03, 0.0999, 0.5, 0.7])
def test_true_anomaly_solves_keplers_equation_over_many_turns(e: float) -> None:
    for m in np.linspace(-20.0, 20.0, 81):
        eccentric = brentq(lambda x, m=m: x - e * math.sin(x) - m, m - 1.0, m + 1.0, xtol=1e-14)
        nu = true_anomaly(e, m)
        assert abs(nu - m) < max(0.3, 2.6 * e)  # continuous
        assert math.cos(nu) == pytest.approx((math.cos(eccentric) - e) / (1.0 - e * math.cos(eccentric)), abs=1e-12)
        assert math.remainder(mean_anomaly(e, nu) - m, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("e", [0.0, 0.005, 0.09])
def test_steps_of_the_position_filter_are_the_transition(scheme_1: Scenario, e: float) -> None:
    ellipse = scheme_1.orbit.model_copy(update={"eccentricity": e, "true_anomaly_deg": 80.0})
    params = gnc_params.navigation(scheme_1.model_copy(update={"orbit": ellipse})).fusion
    state, step, dt = new(pkf.PKF_STATE), new(HILL_STEP), params.pkf.dt_s
    state.x[:6] = START
    for k in range(20000):
        move_hill_frame(params.orbit, k * dt, dt, step)
        pkf.predict_state(params.pkf, state, np.zeros(3), np.eye(3), step)
    whole = elliptic_motion.transition(params.orbit.mean_motion, e, math.radians(80.0), 20000 * dt)
    np.testing.assert_allclose(state.x[:3], (whole @ START)[:3], atol=5e-7)
    if e > 0.0:
        circle = hill.transition(params.orbit.mean_motion, 20000 * dt) @ START
        assert np.abs((whole @ START)[:3] - circle[:3]).max() > 1e-3


@pytest.mark.parametrize("e", [0.005, 0.09])
def test_turns_of_the_hill_frame_add_up_to_the_true_anomaly(scheme_1: Scenario, e: float) -> None:
    ellipse = scheme_1.orbit.model_copy(update={"eccentricity": e, "true_anomaly_deg": 80.0})
    orbit_params = gnc_params.target_orbit(scheme_1.model_copy(update={"orbit": ellipse}))
    step, total, dt = new(HILL_STEP), 0.0, 1.0
    for k in range(600):
        move_hill_frame(orbit_params, k * dt, dt, step)
        total += step.turn
    r, v = orbit.state_of_elements(GM, AXIS_M, e, 0.0, 0.0, 0.0, math.radians(80.0) + total)
    assert step.rate == pytest.approx(np.linalg.norm(np.cross(r, v)) / (r @ r), rel=2e-4)  # GM differs
    first, last = orbit_params.mean_anomaly, orbit_params.mean_anomaly + orbit_params.mean_motion * 600.0
    assert total == pytest.approx(true_anomaly(e, last) - true_anomaly(e, first), abs=1e-12)
