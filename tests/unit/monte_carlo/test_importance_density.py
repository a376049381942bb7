"""Importance sampling of a first passage: of filtered noise whose probability is known, in thousands of dimensions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm

from hil.core.messages import Array
from hil.maths.random_streams import MixedSeed, noise_source, stream
from hil.parts.campaigns.importance_campaign import importance_estimate, peaks_of
from hil.parts.campaigns.importance_density import (
    ImportanceDensity,
    PilotCases,
    block_normals,
    block_of_row,
    fitted_density,
    noise_drivers,
)

BLOCK_S, RATES_HZ = 0.64, {"imu": 50.0, "vision": 6.25}
BLOCKS, WIDTH, LEADS, APART = 300, 6, 20, 20
RESPONSE = np.exp(-np.arange(LEADS) / 6.0) * np.sin(0.3 + np.arange(LEADS) / 5.0)
RESPONSE /= np.linalg.norm(RESPONSE)
MOMENTS = np.arange(LEADS - 1, BLOCKS, APART)  # whose windows of LEADS blocks do not overlap: they are independent


def deviations_of(normals: Array) -> Array:
    """Return the deviation at MOMENTS: the first vision channel through RESPONSE. normals: (blocks, width)."""
    filtered = np.convolve(normals[:, 0], RESPONSE)[: len(normals)]
    found: Array = filtered[MOMENTS]
    return found


def threshold_of(probability: float) -> float:
    """Return the threshold that one of the deviations exceeds with ``probability``."""
    each = -math.expm1(math.log1p(-probability) / len(MOMENTS))
    return float(norm.isf(0.5 * each))


def pilot(cases: int, seed: int) -> PilotCases:
    """Return pilot cases of the filtered noise."""
    generator = np.random.default_rng(seed)
    vision = generator.standard_normal((cases, BLOCKS, WIDTH))
    peaks = []
    for case in range(cases):
        found = deviations_of(vision[case])
        peaks += [(case, MOMENTS[i], found[i]) for i in np.argsort(-np.abs(found))[:4]]
    return PilotCases({"vision": vision}, np.zeros((cases, 0)), np.array(peaks, dtype=float))


def density_of(level: float, seed: int, cases: int = 200) -> ImportanceDensity:
    """Return the density fitted to pilot cases."""
    found = fitted_density(pilot(cases, seed), level, 0, BLOCK_S, {"vision": RATES_HZ["vision"]})
    assert found is not None
    return found


def estimate(probability: float, cases: int, seed: int) -> tuple[float, float]:
    """Return estimate and stated c.o.v. of an event of ``probability``."""
    level = threshold_of(probability)
    density = density_of(level, seed)
    rows = len(block_of_row(RATES_HZ["vision"], BLOCK_S, BLOCKS))
    terms = np.zeros(cases)
    for case in range(cases):
        drawn = noise_source(density.seed(seed, case), "vision").standard_normal((rows, WIDTH))
        normals = block_normals(drawn, RATES_HZ["vision"], BLOCK_S, BLOCKS)
        if np.abs(deviations_of(normals)).max() > level:
            terms[case] = math.exp(density.log_weight({"vision": normals}, np.zeros(0)))
    return importance_estimate(terms)


def test_means_are_the_response_reversed_in_time_and_other_channels_have_none() -> None:
    level = threshold_of(1e-4)
    mean = density_of(level, 1).means["vision"]
    assert mean[:LEADS, 0] @ RESPONSE == pytest.approx(level, rel=0.1)
    assert np.linalg.norm(mean[:LEADS, 0]) == pytest.approx(level, rel=0.1)
    assert not mean[:, 1:].any()


def test_one_in_ten_thousand_is_found_with_some_hundred_cases() -> None:
    found, cov = estimate(1e-4, 500, 3)
    assert 0.05 < cov < 0.4
    assert found == pytest.approx(1e-4, rel=3.0 * cov)


@pytest.mark.slow
@pytest.mark.parametrize("probability", [1e-3, 1e-6])
def test_stated_cov_is_that_of_forty_repetitions(probability: float) -> None:
    found = np.array([estimate(probability, 800, 100 + seed) for seed in range(40)])
    actual = found[:, 0].std(ddof=1) / probability
    assert found[:, 0].mean() == pytest.approx(probability, rel=3.0 * actual / math.sqrt(40))
    assert 0.7 < actual / found[:, 1].mean() < 1.4
    held = np.abs(np.log(found[:, 0] / probability)) < 1.96 * found[:, 1]
    assert held.mean() >= 0.85


def test_pilot_without_a_response_has_no_density() -> None:
    noise = pilot(100, 5)
    generator = np.random.default_rng(6)
    peaks = np.column_stack([noise.peaks[:, :2], generator.standard_normal(len(noise.peaks))])
    assert fitted_density(PilotCases(noise.normals, noise.dispersions, peaks), 4.0, 0, BLOCK_S, RATES_HZ) is None


def test_dispersed_number_that_scales_the_deviation_has_a_mean_and_others_have_none() -> None:
    generator = np.random.default_rng(7)
    dispersions = generator.standard_normal((400, 3))
    found = pilot(400, 7)
    scale = np.exp(0.1 * dispersions[:, 1])
    peaks = found.peaks * np.column_stack([np.ones((len(found.peaks), 2)), scale[found.peaks[:, 0].astype(int)]])
    density = fitted_density(PilotCases(found.normals, dispersions, peaks), 4.0, 0, BLOCK_S, {"vision": 6.25})
    assert density is not None
    assert density.dispersions[1] > 0.5
    assert density.dispersions[0] == density.dispersions[2] == 0.0


def test_weight_is_the_ratio_of_the_densities_of_all_components() -> None:
    means = {"vision": np.array([[1.5], [-0.5]])}
    density = ImportanceDensity(BLOCK_S, 1, 3, means, {"vision": 6.25}, np.array([0.7]))
    z, u = np.array([[0.3], [-1.1], [0.9]]), np.array([0.4])
    total = 0.1
    for at in (1, 2):
        for sign in (1.0, -1.0):
            mean = np.zeros(3)
            mean[at], mean[at - 1] = sign * 1.5, sign * -0.5
            total += 0.9 / 4 * math.exp(mean @ z[:, 0] - 0.5 * mean @ mean + 0.7 * u[0] - 0.5 * 0.7**2)
    assert density.log_weight({"vision": z}, u) == pytest.approx(-math.log(total), abs=1e-12)
    assert ImportanceDensity.parse(density.text()).text() == density.text()


def test_means_reach_the_rows_of_their_blocks_in_any_block_size() -> None:
    mean = {"imu": np.zeros((2, 12)), "vision": np.array([[4.0] * 6, [2.0] * 6])}
    density = ImportanceDensity(BLOCK_S, 2, 3, mean, RATES_HZ, np.zeros(0))
    seeds = [density.seed(0, case) for case in range(40)]
    shifted = next(seed for seed in seeds if seed.means)
    assert any(not seed.means for seed in seeds)
    whole = noise_source(shifted, "vision").standard_normal((20, 6))
    source = noise_source(shifted, "vision")
    parts = [source.standard_normal((rows, 6)) for rows in (1, 9, 10)]
    assert np.array_equal(whole, np.concatenate(parts))
    added = whole - stream(int(shifted), "vision").standard_normal((20, 6))
    sign = np.sign(added[11, 0])
    assert np.allclose(added, sign * np.repeat([0.0, 1.0, 2.0, 0.0], [4, 4, 4, 8])[:, None])
    assert isinstance(shifted, MixedSeed)


def test_noise_that_is_reduced_by_its_factor_halves_the_probability() -> None:
    means = {"vision": np.array([[0.0, 0.0, 4.0, 0.0, 0.0, 0.0]]), "imu": np.array([[0.0] * 3 + [1.0] + [0.0] * 8])}
    rows = noise_drivers(ImportanceDensity(BLOCK_S, 0, 9, means, RATES_HZ, np.zeros(0)))
    assert [row["noise"] for row in rows] == ["vision position z", "imu accelerometer x"]
    assert rows[0]["part"] == pytest.approx(16.0 / 17.0)
    assert rows[1]["halved_by"] is None
    level = math.sqrt(17.0)
    left = norm.sf(level / math.sqrt((16.0 * rows[0]["halved_by"] ** 2 + 1.0) / 17.0))
    assert left / norm.sf(level) == pytest.approx(0.5, abs=0.02)


def test_peaks_are_the_largest_deviations_that_stand_apart() -> None:
    t_s = np.arange(0.0, 100.0, 1.0)
    deviation = np.zeros(100)
    deviation[[5, 40, 45, 80]] = (9.0, -3.0, 2.0, 1.0)
    assert peaks_of(deviation, t_s, 30.0) == [(40.0, -3.0), (80.0, 1.0)]
