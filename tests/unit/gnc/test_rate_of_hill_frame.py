"""Error of the rate of the Hill frame that the GNC assumes: part of the drift that the attitude filter expects."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hil
from hil.config.load import load_scenario
from hil.core.messages import POSE, Array, new
from hil.params.gnc import navigation
from tests.support.hill_steps import on_circle
from tests.support.joint_filter import NO_FORCE, JointFilter
from tests.support.plain_filters import PLAIN

SIGMAS = [0.0, 1e-6, 9e-6]


def rate_errors(scenario: str, *places: dict[str, float]) -> Array:
    """Return what the rate of H differs by from a circle's, (n, 3), deg/s, at the starts of runs."""
    orbital = navigation(load_scenario(scenario).value).fusion.orbit.mean_motion
    runs = [hil.run(scenario, duration_s=0.1, overrides=place) for place in places]
    return np.array([np.degrees(run.truth.w_HI_H[-1] + [0.0, orbital, 0.0]) for run in runs])


@pytest.mark.parametrize("rate_hz", [50.0, 250.0])
@pytest.mark.parametrize("duration_s", [400.0, 86_400.0])
def test_its_variance_grows_as_over_the_orbit_at_any_rate_of_the_filter(rate_hz: float, duration_s: float) -> None:
    settings = [f"gnc.ephemeris.rate_sigma_degps={SIGMAS}", f"imu.rate_hz={rate_hz}", f"duration_s={duration_s}"]
    fusion = navigation(load_scenario("scheme-1", settings).value).fusion
    n, noise = fusion.orbit.mean_motion, np.degrees(fusion.akf.rate_noise) * fusion.akf.dt_s
    growth = min((n * duration_s) ** 2, 2.0 * n * duration_s)
    np.testing.assert_allclose(duration_s * rate_hz * noise**2, np.square(SIGMAS) * growth, rtol=1e-9)


def test_it_adds_to_the_covariance_of_the_drift_in_the_axes_of_the_chaser(rng: np.random.Generator) -> None:
    fusion, pose = navigation(load_scenario("scheme-1", PLAIN).value).fusion, new(POSE)
    params, turn = fusion.akf, Rotation.from_rotvec([0.3, -0.8, 0.5])
    pose.q_CH, pose.covariance_attitude, pose.covariance_position = turn.as_quat(), 1e-9 * np.eye(3), np.eye(3)
    to_c = turn.as_matrix().T
    starts = to_c @ np.diag(params.rate_sigma**2) @ to_c.T + params.initial_drift_sigma**2 * np.eye(3)
    own = JointFilter(fusion, pose)
    np.testing.assert_allclose(own.p_akf[3:, 3:], starts, rtol=1e-12, atol=1e-25)
    own.predict(params.initial_drift, NO_FORCE, on_circle(0.0, params.dt_s))
    noise = to_c @ np.diag(params.rate_noise**2) @ to_c.T + params.sigma_drift**2 * np.eye(3)
    np.testing.assert_allclose(own.p_akf[3:, 3:] - starts, params.dt_s**2 * noise, rtol=1e-3, atol=1e-25)


def test_the_shipped_ones_are_what_harmonics_add() -> None:
    places = [
        {"orbit.raan_deg": raan_deg, "orbit.true_anomaly_deg": anomaly_deg}
        for raan_deg in (0.0, 70.0, 140.0)
        for anomaly_deg in (0.0, 120.0, 240.0)
    ]
    for name in ("scheme-1", "leo-vbar"):
        rms = np.sqrt(np.mean(rate_errors(name, *places) ** 2, axis=0))
        assert rms[0] == 0.0
        assert rms[2] == pytest.approx(load_scenario(name).value.gnc.ephemeris.rate_sigma_degps[2], rel=0.5)
