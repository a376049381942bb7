"""Search for the settings of scheme 3, vision alone: low-passes, dead bands, lead times and periods.

python sims/scheme3_search.py                  the search, then 200 seeds of the shipped and of the best settings
python sims/scheme3_search.py --seeds 200 --candidates 0    only the shipped settings

Candidates are a Latin hypercube about the shipped settings, and then about the best of each round. Each round runs
all candidates with few seeds and the better half with more, up to all seeds of the search. The score is the fraction of
seeds that pass Table III, less a part of the propellant. Seeds of the search are not those of the result.
"""

from __future__ import annotations

import argparse
import math
from typing import Any, Final

import numpy as np
from scipy.stats import qmc

from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.monte_carlo.case_runner import CaseRunner
from hil.monte_carlo.outcome import row_of

SCHEME: Final = "scheme-3"
LATE: Final = "vmu.latency_s=0.1"
KEYS: Final = (
    "gnc.vision_only.position_lag_s",
    "gnc.vision_only.velocity_lag_s",
    "gnc.vision_only.attitude_lag_s",
    "gnc.vision_only.rate_lag_s",
    "gnc.control.deadband_m",
    "gnc.control.lead_s",
    "gnc.control.period_s",
    "gnc.control.correction_rate_mps",
    "gnc.control.deadband_deg",
    "gnc.control.attitude_lead_s",
    "gnc.control.attitude_period_s",
)
SEARCH_SEEDS: Final = 100_000
"""The first seed of the search."""
STAGES: Final = (4, 12, 40)
"""Seeds of the candidates that are left at each stage; half of them are dropped at its end."""
PROPELLANT_WEIGHT_PER_KG: Final = 0.1


def settings_of(values: np.ndarray) -> tuple[str, ...]:
    """Return the settings of a candidate, to three digits."""
    return tuple(f"{key}={float(f'{value:.3g}')!r}" for key, value in zip(KEYS, values, strict=True))


def shipped_values() -> np.ndarray:
    """Return the values of the shipped scenario."""
    scenario = load_scenario(SCHEME).value.gnc.model_dump()
    return np.array([scenario[key.split(".")[1]][key.split(".")[2]] for key in KEYS])


class Flights:
    """Runs candidates on the mock rig, in one memory."""

    def __init__(self) -> None:
        nominal = load_scenario(SCHEME, (LATE,)).value
        self._runner = CaseRunner(nominal, load_rig("mock").value, nominal.duration_s)

    def rows(self, settings: tuple[str, ...], first: int, seeds: int) -> list[dict[str, Any]]:
        """Return the outcomes of the runs with ``settings`` and ``seeds`` from ``first`` on."""
        scenario: Scenario = load_scenario(SCHEME, (LATE, *settings)).value
        self._runner.set_gnc_scenario(scenario)
        return [row_of(*self._runner.run(scenario, first + k), scenario, scenario) for k in range(seeds)]


def score(rows: list[dict[str, Any]]) -> float:
    """Return the score of a candidate."""
    propellant_kg = float(np.mean([row["propellant_kg"] for row in rows]))
    return float(np.mean([row["passed"] for row in rows])) - PROPELLANT_WEIGHT_PER_KG * propellant_kg


def best_of(flights: Flights, candidates: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Return the best of ``candidates`` and its score, by successive halving."""
    left, found = candidates, [0.0]
    for seeds in STAGES:
        scores = [score(flights.rows(settings_of(values), SEARCH_SEEDS, seeds)) for values in left]
        order = np.argsort(scores)[::-1][: max(1, len(left) // 4)]
        left, found = [left[i] for i in order], [scores[i] for i in order]
    return left[0], found[0]


def search(candidates: int, rounds: int) -> np.ndarray:
    """Return the best values found: each round is a hypercube half as wide, in logarithms, as the one before."""
    flights, centre, width = Flights(), shipped_values(), math.log(4.0)
    for number in range(rounds):
        points = qmc.LatinHypercube(len(KEYS), rng=np.random.default_rng(number)).random(candidates)
        trials = [centre, *(centre * np.exp(width * (2.0 * point - 1.0)) for point in points)]
        centre, found = best_of(flights, trials)
        width *= 0.5
        print(f"round {number + 1}: score {found:.3f}", flush=True)
        print("\n".join(f"  {text}" for text in settings_of(centre)), flush=True)
    return centre


def report(name: str, rows: list[dict[str, Any]]) -> None:
    """Print the numbers of ``rows``."""
    passed = sum(row["passed"] for row in rows)
    parts = sum(row["passed_all_parts"] for row in rows)
    propellant = np.median([row["propellant_kg"] for row in rows])
    firings = np.median([row["firings"] for row in rows])
    print(
        f"{name}: {passed} of {len(rows)} pass Table III, {parts} all parts; "
        f"median propellant {propellant:.3f} kg, {firings:.0f} firings"
    )


def main() -> None:
    """Search, and compare with the shipped settings."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--candidates", type=int, default=96, help="per round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=200, help="of the result, from 0 on")
    given = parser.parse_args()
    flights = Flights()
    report("shipped settings", flights.rows((), 0, given.seeds))
    if given.candidates:
        best = settings_of(search(given.candidates, given.rounds))
        report("best settings", flights.rows(best, 0, given.seeds))


if __name__ == "__main__":
    main()
