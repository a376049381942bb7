"""Search for the settings of scheme 3, vision alone: speed and ramps, low-passes and control of the position.

python sims/scheme3_search.py                  the search, then 200 seeds of the shipped and of the found settings
python sims/scheme3_search.py --spread 0.3     from shipped settings that were found so, to refine them
python sims/scheme3_search.py --generations 0  the shipped settings only

Cross-entropy method (Rubinstein, Kroese 2004) in the logarithms of the settings: each generation draws candidates from
a normal distribution, flies all with the same seeds, and moves mean and standard deviations to those of the best. The
seeds differ from generation to generation and are not those of the result.
"""

from __future__ import annotations

import argparse
from typing import Any, Final

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.monte_carlo.case_runner import CaseRunner
from hil.monte_carlo.outcome import row_of

SCHEME: Final = "scheme-3"
LATE: Final = "vmu.latency_s=0.1"
KEYS: Final = (
    "gnc.guidance.approach_speed_mps",
    "gnc.guidance.acceleration_mps2",
    "gnc.guidance.deceleration_mps2",
    "gnc.vision_only.position_lag_s",
    "gnc.vision_only.velocity_lag_s",
    "gnc.control.deadband_m",
    "gnc.control.lead_s",
    "gnc.control.period_s",
    "gnc.control.correction_rate_mps",
)
NARROWER: Final = {"gnc.guidance.approach_speed_mps": 0.2}
"""Factors of the spread of some keys."""
SEARCH_SEEDS: Final = 100_000
"""The first seed of the search."""
BEST_FRACTION: Final = 0.2


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
    """Return the score of a candidate: runs that pass Table III count 1, less a tenth of the propellant in kg.

    One that reaches the ready phase and leaves its tolerances later counts 0.4 at most, by how far it leaves them.
    """
    total = 0.0
    for row in rows:
        margin = row["control_margin"]
        total += 1.0 if row["passed"] else 0.4 * float(np.clip(1.0 + margin, 0.0, 1.0)) if margin is not None else 0.0
        total -= 0.1 * (row["propellant_kg"] or 0.0)
    return total / len(rows)


def search(generations: int, candidates: int, seeds: int, spread: float) -> np.ndarray:
    """Return the values that the search ends with; spread: standard deviation of the first generation's logarithms."""
    flights, generator = Flights(), np.random.default_rng(0)
    mean, sigma = np.log(shipped_values()), spread * np.array([NARROWER.get(key, 1.0) for key in KEYS])
    kept = max(2, round(BEST_FRACTION * candidates))
    for number in range(generations):
        trials = mean + sigma * generator.standard_normal((candidates, len(KEYS)))
        first = SEARCH_SEEDS + number * seeds
        scores = np.array([score(flights.rows(settings_of(np.exp(trial)), first, seeds)) for trial in trials])
        best = trials[np.argsort(scores)[::-1][:kept]]
        mean, sigma = best.mean(axis=0), 0.5 * (sigma + best.std(axis=0, ddof=1))
        print(
            f"generation {number + 1}: best {scores.max():.3f}, mean {scores.mean():.3f}, "
            f"spread {sigma.mean():.2f}",
            flush=True,
        )  # fmt: skip
    return np.exp(mean)


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
    parser.add_argument("--generations", type=int, default=12)
    parser.add_argument("--candidates", type=int, default=40, help="per generation")
    parser.add_argument("--search-seeds", type=int, default=6, help="of each candidate")
    parser.add_argument("--spread", type=float, default=0.5, help="of the first generation, in natural logarithms")
    parser.add_argument("--seeds", type=int, default=200, help="of the result, from 0 on")
    given = parser.parse_args()
    flights = Flights()
    report("shipped settings", flights.rows((), 0, given.seeds))
    if given.generations:
        found = settings_of(search(given.generations, given.candidates, given.search_seeds, given.spread))
        print("\n".join(f"  {text}" for text in found))
        report("found settings", flights.rows(found, 0, given.seeds))


if __name__ == "__main__":
    main()
