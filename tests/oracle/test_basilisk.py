"""The truth against Basilisk, an independent simulator: pip install -c constraints-oracle.txt '.[oracle]'."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

basilisk = pytest.importorskip("Basilisk", reason="Basilisk (bsk) is not installed: it belongs to the extra 'oracle'")

from Basilisk.architecture import messaging, sysModel  # noqa: E402
from Basilisk.simulation import gravityEffector, spacecraft, svIntegrators  # noqa: E402
from Basilisk.utilities import SimulationBaseClass, macros  # noqa: E402

from hil import dss_parameters, parameters  # noqa: E402
from hil.config.load import load_scenario  # noqa: E402
from hil.config.scenario import Scenario  # noqa: E402
from hil.dynamics import moon_gravity  # noqa: E402
from hil.dynamics import truth as kernels  # noqa: E402
from hil.maths import quat  # noqa: E402
from hil.messages import MAX_THRUSTERS  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")  # Basilisk's own
QUIET = np.zeros(MAX_THRUSTERS, dtype=np.int64)
MASS_KG = 1000.0


@pytest.fixture(scope="module")
def drift() -> Scenario:
    """Return scheme-2 with gravity alone, on an inclined, mildly eccentric orbit."""
    return load_scenario(
        "scheme-2",
        (
            "truth.solar_pressure=false",
            "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]",
            "orbit.eccentricity=0.03",
            "orbit.moon_rotation_deg=70.0",
            "initial.velocity_mps=[0.004, -0.006, 0.003]",
        ),
    ).value


@pytest.fixture(scope="module")
def field_file(drift: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return our coefficients in the file that Basilisk's loader wants: SI, degree 0 included."""
    field = dss_parameters.gravity(drift)
    path = tmp_path_factory.mktemp("field") / "moon.txt"
    lines = [f"{field.radius!r}, {field.gm!r}, 0, {field.degree}, {field.degree}, 1, 0, 0"]
    for n in range(field.degree + 1):
        for m in range(n + 1):
            lines.append(f"{n}, {m}, {1.0 if n == 0 else float(field.c[n, m])!r}, {float(field.s[n, m])!r}, 0, 0")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


class TurningMoon(sysModel.SysModel):
    """Publishes the Moon's attitude at each step of Basilisk's clock."""

    def __init__(self, rotation: float, rate: float) -> None:
        super().__init__()
        self.ModelTag = "moon"
        self._rotation, self._rate = rotation, rate
        self.message = messaging.SpicePlanetStateMsg()

    def Reset(self, nanos: int) -> None:
        self.UpdateState(nanos)

    def UpdateState(self, nanos: int) -> None:
        angle = self._rotation + self._rate * nanos * 1e-9
        c, s = math.cos(angle), math.sin(angle)
        state = messaging.SpicePlanetStateMsgPayload()
        state.J2000Current = nanos * 1e-9
        state.J20002Pfix = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]
        state.J20002Pfix_dot = [
            [-self._rate * s, self._rate * c, 0.0],
            [-self._rate * c, -self._rate * s, 0.0],
            [0.0] * 3,
        ]
        state.computeOrient = 1
        state.PlanetName = "moon"
        self.message.write(state, nanos, self.moduleID)


class Pair:
    """Target and chaser in Basilisk about a turning Moon, classical Runge-Kutta."""

    def __init__(self, params: np.record, states: list[tuple[Any, Any]], field_file: Path, step_s: float) -> None:
        self._sim = SimulationBaseClass.SimBaseClass()
        self._sim.CreateNewProcess("process").addTask(self._sim.CreateNewTask("task", macros.sec2nano(step_s)))
        self._kept: list[Any] = []
        self._gm, self._radius = float(params.gravity.gm), float(params.gravity.radius)
        moon = TurningMoon(float(params.gravity.rotation), float(params.gravity.rate))
        self._sim.AddModelToTask("task", moon, 10)
        self._kept.append(moon)
        self._craft = [self._add(f"craft{i}", *state, moon, field_file) for i, state in enumerate(states)]
        self._sim.InitializeSimulation()

    def _add(self, name: str, r: Any, v: Any, moon: TurningMoon, field_file: Path) -> Any:
        craft = spacecraft.Spacecraft()
        craft.ModelTag = name
        craft.hub.mHub = MASS_KG
        craft.hub.IHubPntBc_B = [[900.0, 0.0, 0.0], [0.0, 1100.0, 0.0], [0.0, 0.0, 1050.0]]
        craft.hub.r_CN_NInit = [[float(x)] for x in r]
        craft.hub.v_CN_NInit = [[float(x)] for x in v]
        body = gravityEffector.GravBodyData()
        body.planetName = "moon"
        body.isCentralBody = True
        body.useSphericalHarmonicsGravityModel(str(field_file), 8)
        body.mu, body.radEquator = self._gm, self._radius
        body.planetBodyInMsg.subscribeTo(moon.message)
        craft.gravField.gravBodies = spacecraft.GravBodyVector([body])
        integrator = svIntegrators.svIntegratorRK4(craft)
        craft.setIntegrator(integrator)
        self._sim.AddModelToTask("task", craft, 1)
        self._kept += [body, integrator]
        return craft

    def run_to(self, t_s: float) -> np.ndarray:
        """Return the chaser's position relative to the target, inertial, (3,), m, at ``t_s``."""
        self._sim.ConfigureStopTime(macros.sec2nano(t_s))
        self._sim.ExecuteSimulation()
        target, chaser = (np.array(c.scStateOutMsg.read().r_CN_N) for c in self._craft)
        return np.asarray(chaser - target)


def inertial_states(truth: np.record) -> list[tuple[Any, Any]]:
    """Return position and velocity of target and chaser, inertial."""
    a = quat.to_matrix(truth.q_HI)
    r = a.T @ truth.r_CT_H
    v = a.T @ (truth.v_CT_H + np.cross(truth.w_HI_H, truth.r_CT_H))
    return [(truth.r_T_I, truth.v_T_I), (truth.r_T_I + r, truth.v_T_I + v)]


def test_gravity_agrees_to_rounding(drift: Scenario, field_file: Path, rng: np.random.Generator) -> None:
    params, field = parameters.dss(drift), parameters.field(drift)
    body = gravityEffector.GravBodyData()
    body.useSphericalHarmonicsGravityModel(str(field_file), 8)
    body.gravityModel.initializeParameters()
    params.gravity.rotation = params.gravity.rate = 0.0
    ours = np.empty(3)
    for _ in range(200):
        r = rng.standard_normal(3)
        r *= rng.uniform(1.75e6, 2.5e6) / np.linalg.norm(r)
        moon_gravity.acceleration(params.gravity, field, 0.0, r, ours)
        theirs = np.array(body.gravityModel.computeField([[x] for x in r.tolist()], 8, True)).ravel()
        assert np.linalg.norm(ours - theirs) <= 1e-12 * np.linalg.norm(ours)


@pytest.mark.parametrize(("span_s", "tolerance_m"), [(400.0, 1e-6), (7655.0, 1e-3)], ids=["400 s", "an orbit"])
def test_relative_position_agrees(drift: Scenario, field_file: Path, span_s: float, tolerance_m: float) -> None:
    params, field, truth = parameters.dss(drift), parameters.field(drift), parameters.initial_truth(drift)
    assert 2.0 * math.pi / params.orbit_rate == pytest.approx(7655.0, abs=60.0)
    theirs = Pair(params, inertial_states(truth), field_file, step_s=0.5).run_to(span_s)
    for _ in range(round(span_s / params.dt_s)):
        kernels.step(params, field, truth, QUIET)
    ours = quat.to_matrix(truth.q_HI).T @ truth.r_CT_H
    print(span_s, ours, theirs, np.linalg.norm(ours - theirs))
    assert np.linalg.norm(ours) > 1.0
    assert np.linalg.norm(ours - theirs) <= tolerance_m
