"""Orbits about other bodies: the truth against an independent integration, and the laws of its forces."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.config.load import load_body, load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import orbit_forces
from hil.dynamics import truth as kernels
from hil.dynamics.orbit_forces import ORBIT_FORCES
from hil.dynamics.sunlight import visible_sun
from hil.dynamics.truth import TRUTH_MEMORY
from hil.errors import BadInput
from hil.maths import quat
from hil.params import dynamics as dynamics_params
from hil.params.gnc import target_orbit

QUIET = np.zeros(MAX_THRUSTERS, dtype=np.int64)
DRIFT = (
    "truth.solar_pressure=false",
    "truth.flexible_array=false",
    "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]",
    "orbit.eccentricity=0.09",
    "orbit.true_anomaly_deg=40.0",
    "initial.velocity_mps=[0.004, -0.006, 0.003]",
)
ORBITS = {
    "earth": (
        "orbit.altitude_m=1100e3",
        "truth.gravity_degree=6",
        "truth.drag=true",
        "truth.third_bodies=true",
        "truth.chaser_ballistic_kgpm2=40.0",
    ),
    "geo": ("orbit.altitude_m=35786e3", "truth.gravity_degree=6", "truth.third_bodies=true"),
    "mars": ("orbit.altitude_m=700e3", "truth.gravity_degree=3", "truth.third_bodies=true"),
    "bennu": ("orbit.altitude_m=1000.0", "truth.gravity_degree=2", "truth.third_bodies=true"),
}


def drift(name: str) -> Scenario:
    """Return scheme-2 without thrusters, on an ellipse about one of ORBITS."""
    body = "earth" if name == "geo" else name
    return load_scenario("scheme-2", (*DRIFT, f"orbit.body={body}", *ORBITS[name])).value


def inertial(truth: np.record) -> tuple[np.ndarray, np.ndarray]:
    """Return the chaser's position, m, and velocity, m/s, relative to the target along inertial axes."""
    a = quat.to_matrix(truth.q_HI)
    return a.T @ truth.r_CT_H, a.T @ (truth.v_CT_H + np.cross(truth.w_HI_H, truth.r_CT_H))


def fly(scenario: Scenario, span_s: float, step_s: float = 0.02) -> np.record:
    """Return TRUTH after ``span_s``."""
    params, field = dynamics_params.dss(scenario), dynamics_params.field(scenario)
    truth, memory = dynamics_params.initial_truth(scenario), new(TRUTH_MEMORY)
    params.dt_s = step_s
    for _ in range(round(span_s / step_s)):
        kernels.step(params, field, memory, truth, QUIET)
    return truth


def acceleration(scenario: Scenario, t_s: float, r: np.ndarray, v: np.ndarray, ballistic: float) -> np.ndarray:
    """Return the acceleration (3,), m/s^2: zonal harmonics by Legendre polynomials, layers of air, third bodies."""
    body = load_body(scenario.orbit.body).value
    distance = float(np.linalg.norm(r))
    gm, u = body.gm_m3ps2, r[2] / distance
    total = -gm / distance**3 * r
    for n, j in enumerate(body.zonal, start=2):
        if n > scenario.truth.gravity_degree:
            break
        polynomial = np.polynomial.Legendre.basis(n)
        factor = j * gm / distance**2 * (body.radius_m / distance) ** n
        along = (n + 1) * polynomial(u) * r / distance
        total = total + factor * (along - polynomial.deriv()(u) * (np.array([0.0, 0.0, 1.0]) - u * r / distance))
    air = body.atmosphere
    if scenario.truth.drag and air is not None:
        altitude = distance / 1e3 - body.radius_km
        k = max(i for i, base in enumerate(air.altitude_km) if base <= altitude or i == 0)
        density = air.density_kgpm3[k] * math.exp((air.altitude_km[k] - altitude) / air.scale_height_km[k])
        flow = v - np.cross([0.0, 0.0, body.spin_radps], r)
        total = total - 0.5 * scenario.truth.density_scale * density / ballistic * np.linalg.norm(flow) * flow
    for other in body.third_bodies if scenario.truth.third_bodies else ():
        place = np.array(scenario.truth.sun_direction if other.direction is None else other.direction)
        angle = 2.0 * math.pi * t_s / (86400.0 * other.period_d)
        pole = np.array(other.pole) / np.linalg.norm(other.pole)
        away = other.distance_km * 1e3 * quat.transform_back(quat.from_rotation_vector(angle * pole), place)
        pull = (away - r) / np.linalg.norm(away - r) ** 3 - away / np.linalg.norm(away) ** 3
        total = total + other.gm_km3ps2 * 1e9 * pull
    return total


@pytest.mark.parametrize(
    ("name", "span_s", "tolerance_m"),
    [
        pytest.param("earth", 400.0, 1e-6, id="Earth, 400 s"),
        pytest.param("earth", 6700.0, 1e-3, id="Earth, an orbit", marks=pytest.mark.slow),
        pytest.param("geo", 400.0, 1e-6, id="GEO, 400 s", marks=pytest.mark.slow),
        pytest.param("geo", 86164.0, 1e-3, id="GEO, an orbit", marks=pytest.mark.slow),
        pytest.param("mars", 400.0, 1e-6, id="Mars, 400 s", marks=pytest.mark.slow),
        pytest.param("mars", 7950.0, 1e-3, id="Mars, an orbit", marks=pytest.mark.slow),
        pytest.param("bennu", 400.0, 1e-6, id="Bennu, 400 s", marks=pytest.mark.slow),
        pytest.param("bennu", 130000.0, 1e-3, id="Bennu, an orbit", marks=pytest.mark.slow),
    ],
)
def test_relative_position_agrees_with_dop853(name: str, span_s: float, tolerance_m: float) -> None:
    scenario = drift(name)
    truth, start = scenario.truth, dynamics_params.initial_truth(scenario)

    def rate(t_s: float, y: np.ndarray) -> np.ndarray:
        target = acceleration(scenario, t_s, y[0:3], y[3:6], truth.target_ballistic_kgpm2)
        chaser = acceleration(scenario, t_s, y[0:3] + y[6:9], y[3:6] + y[9:12], truth.chaser_ballistic_kgpm2)
        return np.concatenate([y[3:6], target, y[9:12], chaser - target])

    y_0 = np.concatenate([start.r_T_I, start.v_T_I, *inertial(start)])
    exact = solve_ivp(rate, (0.0, span_s), y_0, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    found = fly(scenario, span_s)
    r, _ = inertial(found)
    assert np.linalg.norm(r - exact[6:9]) <= tolerance_m


def test_air_of_the_body_rotates_and_thins_out_by_layers() -> None:
    scenario = drift("earth")
    forces, air = dynamics_params.dss(scenario).forces, load_body("earth").value.atmosphere
    assert air is not None
    for k in (0, 12, 20, 27):
        base, height = 1e3 * air.altitude_km[k], 1e3 * air.scale_height_km[k]
        assert orbit_forces.air_density(forces, base) == pytest.approx(air.density_kgpm3[k])
        assert orbit_forces.air_density(forces, base + 1.0) == pytest.approx(
            air.density_kgpm3[k] * math.exp(-1.0 / height)
        )
    r, still = np.array([forces.radius + 400e3, 0.0, 0.0]), np.zeros(3)
    orbit_forces.add_drag(forces, 0.01, r, np.array([0.0, forces.spin * r[0], 0.0]), still)
    np.testing.assert_array_equal(still, 0.0)
    out = np.zeros(3)
    orbit_forces.add_drag(forces, 0.01, r, np.array([0.0, 7668.0, 0.0]), out)
    flow = 7668.0 - forces.spin * r[0]
    np.testing.assert_allclose(out, [0.0, -0.5 * 3.725e-12 * 0.01 * flow**2, 0.0], rtol=1e-9)


def test_accelerometer_measures_the_drag_of_the_chaser_only() -> None:
    scenario = load_scenario("leo-vbar", ("truth.solar_pressure=false", "truth.density_scale=100.0")).value
    dragged = fly(scenario, 0.02).mean_force_C
    still = fly(scenario.model_copy(update={"truth": scenario.truth.model_copy(update={"drag": False})}), 0.02)
    density = 3.725e-10 * math.exp(-20.0 / 58.515)
    expected = 0.5 * density / scenario.truth.chaser_ballistic_kgpm2 * 7200.0**2
    assert np.linalg.norm(dragged - still.mean_force_C) == pytest.approx(expected, rel=0.05)
    assert dragged[0] < 0.0  # c is near H, whose x is along the velocity


def test_third_body_pulls_like_a_tide() -> None:
    forces = new(ORBIT_FORCES)
    forces.bodies, forces.body_gm[0] = 1, 4.9e12
    forces.body_position[0], forces.body_pole[0] = [3.844e8, 0.0, 0.0], [0.0, 0.0, 1.0]
    r, apart, pull, difference = np.array([4.2e7, 0.0, 0.0]), np.array([10.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)
    orbit_forces.add_third_bodies(forces, 0.0, r, apart, pull, difference)
    assert pull[0] == pytest.approx(4.9e12 * ((3.844e8 - 4.2e7) ** -2 - 3.844e8**-2), rel=1e-12)
    assert difference[0] == pytest.approx(2.0 * 4.9e12 * 10.0 / (3.844e8 - 4.2e7) ** 3, rel=1e-6)
    quarter = np.empty(3)
    orbit_forces.place_third_body(forces.body_position[0], forces.body_pole[0], 0.5 * math.pi, quarter)
    np.testing.assert_allclose(quarter, [0.0, 3.844e8, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("off_axis_deg", "expected"),  # umbra and penumbra end at asin(R / r) -+ the Sun's radius, 8.70 -+ 0.27 deg
    [(0.0, 0.0), (8.4, 0.0), (9.0, 1.0), (30.0, 1.0), (90.0, 1.0), (180.0, 1.0)],
)
def test_shadow_of_the_earth_in_geostationary_orbit(off_axis_deg: float, expected: float) -> None:
    a = math.radians(180.0 - off_axis_deg)
    r = 42164e3 * np.array([math.cos(a), math.sin(a), 0.0])
    assert visible_sun(6378.1e3, math.radians(0.2666), r, np.array([1.0, 0.0, 0.0])) == expected


def test_penumbra_is_half_lit_where_the_limb_halves_the_sun() -> None:
    sun, r, radius = np.array([1.0, 0.0, 0.0]), 42164e3, 6378.1e3
    a = math.pi - math.asin(radius / r)
    found = [
        visible_sun(radius, math.radians(0.2666), r * np.array([math.cos(a + d), math.sin(a + d), 0.0]), sun)
        for d in np.radians(np.linspace(0.27, -0.27, 13))
    ]
    assert found[6] == pytest.approx(0.5, abs=0.01)
    assert np.all(np.diff(found) >= 0.0)
    annular = visible_sun(1e3, 0.1, np.array([-1e5, 0.0, 0.0]), sun)
    assert annular == pytest.approx(0.99, abs=1e-4)


def test_eclipse_switches_the_pressure_of_light_off() -> None:
    dark = load_scenario("geo", ("orbit.true_anomaly_deg=180.0", "orbit.raan_deg=0.0")).value
    params, truth = dynamics_params.dss(dark), dynamics_params.initial_truth(dark)
    assert truth.sunlight == 0.0
    kernels.step(params, dynamics_params.field(dark), new(TRUTH_MEMORY), truth, QUIET)
    assert truth.sunlight == 0.0
    shadow = np.linalg.norm(truth.mean_force_C)
    lit = dark.model_copy(update={"truth": dark.truth.model_copy(update={"eclipse": False})})
    assert np.linalg.norm(fly(lit, 0.02).mean_force_C) > shadow + 1e-8


def test_numbers_of_the_shipped_bodies() -> None:
    periods = {"moon": (200e3, 7655.7), "earth": (35786e3, 86164.0), "mars": (17032e3, 88642.0)}
    for body, (altitude_m, period_s) in periods.items():
        orbit = load_scenario("scheme-1", (f"orbit.body={body}", f"orbit.altitude_m={altitude_m}")).value.orbit
        assert 2.0 * math.pi / dynamics_params.mean_motion(orbit) == pytest.approx(period_s, rel=2e-4)


def test_error_along_the_track_is_one_of_the_anomaly() -> None:
    scenario = load_scenario("leo-vbar", ("gnc.ephemeris.along_track_error_m=1000.0",)).value
    exact = load_scenario("leo-vbar").value
    ahead = target_orbit(scenario).mean_anomaly - target_orbit(exact).mean_anomaly
    assert ahead == pytest.approx(1000.0 / (6378136.3 + 420e3), rel=1e-6)


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        ('name = "x"\n', "gm_km3ps2", "is missing"),
        ('name = "x"\ngm_km3ps2 = -1.0\nradius_km = 1.0\nrotation_period_d = 1.0\n', "gm_km3ps2", "greater than 0"),
        ('name = "x"\ngm_km3ps2 = 1.0\nradius_km = 1.0\nrotation_period_d = 0.0\n', "", "rotation_period_d"),
        ('name = "x"\ngm_km3ps2 = 1.0\nradius_km = 1.0\nrotation_period_d = 1.0\nj2 = 1e-3\n', "j2", "unknown key"),
        (
            'name = "x"\ngm_km3ps2 = 1.0\nradius_km = 1.0\nrotation_period_d = 1.0\n[atmosphere]\n'
            "altitude_km = [0.0, 10.0]\ndensity_kgpm3 = [1.0]\nscale_height_km = [7.0, 7.0]\n",
            "atmosphere",
            "one per layer",
        ),
        ("name = 'x'\nzonal = [1e-3,", "", "not TOML"),
    ],
)
def test_bad_body_file_is_named_with_its_key(tmp_path: Path, text: str, key: str, words: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput) as caught:
        load_body(str(path))
    assert any(p.source == str(path) and key in p.key and words in p.message for p in caught.value.problems)
