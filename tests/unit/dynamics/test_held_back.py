"""What holds a planar chaser takes from its thrusters: Coriolis's acceleration, and what the harmonics add."""

from __future__ import annotations

import pytest

from hil.config.load import load_scenario
from hil.core.kernel_record import kernel_record
from hil.params.dynamics import initial_truth, mean_motion
from hil.params.held_back import HeldBack, held_back_text

SPEED_MPS = 0.03
CENTRED = "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]"
TRANSVERSE = ("chaser.plane=xy", "initial.attitude_deg=[0.0, 0.0, 0.0]", "initial.position_m=[5.0, 0.0, 0.0]")


def held_back(*settings: str) -> HeldBack:
    """Return what is held back in two seconds of a chaser that closes at ``SPEED_MPS`` from 5 m."""
    scenario = load_scenario("planar", (CENTRED, *settings)).value
    found, truth = HeldBack(scenario), kernel_record(initial_truth(scenario))
    for _ in range(2):
        truth.v_CT_H = -SPEED_MPS, 0.0, 0.0
        truth.r_CT_H[scenario.chaser.held - 1] = 0.0
        found.add(truth)
    return found


def test_coriolis_acceleration_is_held_back_and_integrated() -> None:
    found = held_back(*TRANSVERSE)
    coriolis = 2.0 * mean_motion(load_scenario("planar").value.orbit) * SPEED_MPS
    assert found.largest_mps2 == pytest.approx(coriolis, rel=1e-3)
    assert found.impulse_mps == pytest.approx(2.0 * coriolis, rel=1e-3)


def test_nothing_is_held_back_in_the_invariant_plane() -> None:
    assert held_back().impulse_mps == 0.0
    assert held_back_text(0.0, 0.0) == ""


def test_harmonics_are_held_back_in_any_plane() -> None:
    harmonics = held_back("truth.relative_motion=nonlinear")
    sphere = held_back("truth.relative_motion=nonlinear", "truth.gravity_degree=0")
    assert sphere.largest_mps2 < 1e-12
    assert harmonics.largest_mps2 > 1e-9
    assert "m/s2" in held_back_text(*(1e3 * each for each in (harmonics.largest_mps2, harmonics.impulse_mps)))
