"""Docking monitor as a sensor module: noise by range, where the target is measured at all, and its short form."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.maths import quat
from hil.params.sensors import sensors_of, settings_row
from hil.parts.monitor.params import mounting
from hil.parts.monitor.sensor import AXES, UNOBSERVED_RAD
from hil.sensors.check import Trial

ALIGNED = np.array([0.0, 0.0, 0.0, 1.0])
BEHIND_M = 1.1
"""Range from the camera to the target's disc, less the distance of the reference points."""
NO_NOISE = np.zeros(16)


@pytest.fixture(scope="module")
def model() -> Trial:
    """The docking monitor of scheme 1, as its short form declares it."""
    kind, config, _ = sensors_of(load_scenario("scheme-1", ("monitor.source=model",)).value)["monitor"]
    return Trial(kind, settings_row(kind, config))


def measured(model: Trial, distance_m: float, noise: np.ndarray, across_m: float = 0.0) -> np.void | None:
    """Return the sample of a camera ``distance_m`` before the target's disc, None if there is none."""
    model.truth.r_CT_H, model.truth.q_CH = (distance_m - BEHIND_M, across_m, 0.0), ALIGNED
    model.truth.normal = noise
    return model.output.sample.copy() if model.measure() else None


@pytest.mark.parametrize(("distance_m", "factor"), [(1.5, 1.0), (6.0, 1.0), (16.0, 2.0), (32.0, 4.0)])
def test_errors_have_the_reported_covariance(
    model: Trial, rng: np.random.Generator, distance_m: float, factor: float
) -> None:
    errors, exact = np.empty((4000, 6)), measured(model, distance_m, NO_NOISE)
    assert exact is not None
    for row in errors:
        sample = measured(model, distance_m, rng.standard_normal(16))
        assert sample is not None
        row[:] = sample["value"] - exact["value"]
    sigma = np.sqrt(np.diag(exact["covariance"]))
    assert sigma[2] == pytest.approx(factor * 3e-5 * distance_m)  # along the line of sight
    assert sigma[0] == pytest.approx(factor * np.radians(0.0006) * distance_m)
    assert sigma[5] == pytest.approx(factor * np.radians(0.009))
    observed = sigma < UNOBSERVED_RAD
    np.testing.assert_allclose(errors.std(axis=0)[observed], sigma[observed], rtol=0.05)


def test_pitch_and_yaw_are_not_measured_from_far_away(model: Trial) -> None:
    near, far = (measured(model, distance_m, NO_NOISE) for distance_m in (15.9, 16.1))
    assert near is not None
    assert far is not None
    assert near["covariance"][3, 3] < 1e-6
    assert far["covariance"][3, 3] == far["covariance"][4, 4] == UNOBSERVED_RAD**2
    assert far["covariance"][5, 5] < 1e-6


@pytest.mark.parametrize(
    ("distance_m", "across_m"), [(0.9, 0.0), (40.1, 0.0), (3.0, 1.1), (3.0, -1.1), (-2.0, 0.0)],
    ids=["too near", "too far", "left of the image", "right of it", "behind the camera"],
)  # fmt: skip
def test_there_is_no_measurement_of_a_target_that_is_not_seen(model: Trial, distance_m: float, across_m: float) -> None:
    assert measured(model, distance_m, NO_NOISE, across_m) is None


def test_measurements_come_as_often_as_portions_of_the_scene_s_images() -> None:
    found = [
        sensors_of(load_scenario("scheme-1", ("monitor.source=model", f"monitor.scene={scene}")).value)["monitor"]
        for scene in ("atv", "bright-cross")
    ]
    # ten images of 12.5 per second, and ten half images of 50
    assert [config.rate_hz for _, config, _ in found] == [1.25, 5.0]


def test_axes_are_those_of_camera_and_target_and_a_loop_without_an_interlock_has_no_such_sensor() -> None:
    scenario = load_scenario("scheme-1", ("monitor.source=model",)).value
    for name in ("q_vc", "q_th"):
        np.testing.assert_allclose(quat.to_matrix(mounting(scenario.monitor)[name]), quat.to_matrix(np.array(AXES)))
    without = load_scenario("scheme-1", ("monitor.source=model", "monitor.interlock=false")).value
    assert (list(sensors_of(scenario)), list(sensors_of(without))) == (["monitor"], [])
