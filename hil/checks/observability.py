"""Observability of the navigation's states by the sensors of a bench without a vision unit.

The sensors' measurements are fused along the way from the start to the ready point, every ``_PERIOD_S`` over
``_TIME_S``, with their own sensitivities and noise, and without the orbit's weak couplings. A state of which they leave
more than ``_KNOWN`` of what is not known at first is not observed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.core.sensor_records import SENSOR_ESTIMATE
from hil.errors import Problem
from hil.maths import euler
from hil.params.sensors import sensors_of, settings_row

if TYPE_CHECKING:
    from hil.sensors.trial import Trial

_TIME_S: Final = 100.0
_PERIOD_S: Final = 1.0
_KNOWN: Final = 0.1
_STATES: Final = (
    *((f"position {axis}", 10.0, 1e3, "mm") for axis in "xyz"),
    *((f"velocity {axis}", 1.0, 1e3, "mm/s") for axis in "xyz"),
    *((f"attitude {axis}", 1.0, math.degrees(1.0), "deg") for axis in "xyz"),
    *((f"gyro drift {axis}", 1e-3, math.degrees(1.0), "deg/s") for axis in "xyz"),
)
"""Name, what is not known at first (m, m/s, rad, rad/s), and the unit of texts."""
_MEASURED: Final = 9
"""States to which sensors are sensitive."""


class StateSigma(NamedTuple):
    """What is known of a state. sigma: in its unit. sensors: those sensitive to it."""

    name: str
    sigma: float
    unit: str
    sensors: tuple[str, ...]
    is_observed: bool


def state_sigmas(scenario: Scenario) -> list[StateSigma]:
    """Return what the fused sensors of ``scenario``, without a vision unit, make known of each state."""
    from hil.sensors.trial import Trial  # of few runs

    sensors = [(n, s) for n, s in sensors_of(scenario).items() if s.config.use == "fusion" and s.config.enabled]
    trials = {name: Trial(sensor.kind, settings_row(sensor.kind, sensor.config)) for name, sensor in sensors}
    rates_hz = {name: sensor.config.rate_hz or sensor.kind.module.rate_hz for name, sensor in sensors}
    known = np.diag([1.0 / first**2 for _, first, _, _ in _STATES])
    seen: dict[str, Array] = {name: np.zeros(_MEASURED) for name in trials}
    start, end = np.array(scenario.initial.position_m), np.array(scenario.gnc.guidance.ready_point_m)
    first_deg = np.array(scenario.initial.attitude_deg)
    step = _transition(_PERIOD_S)
    back = np.linalg.inv(step)
    for fraction in np.linspace(0.0, 1.0, round(_TIME_S / _PERIOD_S)):
        known = back.T @ known @ back
        angles = np.radians((1.0 - fraction) * first_deg)
        r, q = start + fraction * (end - start), euler.to_quaternion(angles, euler.YAW_PITCH_ROLL)
        for name, trial in trials.items():
            h, noise = _sensitivity(trial, r, q)
            if h is None:
                continue
            seen[name] = np.maximum(seen[name], np.abs(h).max(axis=0))
            whole = np.hstack([h, np.zeros((len(h), len(_STATES) - _MEASURED))])
            known += rates_hz[name] * _PERIOD_S * whole.T @ np.linalg.solve(noise, whole)
    sigmas = np.sqrt(np.diag(np.linalg.inv(known)))
    states = []
    for k, ((state, first, scale, unit), sigma) in enumerate(zip(_STATES, sigmas, strict=True)):
        direct = k if k < 3 or k in (6, 7, 8) else k - 3  # velocity by position, drift by attitude
        names = tuple(name for name, largest in seen.items() if largest[direct] > 0.0)
        states.append(StateSigma(state, float(sigma) * scale, unit, names, bool(sigma < _KNOWN * first)))
    return states


def _transition(dt_s: float) -> Array:
    step = np.eye(len(_STATES))
    step[0:3, 3:6] = dt_s * np.eye(3)
    step[6:9, 9:12] = -dt_s * np.eye(3)
    return step


def _sensitivity(trial: Trial, r: Array, q: Array) -> tuple[Array | None, Array]:
    """Return sensitivity (n, 9) and noise (n, n) of a measurement of a chaser at ``r`` with ``q``; None without one."""
    truth = trial.truth
    truth.r_CT_H, truth.q_CH, truth.q_HI, truth.normal = r, q, (0.0, 0.0, 0.0, 1.0), 0.0
    truth.r_T_I, truth.v_T_I, truth.sun_I = (7e6, 0.0, 0.0), (0.0, 7.5e3, 0.0), (1.0, 0.0, 0.0)
    truth.sunlight, truth.dt_s = 1.0, _PERIOD_S
    for name in SENSOR_ESTIMATE.names or ():
        trial.estimate[name] = truth[name]
    if not trial.measure():
        return None, np.zeros((0, 0))
    n = len(trial.innovate())
    return trial.innovation.h[:n].copy(), trial.innovation.noise[:n, :n].copy()


def observed_by(scenario: Scenario, rig: Rig) -> list[str]:
    """Return a line per state with its standard deviation and sensors, for a bench without a vision unit."""
    if rig.has_vmu:
        return []
    return [
        f"no vision unit: {state.name} known to {state.sigma:.2g} {state.unit} after {_TIME_S:g} s, "
        f"by {', '.join(state.sensors)}"
        for state in state_sigmas(scenario)
    ]


def check_observability(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each state that is not observed on a bench without a vision unit."""
    if rig.value.has_vmu:
        return []
    if scenario.value.vmu.source != "model":
        text = f'"{scenario.value.vmu.source}": rig "{rig.value.name}" has no vision unit, vmu.driver = "none"'
        return [scenario.problem("vmu.source", text)]
    if scenario.value.gnc.navigation.handover is None and scenario.value.gnc.binary is None:
        text = f'is missing: rig "{rig.value.name}" has no vision unit, whose first pose would start the filters'
        return [scenario.problem("gnc.navigation.handover", text)]
    unseen = [state for state in state_sigmas(scenario.value) if not state.is_observed]
    if not unseen:
        return []
    names = ", ".join(state.name for state in unseen)
    fused = [name for name, config in scenario.value.sensors.items() if config.use == "fusion" and config.enabled]
    text = f'"none": {names} not observed by the fused sensors ({", ".join(fused) or "none"}): add [[sensors]]'
    return [Problem(rig.where("vmu.driver"), "rig.vmu.driver", text)]
