"""Security: corridor and closing rate on the truth, the abort, and the drift if nothing fired any more."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.dynamics.hill import transition
from hil.gnc.approach_monitor import margins
from hil.gnc_backends.approach_events import ABORT_CAUSES
from hil.params import gnc as gnc_params

_DRIFT_SAMPLES = 720  # over one orbit


def drift(r_CT_H: Array, v_CT_H: Array, orbit_rate: float, t_s: Array) -> Array:
    """Return the uncontrolled positions in H, (n, 3), m, at ``t_s`` (n,) after the state given (Hill's equations)."""
    state = np.concatenate([r_CT_H, v_CT_H])
    return np.array([transition(orbit_rate, float(t))[:3] @ state for t in t_s]).reshape(-1, 3)


def drift_over_an_orbit(row: np.void, orbit_rate: float) -> dict[str, Any]:
    """Return where the chaser of ``row`` (CYCLE) would go in one orbit without any thrust."""
    period_s = 2.0 * math.pi / orbit_rate
    t_s = np.linspace(0.0, period_s, _DRIFT_SAMPLES + 1)
    way = drift(row["truth"]["r_CT_H"], row["truth"]["v_CT_H"], orbit_rate, t_s)
    distance = np.linalg.norm(way, axis=1)
    nearest = int(np.argmin(distance))
    return {
        "from_s": float(row["t_s"]),
        "orbit_s": period_s,
        "nearest_m": float(distance[nearest]),
        "nearest_after_s": float(t_s[nearest]),
        "farthest_m": float(distance.max()),
        "after_one_orbit_m": [float(value) for value in way[-1]],
    }


def judge_security(history: np.ndarray, scenario: Scenario, orbit_rate: float) -> dict[str, Any]:
    """Return ``passed``, the least margins on the truth up to an abort, and what the abort did."""
    aborted = np.flatnonzero(history["supervision"]["aborted"])
    approach = history[: aborted[0] + 1] if len(aborted) else history
    if not len(approach):
        return {"passed": False, "abort": None}
    corridor, closing = np.empty(len(approach)), np.empty(len(approach))
    truth, reference = approach["truth"], approach["reference"].copy()
    if len(approach) > 1:
        reference[-1] = reference[-2] if len(aborted) else reference[-1]  # the line before the abort
    margins(
        gnc_params.supervision(scenario),
        np.ascontiguousarray(reference["from_H"]),
        np.ascontiguousarray(reference["to_H"]),
        np.ascontiguousarray(truth["r_CT_H"]),
        np.ascontiguousarray(truth["v_CT_H"]),
        corridor,
        closing,
    )
    tightest, fastest = int(np.argmin(corridor)), int(np.argmin(closing))
    return {
        "passed": bool(corridor[tightest] >= 0.0 and closing[fastest] >= 0.0),
        "corridor_margin_m": float(corridor[tightest]),
        "corridor_margin_at_s": float(approach["t_s"][tightest]),
        "closing_margin_mps": float(closing[fastest]),
        "closing_margin_at_s": float(approach["t_s"][fastest]),
        "nearest_m": float(np.linalg.norm(history["truth"]["r_CT_H"], axis=1).min()),
        "abort": _abort(history[aborted[0] :], scenario, orbit_rate) if len(aborted) else None,
    }


def _abort(after: np.ndarray, scenario: Scenario, orbit_rate: float) -> dict[str, Any]:
    """Return what the abort did; ``after``: the cycles from its trigger on."""
    distance = np.linalg.norm(after["truth"]["r_CT_H"], axis=1)
    hold = len(scenario.gnc.guidance.sequence) + 2
    held = np.flatnonzero(after["reference"]["phase"] == hold)
    return {
        "cause": ABORT_CAUSES[int(after["supervision"]["aborted"][0])],
        "at_s": float(after["t_s"][0]),
        "range_m": float(distance[0]),
        "nearest_m": float(distance.min()),
        "hold_since_s": float(after["t_s"][held[0]]) if len(held) else None,
        "range_at_end_m": float(distance[-1]),
        "drift_from_trigger": drift_over_an_orbit(after[0], orbit_rate),
        "drift_from_end": drift_over_an_orbit(after[-1], orbit_rate),
    }
