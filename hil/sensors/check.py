"""Check of a sensor module: its Jacobian against differences, its noise, and that measurement and innovation agree."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.special import chdtri

from hil.core.messages import Array
from hil.core.sensor_records import (
    MEMORY,
    NORMALS,
    SENSOR_ESTIMATE,
    STATES,
)
from hil.maths import quat
from hil.sensors.module import SensorKind
from hil.sensors.trial import Trial

_STEPS: Final = np.array([1e-5] * 3 + [1e-6] * 3 + [1e-6] * 3)  # m, m/s, rad
_TOLERANCE: Final = 1e-3  # relative to the largest entry of a row
_POSES: Final = 40
_SAMPLES: Final = 400
_TAIL: Final = 1e-6
_RANGES_M: Final = (0.4, 1.0, 3.0, 8.0, 30.0, 90.0)


def problems(kind: SensorKind, values: Array | None = None, seed: int = 0) -> list[str]:
    """Return what is wrong with the kernels of a module, one line each; [] if nothing is.

    values: of the settings; None: the defaults. Raises BadInput if a kernel does not compile.
    """
    nominal = np.array([setting.default for setting in kind.settings]) if values is None else values
    trial, random = Trial(kind, nominal), np.random.default_rng(seed)
    lines: list[str] = []
    seen = 0
    for _ in range(_POSES):
        _place(trial, random)
        trial.truth.normal, trial.truth.memory = 0.0, 0.0
        if not trial.measure():
            continue
        seen += 1
        if text := _unrepeatable(trial):
            return [text]
        lines += _finite(kind, trial) or _jacobian(kind, trial) or _covariance(kind, trial) or _wire(kind, trial)
        if lines:
            return lines
    if seen == 0:
        return [f"measure: has no measurement at any of {_POSES} places from {_RANGES_M[0]:g} to {_RANGES_M[-1]:g} m"]
    return _noise(kind, trial, random)


def _unrepeatable(trial: Trial) -> str:
    """Measure the same truth again; return what differs, "" if nothing does."""
    first, trial.truth.memory = trial.output.copy(), 0.0
    if trial.measure() and np.array_equal(trial.output.sample.value, first.sample.value):
        return ""
    return "measure: gives another value for the same truth: take random numbers from truth.normal, no others"


def _place(trial: Trial, random: np.random.Generator) -> None:
    """Put truth and estimate at the same random place in front of the target."""
    truth = trial.truth
    distance = float(random.choice(_RANGES_M))
    truth.t_s = random.uniform(0.0, 100.0)
    truth.r_CT_H = distance * np.array([1.0, *random.uniform(-0.1, 0.1, 2)])
    truth.v_CT_H = random.normal(0.0, 0.02, 3)
    truth.q_CH = quat.from_rotation_vector(random.normal(0.0, 0.03, 3))
    truth.w_CH_C = random.normal(0.0, 1e-3, 3)
    truth.r_T_I, truth.v_T_I = (1.9e6, 1e5, 2e5), (0.0, 1.6e3, 10.0)
    truth.sun_I, truth.sunlight = (1.0, 0.0, 0.0), 1.0
    truth.dt_s, truth.q_HI = 0.1, quat.from_rotation_vector(random.normal(0.0, 1.0, 3))
    for name in SENSOR_ESTIMATE.names or ():
        trial.estimate[name] = truth[name]


def _finite(kind: SensorKind, trial: Trial) -> list[str]:
    value = trial.innovate()
    if not np.isfinite(value).all():
        return ["innovate: value is not finite"]
    for name in ("h", "h_errors", "noise"):
        if not np.isfinite(trial.innovation[name]).all():
            return [f"innovate: {name} is not finite"]
    return []


def _jacobian(kind: SensorKind, trial: Trial) -> list[str]:
    """Compare ``h`` with central differences of the innovation by the estimate."""
    trial.innovate()
    n = len(kind.components)
    stated = trial.innovation.h[:n].copy()
    measured = np.empty((n, STATES))
    nominal = {name: np.copy(trial.estimate[name]) for name in SENSOR_ESTIMATE.names or ()}
    for j, step in enumerate(_STEPS):
        sides = []
        for sign in (1.0, -1.0):
            _shift(trial.estimate, nominal, j, sign * step)
            sides.append(trial.innovate())
        measured[:, j] = (sides[1] - sides[0]) / (2.0 * step)
    for name, value in nominal.items():
        trial.estimate[name] = value
    names = [f"{part}[{i}]" for part in ("r", "v", "theta") for i in range(3)]
    for i, component in enumerate(kind.components):
        largest = max(np.abs(measured[i]).max(), np.abs(stated[i]).max())
        j = int(np.argmax(np.abs(measured[i] - stated[i])))
        if abs(measured[i, j] - stated[i, j]) > _TOLERANCE * largest:
            at = np.linalg.norm(trial.truth.r_CT_H)
            text = f"innovate: h of {component.name} by {names[j]} is {stated[i, j]:.6g}, by differences"
            return [f"{text} {measured[i, j]:.6g} (at {at:.1f} m)"]
    return []


def _shift(estimate: np.record, nominal: dict[str, Any], state: int, step: float) -> None:
    """Move one error state of the estimate from its nominal value by ``step``."""
    for name, value in nominal.items():
        estimate[name] = value
    if state < 3:
        estimate.r_CT_H[state] += step
    elif state < 6:
        estimate.v_CT_H[state - 3] += step
    else:
        turn = np.zeros(3)
        turn[state - 6] = step
        estimate.q_CH = quat.multiply(quat.from_rotation_vector(turn), nominal["q_CH"])


def _covariance(kind: SensorKind, trial: Trial) -> list[str]:
    trial.innovate()
    n = len(kind.components)
    noise = trial.innovation.noise[:n, :n]
    if np.abs(noise - noise.T).max() > 1e-9 * np.abs(noise).max():
        return ["innovate: noise is not symmetric"]
    for first in range(0, n, 3):
        if np.linalg.eigvalsh(noise[first : first + 3, first : first + 3]).min() <= 0.0:
            where = f"components {first + 1} to {min(first + 3, n)}"
            return [f"innovate: noise of {where} is no covariance: give it there, or out.sample.covariance in measure"]
    if n > 3 and np.abs(noise[:3, 3:]).max() > 0.0:
        return ["innovate: noise of components one to three and of the others must be independent"]
    return []


def _wire(kind: SensorKind, trial: Trial) -> list[str]:
    """Send the measurement as a line: it must mean the same to a fraction of its noise, which no line reports."""
    protocol, n = kind.module.wire, len(kind.components)
    if protocol is None:
        return []
    sent = trial.output.sample.value[:n].copy()
    try:
        received = protocol.decode(protocol.encode(sent.tolist()).rstrip(b"\r\n"))
    except ValueError as error:
        return [f"wire: the line of {sent.tolist()} cannot be read: {error}"]
    trial.output.sample.covariance = 0.0
    trial.innovate()
    sigmas = np.sqrt(np.maximum(np.diag(trial.innovation.noise[:n, :n]), 0.0))
    if not sigmas.all():
        return [
            "innovate: noise is missing: a sensor on a wire gives it if out.noise is zero, for lines do not have it"
        ]
    if received is None or not np.all(np.abs(np.array(received) - sent) <= sigmas):
        return [f"wire: {sent.tolist()} is received as {received}"]
    return []


def _noise(kind: SensorKind, trial: Trial, random: np.random.Generator) -> list[str]:
    """Measure many times with noise: the innovations must be as large as noise and errors that the module states."""
    n = len(kind.components)
    sigmas = {setting.name: setting.default for setting in kind.settings}
    square, count, total = 0.0, 0, np.zeros(n)
    for _ in range(_SAMPLES):
        _place(trial, random)
        trial.truth.normal, trial.truth.memory = random.standard_normal(NORMALS), np.zeros(MEMORY)
        if not trial.measure():
            continue
        value = trial.innovate()
        covariance = trial.innovation.noise[:n, :n].copy()
        for k, error in enumerate(kind.module.errors):
            if error.time_s is not None:  # processes are drawn by measure, constant errors are settings
                h = trial.innovation.h_errors[:n, k]
                covariance += sigmas[error.sigma] ** 2 * np.outer(h, h)
        square += float(value @ np.linalg.solve(covariance, value))
        total += value / np.sqrt(np.diag(covariance))
        count += 1
    low, high = chdtri(count * n, 1.0 - _TAIL) / count, chdtri(count * n, _TAIL) / count
    if not low <= square / count <= high:
        text = f"measure and innovate: mean NIS {square / count:.3g} over {count} measurements"
        return [f"{text}, allowed {low:.3g} to {high:.3g}: noise is not what is stated"]
    worst = int(np.argmax(np.abs(total)))
    if abs(total[worst]) > 5.5 * np.sqrt(count):
        mean = total[worst] / count
        return [f"measure and innovate: {kind.components[worst].name} is off by {mean:.2f} sigma on average"]
    return []
