"""Comparison of recorded runs: key numbers side by side and, for one scenario, the divergence of their truths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.params.ready import tolerances
from hil.report.results import RunResults
from hil.report.verdict import deviations

LEFT_SIGMAS: Final = 3.0
_LEFT_FOR_S: Final = 1.0  # shorter excursions are noise

_QUANTITIES: Final = (
    ("position_m", "sigma_r_m", "position", "mm", 1e3, 1.0),
    ("velocity_mps", "sigma_v_mps", "velocity", "mm/s", 1e3, 1.0),
    ("attitude_deg", "sigma_attitude_rad", "attitude", "deg", 1.0, 180.0 / np.pi),
)


@dataclass(frozen=True)
class RunDivergence:
    """Divergence of the truths of two runs in one axis.

    largest: size of the difference in ``unit``, at ``at_s``. sigmas: it over the standard deviations of both runs,
    of filter and dead band, None if the filters have none. beyond: fraction of the time above LEFT_SIGMAS. left_s:
    start of the first excursion of a second or more, None for never. of_tolerance: largest over Table III's tolerance.
    """

    name: str
    unit: str
    largest: float
    at_s: float
    sigmas: float | None
    beyond: float | None
    left_s: float | None
    of_tolerance: float


def divergences(a: np.ndarray, b: np.ndarray, scenario: Scenario) -> list[RunDivergence]:
    """Return the divergence of two runs of ``scenario``, histories of CYCLE, over the time that both cover."""
    n = min(len(a), len(b))
    a, b = a[:n], b[:n]
    if not n:
        return []
    of_a, of_b = (deviations(rows, scenario.requirements) for rows in (a, b))
    allowed = tolerances(scenario.requirements)
    valid = (a["navigation"]["valid"] == 1) & (b["navigation"]["valid"] == 1)
    listed = []
    for row, sigma, name, unit, scale, of_sigma in _QUANTITIES:
        apart = np.abs(getattr(of_a, row) - getattr(of_b, row))
        spread = np.hypot(*(_spread(of_sigma * rows["navigation"][sigma], row, scenario) for rows in (a, b)))
        for i, axis in enumerate("xyz"):
            worst = int(np.argmax(apart[:, i]))
            largest, at_s = float(apart[worst, i]), float(a["t_s"][worst])
            listed.append(
                RunDivergence(
                    f"{name} {axis}", unit, scale * largest, at_s, of_tolerance=float(largest / allowed[row][i]),
                    **_in_sigmas(apart[:, i], spread[:, i], valid, a["t_s"], scenario.step_s),
                )
            )  # fmt: skip
    return listed


def _spread(sigma: Array, row: str, scenario: Scenario) -> Array:
    """Return the standard deviation, (n, 3), of the truth of one run about its plan.

    Control acts on the estimate and lets it drift through its dead band: uniformly distributed within it.
    """
    control = scenario.gnc.control
    deadband, caution = {
        "position_m": (control.deadband_m, control.deadband_sigmas),
        "attitude_deg": (control.deadband_deg, control.attitude_deadband_sigmas),
    }.get(row, (0.0, 0.0))
    spread: Array = np.hypot(sigma, (deadband + caution * sigma) / np.sqrt(3.0))
    return spread


def _in_sigmas(apart: Array, spread: Array, valid: np.ndarray, t_s: Array, step_s: float) -> dict[str, float | None]:
    """Return ``sigmas``, ``beyond`` and ``left_s`` of RunDivergence."""
    usable = valid & np.isfinite(spread) & (spread > 0.0)
    if not usable.any():
        return dict.fromkeys(("sigmas", "beyond", "left_s"))
    ratio = np.where(usable, apart / np.where(usable, spread, 1.0), 0.0)
    out = ratio > LEFT_SIGMAS
    left_s = _first_stretch(out, t_s, max(1, round(_LEFT_FOR_S / step_s)))
    return {"sigmas": float(ratio.max()), "beyond": float(out[usable].mean()), "left_s": left_s}


def _first_stretch(out: np.ndarray, t_s: Array, least: int) -> float | None:
    """Return the start of the first ``least`` or more consecutive cycles with ``out``, None for never."""
    edges = np.diff(np.concatenate([[0], out.astype(np.int8), [0]]))
    for begin, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        if end - begin >= least:
            return float(t_s[begin])
    return None


def key_numbers(results: RunResults) -> list[tuple[str, str]]:
    """Return the numbers that are compared across runs: label and text."""
    verdict = f"pass {results.not_required_text()}".rstrip() if results.accepted else "fail"
    return [("verdict", verdict), *results.key_numbers()]


def same_flight(runs: Sequence[dict[str, str]]) -> bool:
    """Return whether all metadata in ``runs`` have the same scenario and step."""
    return len({(run["scenario"], run["step_s"]) for run in runs}) == 1
