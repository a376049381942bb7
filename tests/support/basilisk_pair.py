"""Target and chaser in Basilisk (https://avslab.github.io/basilisk) for tests and benchmarks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from Basilisk.architecture import bskLogging, messaging, sysModel
from Basilisk.simulation import gravityEffector, spacecraft, svIntegrators
from Basilisk.utilities import SimulationBaseClass, macros

from hil.config.scenario import Scenario
from hil.dynamics.gravity_file import GravityField
from hil.params import dynamics as dynamics_params

MASS_KG = 1000.0
bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)  # a Moon that does not turn is meant so


def write_field(scenario: Scenario, path: Path) -> Path:
    """Write our coefficients as the file that Basilisk's loader wants."""
    path.write_text(field_text(dynamics_params.gravity(scenario)), encoding="ascii")
    return path


def field_text(field: GravityField) -> str:
    """Return ``field`` as Basilisk's loader wants it: SI, degree 0 included."""
    lines = [f"{field.radius!r}, {field.gm!r}, 0, {field.degree}, {field.degree}, 1, 0, 0"]
    lines += [
        f"{n}, {m}, {1.0 if n == 0 else float(field.c[n, m])!r}, {float(field.s[n, m])!r}, 0, 0"
        for n in range(field.degree + 1)
        for m in range(n + 1)
    ]
    return "\n".join(lines) + "\n"


def _degree(field_file: Path) -> int:
    return int(field_file.read_text(encoding="ascii").split(",")[3])


def gravity_model(field_file: Path) -> Any:
    """Return Basilisk's field, ready for ``computeField``; keep the body it belongs to."""
    body = gravityEffector.GravBodyData()
    body.useSphericalHarmonicsGravityModel(str(field_file), _degree(field_file))
    body.gravityModel.initializeParameters()
    return body


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
    """Target and chaser in Basilisk about the Moon or a body that does not turn, classical Runge-Kutta.

    params: DSS_PARAMS. states: position, m, and velocity, m/s, of both, inertial. turning: whether the Moon turns;
    its attitude then comes from Python, which costs time.
    """

    def __init__(
        self,
        params: np.record,
        states: list[tuple[Any, Any]],
        field_file: Path,
        step_s: float,
        turning: bool = True,
    ) -> None:
        self._sim = SimulationBaseClass.SimBaseClass()
        self._sim.CreateNewProcess("process").addTask(self._sim.CreateNewTask("task", macros.sec2nano(step_s)))
        self._kept: list[Any] = []
        self._gm, self._radius = float(params.gravity.gm), float(params.gravity.radius)
        self._moon: TurningMoon | None = None
        if turning:
            self._moon = TurningMoon(float(params.gravity.rotation), float(params.gravity.rate))
            self._sim.AddModelToTask("task", self._moon, 10)
        self._craft = [self._add(f"craft{i}", *state, field_file) for i, state in enumerate(states)]
        self._sim.InitializeSimulation()

    def _add(self, name: str, r: Any, v: Any, field_file: Path) -> Any:
        craft = spacecraft.Spacecraft()
        craft.ModelTag = name
        craft.hub.mHub = MASS_KG
        craft.hub.IHubPntBc_B = [[900.0, 0.0, 0.0], [0.0, 1100.0, 0.0], [0.0, 0.0, 1050.0]]
        craft.hub.r_CN_NInit = [[float(x)] for x in r]
        craft.hub.v_CN_NInit = [[float(x)] for x in v]
        body = gravityEffector.GravBodyData()
        body.planetName = "moon"
        body.isCentralBody = True
        body.useSphericalHarmonicsGravityModel(str(field_file), _degree(field_file))
        body.mu, body.radEquator = self._gm, self._radius
        if self._moon is not None:
            body.planetBodyInMsg.subscribeTo(self._moon.message)
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
