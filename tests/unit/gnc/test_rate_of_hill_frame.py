"""Error of the rate of the Hill frame that the GNC assumes: part of the drift that the attitude filter expects."""

import numpy as np
import pytest

import hil
from hil.config.load import load_scenario
from hil.params.gnc import navigation


def test_without_it_the_drift_of_the_gyros_is_all() -> None:
    akf = navigation(load_scenario("scheme-1", ["gnc.ephemeris.rate_sigma_degps=0.0"]).value).fusion.akf
    assert akf.sigma_drift == np.radians(8.33e-8)
    assert akf.initial_drift_sigma == np.radians(1e-5)


@pytest.mark.parametrize("rate_hz", [50.0, 250.0])
def test_its_variance_grows_as_that_of_a_process_over_the_orbit_at_any_rate_of_the_filter(rate_hz: float) -> None:
    settings = ["gnc.ephemeris.rate_sigma_degps=5e-6", f"imu.rate_hz={rate_hz}"]
    fusion = navigation(load_scenario("scheme-1", settings).value).fusion
    per_second = rate_hz * (np.degrees(fusion.akf.sigma_drift) * fusion.akf.dt_s) ** 2
    assert per_second == pytest.approx(2.0 * (5e-6) ** 2 * fusion.orbit.mean_motion, rel=0.01)
    assert np.degrees(fusion.akf.initial_drift_sigma) == pytest.approx(np.hypot(1e-5, 5e-6))


def test_the_shipped_one_is_what_the_harmonics_add() -> None:
    scenario = load_scenario("scheme-1").value
    orbital = navigation(scenario).fusion.orbit.mean_motion
    apart = []
    for raan_deg in (0.0, 70.0, 140.0):
        for anomaly_deg in (0.0, 120.0, 240.0):
            place = {"orbit.raan_deg": raan_deg, "orbit.true_anomaly_deg": anomaly_deg}
            run = hil.run("scheme-1", duration_s=0.1, overrides=place)
            apart.append(np.degrees(run.truth.w_HI_H[-1] + [0.0, orbital, 0.0]))
    rms = np.sqrt(np.mean(np.square(apart)))
    assert 0.5 * rms < scenario.gnc.ephemeris.rate_sigma_degps < 2.0 * rms
