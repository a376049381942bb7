"""Inertia that follows the mass of the propellant used."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import truth as kernels
from hil.dynamics.mass_properties import MASS_PROPERTIES, invert_symmetric, set_mass_properties
from hil.dynamics.truth import TRUTH_MEMORY
from hil.params import dynamics as dynamics_params
from tests.conftest import PLAIN

NO_FIELD = np.zeros((1, 1, 6))
GYRATION = "chaser.propellant_gyration_m=[0.3, 0.4, 0.5]"


def test_symmetric_matrix_is_inverted(rng: np.random.Generator) -> None:
    out = np.empty((3, 3))
    for _ in range(20):
        half = rng.standard_normal((3, 3))
        matrix = half @ half.T + 0.1 * np.eye(3)
        invert_symmetric(matrix, out)
        np.testing.assert_allclose(out @ matrix, np.eye(3), atol=1e-10)


def test_inertia_lacks_that_of_the_propellant_used() -> None:
    params, found = dynamics_params.dss(load_scenario("scheme-1", (*PLAIN, GYRATION)).value), new(MASS_PROPERTIES)
    set_mass_properties(params, 1000.0, found)
    np.testing.assert_array_equal(found.inertia, params.inertia)
    set_mass_properties(params, 988.0, found)
    np.testing.assert_allclose(params.inertia - found.inertia, 12.0 * np.diag([0.09, 0.16, 0.25]), atol=1e-10)
    np.testing.assert_allclose(found.inertia_inverse, np.linalg.inv(found.inertia), rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("settings", [(), (GYRATION,)], ids=["constant", "follows the mass"])
def test_lighter_vehicle_turns_faster_under_the_same_torque(settings: tuple[str, ...]) -> None:
    scenario = load_scenario("scheme-1", (*PLAIN, *settings)).value
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    truth.mass_kg -= 100.0
    truth.w_CI_C = 0.0
    on = np.zeros(MAX_THRUSTERS, np.int64)
    on[[2, 7]] = 1
    torque = np.cross(params.thruster_position[[2, 7]], 5.0 * params.thruster_direction[[2, 7]]).sum(axis=0)
    inertia = params.inertia - (100.0 * np.diag([0.09, 0.16, 0.25]) if settings else 0.0)
    kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, on)
    np.testing.assert_allclose(truth.w_CI_C, 0.02 * np.linalg.solve(inertia, torque), atol=1e-8)
