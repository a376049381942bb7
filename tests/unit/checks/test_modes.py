"""Bending modes and slosh in the tables of the GNC: control stays clear of them, or the scenario is refused."""

from __future__ import annotations

import math

import pytest

from hil.checks.modes import check_modes
from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.params import gnc as gnc_params
from hil.params.modes import swing_of
from hil.parts.campaigns.case_runner import CaseRunner
from hil.report.verdict_parts import propellant_kg

RIG = load_rig("mock").value
ROLL = math.sqrt(0.42 * 900.0)  # kg^1/2 m
ARRAY = (
    "chaser.solar_array.mode_frequency_hz=0.038",
    f"chaser.solar_array.mode_coupling=[{ROLL}, 0.0, 0.0]",
    "chaser.solar_array.mode_damping=0.005",
)
KNOWN = ("gnc.modes.array.frequency_hz=0.038", "gnc.modes.array.damping=0.005")


def scheme(*settings: str) -> Scenario:
    return load_scenario("scheme-1", settings).value


def test_part_of_the_inertia_is_another_word_for_a_coupling() -> None:
    coupled = scheme(*KNOWN, f"gnc.modes.array.coupling=[{ROLL}, 0.0, 0.0]")
    part = scheme(*KNOWN, "gnc.modes.array.inertia_fraction=[0.42, 0.0, 0.0]")
    for of in (0, 1):
        by_coupling, by_part = (swing_of(each, each.gnc.modes["array"])[of] for each in (coupled, part))
        assert by_coupling[3] == pytest.approx(by_part[3], rel=1e-3)
    assert by_part[3] == pytest.approx(2.0 * math.pi * 0.038 * 0.8 / math.sqrt(0.58))


def test_known_mode_widens_the_dead_band_and_slows_the_slew_of_its_axis_alone() -> None:
    plain, known = (
        gnc_params.gnc(each).control
        for each in (scheme(), scheme(*KNOWN, "gnc.modes.array.inertia_fraction=[0.42, 0.0, 0.0]"))
    )
    assert known.deadband[3] > 3.0 * plain.coast_scale[3] * (plain.pulse_s * plain.acceleration[3]) ** 2
    assert known.correction_rate[3] < 0.25 * plain.correction_rate[3]
    for axis in (0, 1, 2, 4, 5):
        assert (known.deadband[axis], known.correction_rate[axis]) == (
            plain.deadband[axis], plain.correction_rate[axis],
        )  # fmt: skip


def test_slosh_that_is_known_leaves_the_force_without_thrust_to_the_accelerometer() -> None:
    known = scheme(*KNOWN, "gnc.modes.array.mass_fraction=[0.1, 0.1, 0.1]")
    assert gnc_params.navigation(scheme()).fusion.thrust.enabled
    assert not gnc_params.navigation(known).fusion.thrust.enabled


def test_mode_in_the_band_of_control_is_refused_with_its_swing() -> None:
    known = load_scenario(
        "scheme-1", ("gnc.modes.tank.frequency_hz=0.004", "gnc.modes.tank.damping=0.005",
                     "gnc.modes.tank.inertia_fraction=[0.0, 0.44, 0.0]"),
    )  # fmt: skip
    (problem,) = check_modes(known)
    assert problem.key == "gnc.modes.tank"
    assert "0.004 Hz lies in the band of control: smallest firings swing the hub about y by" in problem.message
    heavy = load_scenario("scheme-1", (*KNOWN, "gnc.modes.array.coupling=[31.0, 0.0, 0.0]"))
    assert "allowed less than 1" in check_modes(heavy)[0].message


def test_array_of_two_fifths_of_the_inertia_takes_propellant_unless_it_is_known() -> None:
    spent = []
    for known in ((), (*KNOWN, "gnc.modes.array.inertia_fraction=[0.42, 0.0, 0.0]")):
        scenario = scheme(*ARRAY, *known)
        stats, _ = CaseRunner(scenario, RIG, 400.0).run(scenario, 2)
        spent.append(propellant_kg(stats, scenario))
    assert spent[1] < 0.08 < 0.13 < spent[0]
