"""Several bending modes of the solar array, coupled to rotation and translation of the hub."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import MAX_MODES, MAX_THRUSTERS, new
from hil.dynamics import truth as kernels
from hil.dynamics.mass_properties import MASS_PROPERTIES, set_mass_properties
from hil.dynamics.truth import TRUTH_MEMORY
from hil.errors import BadInput
from hil.maths import quat
from hil.params import dynamics as dynamics_params
from hil.session.build import Job, check
from tests.conftest import PLAIN

NO_FIELD = np.zeros((1, 1, 6))
QUIET = np.zeros(MAX_THRUSTERS, dtype=np.int64)
LONG = (
    "truth.flexible_array=true",
    "truth.mass_loss=false",
    "chaser.solar_array.mode_translation_coupling=[0.0, 1.0, 6.0]",
    "chaser.solar_array.further_modes.second.frequency_hz=0.6",
    "chaser.solar_array.further_modes.second.damping=0.005",
    "chaser.solar_array.further_modes.second.coupling=[0.0, 5.0, -1.0]",
    "chaser.solar_array.further_modes.second.translation_coupling=[3.0, -2.0, 0.5]",
    "chaser.solar_array.further_modes.third.frequency_hz=1.4",
    "chaser.solar_array.further_modes.third.damping=0.01",
    "chaser.solar_array.further_modes.third.coupling=[2.0, 0.0, 4.0]",
)
"""Three modes, two of them coupled to the translation."""
DT = 0.02


def flexible(*settings: str) -> Scenario:
    """Return scheme-1 with the array and no other disturbance."""
    return load_scenario("scheme-1", (*PLAIN, *LONG, *settings)).value


class FreeHub:
    """A hub in free space with a bent array, in axes H that do not rotate. damping: of all modes."""

    def __init__(self, damping: float, scenario: Scenario | None = None) -> None:
        scenario = scenario or flexible()
        self.params, self.truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
        self.params.orbit_rate, self.params.modes.damping = 0.0, damping
        self.memory = new(TRUTH_MEMORY)
        self.n = int(self.params.modes.n)
        self.truth.w_HI_H, self.truth.w_CI_C = 0.0, [0.03, -0.04, 0.05]
        self.truth.v_CT_H = [0.02, -0.01, 0.03]
        self.truth.eta, self.truth.eta_rate = 0.2, -0.1
        self.memory.bending.eta[1:3], self.memory.bending.eta_rate[1:3] = [0.05, -0.02], [0.2, 0.1]

    def fly(self, steps: int, *thrusters: int) -> None:
        on = QUIET.copy()
        on[list(thrusters)] = 1
        for _ in range(steps):
            kernels.step(self.params, NO_FIELD, self.memory, self.truth, on)

    @property
    def rates(self) -> np.ndarray:
        """Return the rates of all modes, (n,)."""
        return np.array([self.truth.eta_rate, *self.memory.bending.eta_rate[1 : self.n]])

    @property
    def momentum(self) -> np.ndarray:
        """Return momentum and angular momentum about the mass centre of the vehicle undeformed, inertial, (6,)."""
        to_H = quat.to_matrix(self.truth.q_CH).T
        modes = self.params.modes
        linear = self.truth.mass_kg * self.truth.v_CT_H + to_H @ (self.rates @ modes.translation[: self.n])
        angular = self.params.inertia @ self.truth.w_CI_C + self.rates @ modes.coupling[: self.n]
        return np.concatenate([linear, to_H @ angular])

    @property
    def energy(self) -> float:
        modes, w = self.params.modes, self.truth.w_CI_C
        v = quat.to_matrix(self.truth.q_CH) @ self.truth.v_CT_H
        eta = np.array([self.truth.eta, *self.memory.bending.eta[1 : self.n]])
        hub = 0.5 * self.truth.mass_kg * v @ v + 0.5 * w @ self.params.inertia @ w
        across = self.rates @ (modes.coupling[: self.n] @ w + modes.translation[: self.n] @ v)
        return float(
            hub + across + 0.5 * self.rates @ self.rates + 0.5 * ((modes.frequency[: self.n] * eta) ** 2).sum()
        )


def test_free_hub_with_three_modes_keeps_momentum_and_energy() -> None:
    hub = FreeHub(0.0)
    momentum, energy, v = hub.momentum, hub.energy, hub.truth.v_CT_H.copy()
    moved = 0.0
    for _ in range(40):
        hub.fly(50)
        moved = max(moved, np.abs(hub.truth.v_CT_H - v).max())
    assert moved > 1e-3
    np.testing.assert_allclose(hub.momentum, momentum, atol=1e-5)
    assert hub.energy == pytest.approx(energy, rel=1e-5)


def test_damping_takes_energy_and_no_momentum() -> None:
    hub = FreeHub(0.03)
    momentum, energies = hub.momentum, [hub.energy]
    for _ in range(20):
        hub.fly(100)
        energies.append(hub.energy)
    np.testing.assert_allclose(hub.momentum, momentum, atol=1e-5)
    assert (np.diff(energies) < 0.0).all()


def test_impulse_of_a_burn_is_shared_with_the_array() -> None:
    hub = FreeHub(0.0)
    before = hub.momentum
    thrust_H = np.zeros(3)
    for _ in range(50):
        push = hub.params.thruster_direction[[0, 4]] * hub.params.thruster_force[[0, 4], None]
        middle = quat.to_matrix(hub.truth.q_CH).T @ push.sum(axis=0)
        hub.fly(1, 0, 4)
        thrust_H += 0.5 * DT * (middle + quat.to_matrix(hub.truth.q_CH).T @ push.sum(axis=0))
    np.testing.assert_allclose((hub.momentum - before)[:3], thrust_H, atol=1e-5)
    rigid = thrust_H / hub.truth.mass_kg
    assert np.abs(hub.truth.v_CT_H - np.array([0.02, -0.01, 0.03]) - rigid).max() > 1e-3


def test_accelerometer_measures_the_hub_and_not_the_mean_of_the_vehicle() -> None:
    hub = FreeHub(0.0)
    hub.truth.w_CI_C = 0.0
    before = hub.truth.v_CT_H.copy()
    hub.fly(1, 0, 4)
    gained = quat.to_matrix(hub.truth.q_CH) @ (hub.truth.v_CT_H - before) / DT
    np.testing.assert_allclose(hub.truth.mean_force_C, gained, atol=1e-5)
    assert np.abs(hub.truth.mean_force_C - [0.01, 0.0, 0.0]).max() > 1e-3


def test_mass_properties_invert_the_coupled_mass_matrix() -> None:
    params, found = dynamics_params.dss(flexible("chaser.propellant_gyration_m=[0.3, 0.4, 0.5]")), new(MASS_PROPERTIES)
    set_mass_properties(params, 900.0, found)
    both = np.hstack([params.modes.translation, params.modes.coupling])
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = 900.0 * np.eye(3), params.inertia - 100.0 * np.diag([0.09, 0.16, 0.25])
    inverse = np.linalg.inv(whole - both.T @ both)
    np.testing.assert_allclose(found.inertia, whole[3:, 3:], rtol=1e-14)
    np.testing.assert_allclose(found.inertia_inverse, inverse[3:, 3:], rtol=1e-10, atol=1e-16)
    np.testing.assert_allclose(found.inertia_inverse @ found.lever, inverse[3:, :3], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(
        found.mass_inverse + found.lever.T @ found.inertia_inverse @ found.lever,
        inverse[:3, :3],
        rtol=1e-10,
        atol=1e-15,
    )


def test_uncoupled_translation_leaves_the_thrust_and_each_mode_its_own_swing() -> None:
    alone = FreeHub(0.0, flexible("chaser.solar_array.mode_coupling=[0.0, 0.0, 0.0]"))
    alone.params.modes.coupling = alone.params.modes.translation = 0.0
    alone.params.modes.moves = alone.params.mass.varies = 0
    alone.params.modes.inertia_inverse = alone.params.inertia_inverse
    alone.fly(100)
    t = 100 * DT
    for k, (eta, rate) in enumerate(((0.2, -0.1), (0.05, 0.2), (-0.02, 0.1))):
        omega = float(alone.params.modes.frequency[k])
        expected = -eta * omega * math.sin(omega * t) + rate * math.cos(omega * t)
        assert alone.rates[k] == pytest.approx(expected, abs=2e-4)


def test_translation_excites_its_mode_at_the_coupled_frequency() -> None:
    hub = FreeHub(0.0, flexible("chaser.solar_array.mode_coupling=[0.0, 0.0, 0.0]"))
    modes = hub.params.modes
    modes.n, modes.coupling = 1, 0.0
    hub.truth.w_CI_C, hub.truth.eta, hub.truth.eta_rate = 0.0, 0.0, 0.0
    hub.n = 1
    hub.fly(1, 10, 14)
    swing = []
    for _ in range(3000):
        swing.append(float(hub.truth.eta))
        hub.fly(1)
    spectrum = np.abs(np.fft.rfft(swing))
    light = 1.0 - modes.translation[0] @ modes.translation[0] / hub.truth.mass_kg
    coupled = modes.frequency[0] / math.sqrt(light) / (2.0 * math.pi)
    assert np.fft.rfftfreq(3000, DT)[spectrum.argmax()] == pytest.approx(coupled, abs=1.0 / 60.0)
    assert max(swing) > 1e-5


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("chaser.solar_array.mode_translation_coupling=[40.0, 0.0, 0.0]",), ("mode_translation_coupling", "heavier")),
        (
            ("chaser.solar_array.further_modes.b={frequency_hz=1.0, damping=0.0, coupling=[40.0, 0.0, 0.0]}",),
            ("chaser.solar_array.mode_coupling", "more inertia"),
        ),
        (("chaser.solar_array.further_modes.b={frequency_hz=1.0}",), ("further_modes.b.damping", "missing")),
        (("chaser.propellant_gyration_m=[9.0, 0.0, 0.0]",), ("chaser.propellant_gyration_m", "14.83 kg")),
        (("chaser.propellant_gyration_m=[-1.0, 0.0, 0.0]",), ("chaser.propellant_gyration_m", "-1")),
        (
            tuple(f"chaser.solar_array.further_modes.m{k}={{frequency_hz=1.0, damping=0.0}}" for k in range(MAX_MODES)),
            ("chaser.solar_array.further_modes", "7"),
        ),
    ],
)
def test_array_or_propellant_of_no_vehicle_is_one_line(settings: tuple[str, ...], words: tuple[str, ...]) -> None:
    def checked() -> None:
        check(Job(load_scenario("scheme-1", settings), load_rig("mock"), 0, 400.0, 1.0))

    with pytest.raises(BadInput) as caught:
        checked()
    (line,) = str(caught.value).splitlines()
    for word in words:
        assert word in line
