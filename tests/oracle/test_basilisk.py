"""The truth against Basilisk, an independent simulator; how to install it stands in constraints-oracle.txt."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("Basilisk", reason="Basilisk (bsk) is not installed: it belongs to the extra 'oracle'")

from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import central_gravity
from hil.dynamics import truth as kernels
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths import quat
from hil.params import dynamics as dynamics_params
from tests.support.basilisk_pair import Pair, gravity_model, write_field

pytestmark = pytest.mark.filterwarnings("ignore")  # Basilisk's own
QUIET = np.zeros(MAX_THRUSTERS, dtype=np.int64)


@pytest.fixture(scope="module")
def drift() -> Scenario:
    """Return scheme-2 with gravity alone, on an inclined, mildly eccentric orbit."""
    return load_scenario(
        "scheme-2",
        (
            "truth.solar_pressure=false",
            "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]",
            "orbit.eccentricity=0.03",
            "orbit.body_rotation_deg=70.0",
            "initial.velocity_mps=[0.004, -0.006, 0.003]",
        ),
    ).value


@pytest.fixture(scope="module")
def field_file(drift: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the field in Basilisk's own form."""
    return write_field(drift, tmp_path_factory.mktemp("field") / "moon.txt")


def inertial_states(truth: np.record) -> list[tuple[Any, Any]]:
    """Return position and velocity of target and chaser, inertial."""
    a = quat.to_matrix(truth.q_HI)
    r = a.T @ truth.r_CT_H
    v = a.T @ (truth.v_CT_H + np.cross(truth.w_HI_H, truth.r_CT_H))
    return [(truth.r_T_I, truth.v_T_I), (truth.r_T_I + r, truth.v_T_I + v)]


def test_gravity_agrees_to_rounding(drift: Scenario, field_file: Path, rng: np.random.Generator) -> None:
    params, field = dynamics_params.dss(drift), dynamics_params.field(drift)
    body = gravity_model(field_file)
    params.gravity.rotation = params.gravity.rate = 0.0
    ours = np.empty(3)
    for _ in range(200):
        r = rng.standard_normal(3)
        r *= rng.uniform(1.75e6, 2.5e6) / np.linalg.norm(r)
        central_gravity.acceleration(params.gravity, field, 0.0, r, ours)
        theirs = np.array(body.gravityModel.computeField([[x] for x in r.tolist()], 8, True)).ravel()
        assert np.linalg.norm(ours - theirs) <= 1e-12 * np.linalg.norm(ours)


@pytest.mark.parametrize(
    ("body", "altitude_m", "degree", "orbit_s"),
    [
        ("earth", 1100e3, 6, 6452.0),
        ("earth", 35786e3, 6, 86164.0),
        ("mars", 700e3, 3, 7950.0),
        ("bennu", 1e3, 2, 125e3),
    ],
    ids=["LEO", "GEO", "Mars", "Bennu"],
)
def test_relative_position_agrees_about_other_bodies(
    tmp_path: Path, body: str, altitude_m: float, degree: int, orbit_s: float
) -> None:
    scenario = load_scenario(
        "scheme-2",
        (
            "truth.solar_pressure=false",
            "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]",
            f"truth.gravity_degree={degree}",
            f"orbit.body={body}",
            f"orbit.altitude_m={altitude_m}",
            "orbit.eccentricity=0.09",
            "orbit.true_anomaly_deg=40.0",
        ),
    ).value
    params, field = dynamics_params.dss(scenario), dynamics_params.field(scenario)
    truth, memory = dynamics_params.initial_truth(scenario), new(TRUTH_MEMORY)
    file = write_field(scenario, tmp_path / "field.txt")
    pair = Pair(params, inertial_states(truth), file, step_s=0.5, turning=False)
    for span_s, tolerance_m in ((400.0, 1e-6), (orbit_s, 1e-3)):
        theirs = pair.run_to(span_s)
        while truth.t_s < span_s - 0.5 * params.dt_s:
            kernels.step(params, field, memory, truth, QUIET)
        ours = quat.to_matrix(truth.q_HI).T @ truth.r_CT_H
        assert np.linalg.norm(ours - theirs) <= tolerance_m


@pytest.mark.parametrize(("span_s", "tolerance_m"), [(400.0, 1e-6), (7655.0, 1e-3)], ids=["400 s", "an orbit"])
def test_relative_position_agrees(drift: Scenario, field_file: Path, span_s: float, tolerance_m: float) -> None:
    params, field, truth = (
        dynamics_params.dss(drift),
        dynamics_params.field(drift),
        dynamics_params.initial_truth(drift),
    )
    memory = new(TRUTH_MEMORY)
    assert 2.0 * math.pi / params.orbit_rate == pytest.approx(7655.0, abs=60.0)
    theirs = Pair(params, inertial_states(truth), field_file, step_s=0.5).run_to(span_s)
    for _ in range(round(span_s / params.dt_s)):
        kernels.step(params, field, memory, truth, QUIET)
    ours = quat.to_matrix(truth.q_HI).T @ truth.r_CT_H
    assert np.linalg.norm(ours) > 1.0
    assert np.linalg.norm(ours - theirs) <= tolerance_m
