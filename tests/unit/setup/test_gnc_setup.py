"""Setup of an external GNC: orbit and motion of the target."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.config.load import load_scenario
from hil.core.messages import Array, new
from hil.gnc.estimation.target_orbit import HILL_STEP, move_hill_frame
from hil.models.rotating_frame import tumble_rate
from hil.params import gnc as gnc_params
from hil.session.gnc_setup import gnc_setup


def test_orbit_in_the_setup_gives_the_rate_that_the_filters_use() -> None:
    """By the formulas of the page of the records."""
    scenario = load_scenario("scheme-1", ("orbit.eccentricity=0.05", "orbit.true_anomaly_deg=70.0")).value
    setup, step = gnc_setup(scenario), new(HILL_STEP)
    e, n, t_s = float(setup.eccentricity), float(setup.mean_motion_radps), 300.0
    assert e == 0.05
    mean = anomaly = float(setup.mean_anomaly_rad) + n * t_s
    for _ in range(30):
        anomaly = mean + e * math.sin(anomaly)
    nu = 2.0 * math.atan(math.sqrt((1.0 + e) / (1.0 - e)) * math.tan(0.5 * anomaly))
    move_hill_frame(gnc_params.target_orbit(scenario), t_s - 0.02, 0.02, step)
    assert step.rate == pytest.approx(n * (1.0 + e * math.cos(nu)) ** 2 / (1.0 - e * e) ** 1.5, rel=1e-9)
    assert setup.tumbles == 0
    assert not np.any(setup.target_rate_radps)


@pytest.mark.parametrize("name", ["tumbling-1", "tumbling-5"])
def test_tumble_in_the_setup_follows_eulers_equations_to_the_rate_that_the_filters_use(name: str) -> None:
    scenario = load_scenario(name, ("gnc.target.rate_error_degps=[0.01, 0.0, -0.02]",)).value
    setup = gnc_setup(scenario)
    inertia = np.array(setup.target_inertia_kgm2)

    def change(_: float, w: Array) -> Array:
        return np.asarray(np.linalg.solve(inertia, -np.cross(w, inertia @ w)))

    found = solve_ivp(change, (0.0, 200.0), np.array(setup.target_rate_radps), method="DOP853", rtol=1e-10, atol=1e-13)
    rate, aside = np.empty(3), np.empty(3)
    tumble_rate(gnc_params.target_orbit(scenario).tumble, 200.0, rate, aside)
    assert setup.tumbles == 1
    np.testing.assert_allclose(found.y[:, -1], rate, rtol=0.0, atol=1e-9)
