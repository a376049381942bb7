"""Error budget of the bench: sigma of a pose by geometry, encoders and drift, per axis and place."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.params.bench_budget import BenchSigma

PLACE = np.array([3.0, 0.2, -0.1]), np.array([0.1, -0.1, 0.2])


def sigmas(*settings: str) -> tuple[np.ndarray, np.ndarray]:
    rig = load_rig("mock", [f"rig.{text}" for text in settings]).value
    return BenchSigma(rig, 0.02)(*PLACE)


def test_a_bench_that_was_not_measured_has_the_sigma_of_its_tolerances() -> None:
    m, deg = sigmas()
    twice_m, twice_deg = sigmas("bench.tolerance_m=0.002", "bench.tolerance_deg=0.1")
    assert (m > 1e-3).all()
    assert (deg > 0.05).all()
    assert twice_m == pytest.approx(2.0 * m)
    assert twice_deg == pytest.approx(2.0 * deg)


def test_it_depends_on_the_place() -> None:
    budget = BenchSigma(load_rig("mock").value, 0.02)
    near, _ = budget(np.array([1.0, 0.0, 0.0]), np.zeros(3))
    far, _ = budget(np.array([11.0, 0.0, 0.0]), np.zeros(3))
    assert (far[1:] > 1.3 * near[1:]).all()


def test_drift_and_encoders_are_added() -> None:
    exact = ("bench.tolerance_m=0.0", "bench.tolerance_deg=0.0")
    m, deg = sigmas(*exact)
    assert not m.any()
    assert not deg.any()
    m, deg = sigmas(*exact, "bench.thermal_sigma_m=3e-4", "bench.thermal_sigma_deg=0.01", "rails.encoder_sigma_m=4e-4")
    assert m == pytest.approx([5e-4] * 3)
    assert deg == pytest.approx([0.01] * 3)
