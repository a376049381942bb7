"""Statistical model of the docking monitor: noise by range, and where the target is measured at all."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import VMU_FRAME, new
from hil.dynamics.docking_monitor import MONITOR_NOISE, UNOBSERVED_RAD, measure_target
from hil.maths import quat
from hil.params.monitor import monitor_model

ALIGNED = np.array([0.0, 0.0, 0.0, 1.0])
BEHIND_M = 1.1
"""Range from the camera to the target's disc, less the distance of the reference points."""


@pytest.fixture(scope="module")
def model() -> np.record:
    return monitor_model(load_scenario("scheme-1", ("monitor.source=model",)).value)


def measured(model: np.record, distance_m: float, noise: np.ndarray, across_m: float = 0.0) -> np.record | None:
    """Return the measurement from a camera ``distance_m`` before the target's disc, None if there is none."""
    frame = new(VMU_FRAME)
    r = np.array([distance_m - BEHIND_M, across_m, 0.0])
    seen = measure_target(model, r, ALIGNED, noise, frame.t_v, frame.q_vt, frame.covariance)
    return frame if seen else None


@pytest.mark.parametrize(("distance_m", "factor"), [(1.5, 1.0), (6.0, 1.0), (16.0, 2.0), (32.0, 4.0)])
def test_errors_have_the_reported_covariance(
    model: np.record, rng: np.random.Generator, distance_m: float, factor: float
) -> None:
    errors, exact = np.empty((4000, 6)), measured(model, distance_m, np.zeros(MONITOR_NOISE))
    assert exact is not None
    for row in errors:
        frame = measured(model, distance_m, rng.standard_normal(MONITOR_NOISE))
        assert frame is not None
        row[:3] = frame.t_v - exact.t_v
        row[3:] = -quat.to_rotation_vector(quat.multiply(frame.q_vt, quat.conjugate(exact.q_vt)))
    sigma = np.sqrt(np.diag(exact.covariance))
    assert sigma[2] == pytest.approx(factor * 3e-5 * distance_m)  # along the line of sight
    assert sigma[0] == pytest.approx(factor * np.radians(0.0006) * distance_m)
    assert sigma[5] == pytest.approx(factor * np.radians(0.009))
    observed = sigma < UNOBSERVED_RAD
    np.testing.assert_allclose(errors.std(axis=0)[observed], sigma[observed], rtol=0.05)


def test_pitch_and_yaw_are_not_measured_from_far_away(model: np.record) -> None:
    near, far = (measured(model, distance_m, np.zeros(MONITOR_NOISE)) for distance_m in (15.9, 16.1))
    assert near is not None
    assert far is not None
    assert near.covariance[3, 3] < 1e-6
    assert far.covariance[3, 3] == far.covariance[4, 4] == UNOBSERVED_RAD**2
    assert far.covariance[5, 5] < 1e-6


@pytest.mark.parametrize(
    ("distance_m", "across_m"), [(0.9, 0.0), (40.1, 0.0), (3.0, 1.1), (3.0, -1.1), (-2.0, 0.0)],
    ids=["too near", "too far", "left of the image", "right of it", "behind the camera"],
)  # fmt: skip
def test_there_is_no_measurement_of_a_target_that_is_not_seen(
    model: np.record, distance_m: float, across_m: float
) -> None:
    assert measured(model, distance_m, np.zeros(MONITOR_NOISE), across_m) is None


def test_measurements_come_as_often_as_portions_of_the_scene_s_images(model: np.record) -> None:
    assert model.rate_hz == 1.25  # ten images of 12.5 per second
    crossed = load_scenario("scheme-1", ("monitor.source=model", "monitor.scene=bright-cross")).value
    assert monitor_model(crossed).rate_hz == 5.0  # ten half images of 50 per second
