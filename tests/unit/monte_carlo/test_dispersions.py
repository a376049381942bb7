"""Dispersed scenario of a case: by its number and the seed alone, with the given distributions."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy.stats import kstest

from hil.config.load import load_scenario
from hil.errors import BadInput
from hil.parts.campaigns.dispersions import Design, case_seed

PLAIN = "dispersions.sampling=random"


def drawn(name: str, cases: int, *settings: str, seed: int = 4) -> np.ndarray:
    """Return the values of one dispersion of scheme-1 over ``cases`` cases."""
    design = Design(load_scenario("scheme-1", settings), seed)
    place = design.names.index(name)
    return np.array([design.values(case)[place] for case in range(cases)])


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol"])
def test_case_is_the_same_whatever_was_drawn_before(sampling: str) -> None:
    scenario = load_scenario("scheme-1", (f"dispersions.sampling={sampling}",))
    alone = Design(scenario, 4).values(333)
    other = Design(scenario, 4)
    for case in (0, 500, 332):
        other.values(case)
    np.testing.assert_array_equal(alone, other.values(333))
    assert not np.array_equal(alone, Design(scenario, 5).values(333))


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol"])
def test_normal_and_uniform_have_their_distributions(sampling: str) -> None:
    chosen = f"dispersions.sampling={sampling}"
    z = (drawn("initial.position_m[1]", 800, chosen) - -0.3) / 0.02
    u = (drawn("vmu.sigma_angle_deg", 800, chosen) / 0.033 - 0.8) / 0.4
    assert kstest(z, "norm").pvalue > 0.01
    assert kstest(u, "uniform").pvalue > 0.01


def test_each_block_of_a_latin_hypercube_has_one_case_in_each_stratum() -> None:
    u = (drawn("vmu.latency_s", 100, "dispersions.cases_per_hypercube=50") / 0.1).reshape(2, 50)
    for block in u:
        np.testing.assert_array_equal(np.sort((block * 50).astype(int)), np.arange(50))


def test_normal_is_cut_at_its_bounds() -> None:
    spread = "dispersions.vmu.latency_s={kind='normal', mean=0.0, sigma=0.1, low=0.0, high=0.15}"
    values = drawn("vmu.latency_s", 400, PLAIN, spread)
    assert values.min() >= 0.0
    assert values.max() <= 0.15
    assert kstest(values / 0.15, "uniform").pvalue < 0.01  # cut, not folded flat


def test_sigma_of_zero_keeps_the_value() -> None:
    np.testing.assert_array_equal(drawn("chaser.mass_kg", 5, "dispersions.chaser.mass_kg.sigma=0.0"), 1000.0)


def test_matrix_is_spread_as_a_whole() -> None:
    design = Design(load_scenario("scheme-1"), 4)
    values = design.values(2)
    truth, told = design.apply(values)
    factor = values[design.names.index("chaser.inertia_kg_m2")]
    np.testing.assert_allclose(truth.chaser.inertia_kg_m2, factor * np.array(told.chaser.inertia_kg_m2))
    assert factor != 1.0


def test_a_wrong_bench_is_dispersed_as_wrong_cameras_are() -> None:
    design = Design(load_scenario("scheme-1", ("dispersions.bench.errors.middle_m={kind='normal', sigma=0.001}",)), 4)
    values = design.values(1)
    truth, told = design.apply(values)
    assert truth.bench.errors.middle_m == values[design.names.index("bench.errors.middle_m")] != 0.0
    assert told.bench.errors.is_empty


def test_gnc_receives_only_its_own_table() -> None:
    late = "dispersions.gnc.abort.at_s={kind='uniform', low=10.0, high=20.0}"
    scenario = load_scenario("scheme-1", (late,))
    design = Design(scenario, 4)
    truth, told = design.apply(design.values(1))
    assert told.chaser == scenario.value.chaser != truth.chaser
    assert told.initial == scenario.value.initial
    assert told.gnc.abort.at_s == truth.gnc.abort.at_s
    assert told.gnc.abort.at_s is not None
    assert 10.0 <= told.gnc.abort.at_s <= 20.0


def test_seeds_of_cases_differ_between_cases_and_campaigns() -> None:
    seeds = {case_seed(seed, case) for seed in range(10) for case in range(500)}
    assert len(seeds) == 5000
    assert min(seeds) >= 0


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("dispersions.initial.position_m.sigma=-1.0", ("initial.position_m", "sigma = -1", "must not be negative")),
        ("dispersions.initial.positon_m={kind='normal', sigma=1.0}", ("initial.positon_m", "did you mean position_m")),
        ("dispersions.vmu.latency_s.kind=gauss", ("vmu.latency_s.kind", '"gauss"', "'normal' or 'uniform'")),
        ("dispersions.vmu.latency_s.low=5.0", ("vmu.latency_s", "low = 5, high = 0.1")),
        ("dispersions.initial.position_m.sigma=[1.0, 2.0]", ("initial.position_m", "must be one number or 3")),
        ("dispersions.chaser.inertia_kg_m2.relative=false", ("inertia_kg_m2", "relative = true")),
        ("dispersions.truth.gravity_degree={kind='normal', sigma=1.0}", ("gravity_degree", "decimal numbers")),
        ("dispersions.gnc.abort.at_s={kind='normal', sigma=1.0}", ("gnc.abort.at_s", "has no value")),
        ("dispersions.initial.position_m=3.0", ("initial.position_m", "must be a table")),
        ("dispersions.initial.position_m.sigma=3 cm", ('_m.sigma: "3 cm": must be a valid number or a valid array',)),
        ('dispersions.initial.position_m.sigma=[1.0, "3 cm", 0.0]', ('_m.sigma[1]: "3 cm": must be a valid number',)),
        ("dispersions.weather={}", ("dispersions.weather", "unknown key", "initial")),
    ],
)
def test_bad_dispersion_is_reported_in_one_line(setting: str, words: tuple[str, ...]) -> None:
    with pytest.raises(BadInput) as caught:
        Design(load_scenario("scheme-1", (setting,)), 0)
    assert len(caught.value.problems) == 1
    for word in words:
        assert word in str(caught.value)


FAULTS = (
    'dispersions.faults.draw=[{device="vmu", kind="offset", weight=3.0, value=[0.1, 0.4], at_s=[5.0, 50.0], '
    'lasting_s=[1.0, 2.0]}, {device="thruster", kind="stuck_open", at_s=[0.0, 9.0]}]',
)


def test_one_case_in_four_has_a_thruster_stuck_open_and_three_an_offset_of_the_vision_unit() -> None:
    design = Design(load_scenario("scheme-1", FAULTS), 7)
    found = [design.apply(design.values(case), design.fault(case))[0].faults for case in range(400)]
    drawn = [faults[0] for faults in found if len(faults) == 1]
    assert len(drawn) == 400
    offsets = [fault for fault in drawn if fault.device == "vmu"]
    assert 270 < len(offsets) < 330
    sizes = [math.hypot(*fault.values) for fault in offsets]
    assert 0.1 <= min(sizes) < 0.12
    assert 0.38 < max(sizes) <= 0.4
    assert all(5.0 <= fault.at_s <= 50.0 and 1.0 <= fault.end_s - fault.at_s <= 2.0 for fault in offsets)
    assert {fault.device for fault in drawn if fault.device != "vmu"} == {f"thruster.{i}" for i in range(1, 17)}


def test_faults_leave_the_other_dispersions_of_a_case_as_they_are() -> None:
    with_faults, without = (Design(load_scenario("scheme-1", settings), 7) for settings in (FAULTS, ()))
    np.testing.assert_array_equal(with_faults.values(5), without.values(5))
    assert without.fault(5) is None
    assert with_faults.fault(5) == Design(load_scenario("scheme-1", FAULTS), 7).fault(5)


@pytest.mark.parametrize(
    ("draw", "said"),
    [
        ('device="vmu", kind="stuck", at_s=[0.0, 1.0]', "not in the table of faults"),
        ('device="vmu", kind="offset", at_s=[0.0, 1.0]', "needs value"),
        ('device="vmu", kind="no_pose", value=[0.0, 1.0], at_s=[0.0, 1.0]', "has no value"),
        ('device="vmu", kind="no_pose", at_s=[2.0, 1.0]', "the first number must not exceed the second"),
        ('device="vmu", kind="no_pose", at_s=[-2.0, 1.0]', "must not be negative"),
        ('device="vmu", kind="no_pose"', "dispersions.faults.draw[0].at_s: is missing"),
    ],
)
def test_a_draw_that_cannot_be_is_one_line(draw: str, said: str) -> None:
    with pytest.raises(BadInput, match=re.escape(said)):
        load_scenario("scheme-1", (f"dispersions.faults.draw=[{{{draw}}}]",))
