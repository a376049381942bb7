"""From six demands to thrusters: the right way, and little else."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.scenario import Scenario
from hil.core.messages import COMMAND, new
from hil.gnc.allocation import select, thruster_sets, unit_wrenches
from hil.params import gnc as gnc_params

ARM_OFFSET_M = 0.04  # the quads stand this far behind the centre of mass


def wrenches_of(scenario: Scenario) -> np.ndarray:
    thrusters = scenario.chaser.thrusters
    position, direction = np.array(thrusters.position_m), np.array(thrusters.direction)
    return unit_wrenches(position, direction, np.full(len(position), thrusters.force_n))


def wrench_of(
    scenario: Scenario, force: tuple[int, ...] = (0, 0, 0), torque: tuple[int, ...] = (0, 0, 0)
) -> np.ndarray:
    """Return the wrench (6,) of what is selected for the demands."""
    wrenches = wrenches_of(scenario)
    sets, _ = gnc_params.allocation(scenario.chaser)
    command = new(COMMAND)
    command.force, command.torque = force, torque
    select(sets, len(wrenches), command)
    assert not command.on[len(wrenches) :].any()
    return command.on[: len(wrenches)] @ wrenches


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_force_demand_pushes_its_axis_and_turns_only_by_the_offset_of_the_quads(
    scheme_1: Scenario, axis: int, sign: int
) -> None:
    demand = np.zeros(3, dtype=int)
    demand[axis] = sign
    found = wrench_of(scheme_1, force=tuple(demand))
    force = found[:3]
    assert sign * force[axis] > 0.0
    np.testing.assert_allclose(np.delete(force, axis), 0.0, atol=1e-12)
    np.testing.assert_allclose(found[3:], np.cross([ARM_OFFSET_M, 0.0, 0.0], force), atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_torque_demand_is_a_pure_couple(scheme_1: Scenario, axis: int, sign: int) -> None:
    demand = np.zeros(3, dtype=int)
    demand[axis] = sign
    found = wrench_of(scheme_1, torque=tuple(demand))
    assert sign * found[3 + axis] > 0.0
    np.testing.assert_allclose(np.delete(found, 3 + axis), 0.0, atol=1e-12)


def test_strength_is_that_of_the_chosen_set(scheme_1: Scenario) -> None:
    _, strength = gnc_params.allocation(scheme_1.chaser)
    for axis in range(6):
        demand = np.zeros(6, dtype=int)
        demand[axis] = 1
        found = wrench_of(scheme_1, force=tuple(demand[:3]), torque=tuple(demand[3:]))
        assert strength[axis] == pytest.approx(found[axis])


def test_demands_on_all_axes_never_turn_one_of_them_round(scheme_1: Scenario, rng: np.random.Generator) -> None:
    for _ in range(200):
        demand = rng.integers(-1, 2, 6)
        found = wrench_of(scheme_1, force=tuple(demand[:3]), torque=tuple(demand[3:]))
        # a demand may be weakened by another, never reversed beyond what the quads' offset does
        slack = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0]) * ARM_OFFSET_M * 20.0 + 1e-9
        assert (found * demand >= -slack).all(), demand


def test_no_demand_opens_no_thruster(scheme_1: Scenario) -> None:
    np.testing.assert_array_equal(wrench_of(scheme_1), 0.0)


def test_thrusters_that_two_demands_want_open_and_shut_stay_shut() -> None:
    # one pair of thrusters pushes along +x and turns about +-z: force and torque want the second differently
    wrenches = unit_wrenches(
        np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]),
        np.array([[1.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0], [-1.0, 0, 0]]),
        np.ones(4),
    )
    sets = np.zeros((6, 2, 24), dtype=np.int64)
    sets[0, 1, :4], sets[0, 0, :4] = [1, 1, 0, 0], [0, 0, 1, 1]
    sets[5, 1, :4], sets[5, 0, :4] = [0, 1, 1, 0], [1, 0, 0, 1]
    command = new(COMMAND)
    command.force, command.torque = [1, 0, 0], [0, 0, 1]
    select(sets, 4, command)
    # thrusters 0 and 2 are pulled both ways and stay shut: no propellant goes into pushing against each other
    np.testing.assert_array_equal(command.on[:4], [0, 1, 0, 0])
    assert (command.on[:4] @ wrenches)[[0, 5]].tolist() == [1.0, 1.0]


def test_unit_wrench_is_force_and_its_moment_about_the_centre_of_mass(rng: np.random.Generator) -> None:
    position, direction, force = rng.standard_normal((4, 3)), rng.standard_normal((4, 3)), np.arange(1.0, 5.0)
    found = unit_wrenches(position, direction, force)
    for row in range(4):
        np.testing.assert_allclose(found[row, :3], force[row] * direction[row])
        np.testing.assert_allclose(found[row, 3:], np.cross(position[row], force[row] * direction[row]))


@pytest.mark.parametrize(
    ("missing", "text"), [(0, "-Fx"), (2, "-Fy"), (5, r"\+Fz"), (6, "-Tx"), (9, r"\+Ty"), (11, r"\+Tz")]
)
def test_layout_without_authority_over_an_axis_is_refused_by_name(missing: int, text: str) -> None:
    # twelve ideal actuators, one a demand; one is taken away
    wrenches = np.zeros((12, 6))
    for axis in range(6):
        wrenches[2 * axis, axis], wrenches[2 * axis + 1, axis] = -1.0, 1.0
    wrenches[6:, 0] = 1e-3  # every thruster has a force; these stand on long arms
    with pytest.raises(ValueError, match=f"no thrusters for the {text} demand"):
        thruster_sets(np.delete(wrenches, missing, axis=0))


def test_strong_sets_push_at_least_as_hard_and_no_less_cleanly(scheme_1: Scenario) -> None:
    sets, strength = gnc_params.allocation(scheme_1.chaser)
    thrusters = scheme_1.chaser.thrusters
    n = len(thrusters.position_m)
    wrenches = unit_wrenches(
        np.array(thrusters.position_m), np.array(thrusters.direction), np.full(n, thrusters.force_n)
    )
    assert strength[6] == 2.0 * strength[0] == 20.0  # all four thrusters along x
    assert (strength[6:] >= strength[:3]).all()
    for axis in range(3):
        for sign in (0, 1):
            usual, strong = (sets[row, sign, :n] @ wrenches for row in (axis, 6 + axis))
            assert np.linalg.norm(strong[3:]) <= np.linalg.norm(usual[3:]) + 1e-9


def test_boost_opens_the_strong_set(scheme_1: Scenario) -> None:
    sets, _ = gnc_params.allocation(scheme_1.chaser)
    command = new(COMMAND)
    command.force = [1, 0, 0]
    select(sets, 16, command)
    assert command.on.sum() == 2
    command.boost = 1
    select(sets, 16, command)
    assert command.on.sum() == 4
