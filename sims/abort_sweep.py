"""Abort with any one thruster failed, from every point of the approach.

    python sims/abort_sweep.py [SCHEME] [--isolation none|each|bank] [--step 20] [--across 0.8] [--workers N]

The approach is flown along the axis of its corridor and along four lines near its edge (``--across`` of the radius).
Each thruster in turn sticks open, or closed, every ``--step`` seconds from the start of the run into the ready phase;
at the same moment an abort is ordered, and in a second flight none is, so that the navigation has to find the fault.
The bench guard is off: the GNC is on its own. Isolation by banks needs two of them that can each do everything, which
the shipped layout has not: the sweep then flies two strings of 12 thrusters. Prints by kind of fault the nearest
distance to the target over the rest of the run, the drift after the abort included, and how many flights came nearer
than the keep-out.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from multiprocessing import get_context
from typing import Final

from hil.checks.abort import check_abort
from hil.config.load import Loaded, load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.config.tables.faults import TimedFault
from hil.errors import BadInput
from hil.monte_carlo.case_runner import CaseRunner
from sims.integrity_campaign import WITHOUT_GUARD

KINDS: Final = ("stuck_open", "stuck_closed")
EDGES: Final = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
_INTO_READY_S: Final = 40.0  # of the ready phase
_STRING_ARMS_M: Final = (1.0, 0.4)  # far enough apart for the torque to identify the string; 1.0 and 0.7 are not


@dataclass(frozen=True)
class Flight:
    """One flight. edge: of the line of the approach, in units of ``--across``; ordered: an abort, with the fault."""

    edge: tuple[float, float]
    kind: str
    thruster: int
    at_s: float
    ordered: bool


def _redundant() -> tuple[str, ...]:
    """Return the settings of two strings of thrusters, each with two for each direction of each axis."""
    positions, directions = [], []
    for arm_m, axis, side, sign in product(_STRING_ARMS_M, range(3), (1.0, -1.0), (1.0, -1.0)):
        positions.append([side * arm_m if k == (axis + 1) % 3 else 0.0 for k in range(3)])
        directions.append([sign if k == axis else 0.0 for k in range(3)])
    banks = [1 + k * len(_STRING_ARMS_M) // len(positions) for k in range(len(positions))]
    layout = {"position_m": positions, "direction": directions, "bank": banks}
    return tuple(f"chaser.thrusters.{key}={values}" for key, values in layout.items())


def _scenario(scheme: str, isolation: str, *settings: str) -> Loaded[Scenario]:
    layout = _redundant() if isolation == "bank" else ()
    return load_scenario(scheme, (f"chaser.thrusters.isolation={isolation}", *layout, *settings))


@lru_cache(maxsize=1)
def _runner(scheme: str, isolation: str, across: float, edge: tuple[float, float]) -> CaseRunner:
    plain = _scenario(scheme, isolation).value
    x_m = plain.initial.position_m[0]
    radius_m = across * x_m * math.tan(math.radians(plain.gnc.corridor.half_angle_deg))
    start = f"initial.position_m=[{x_m}, {edge[0] * radius_m}, {edge[1] * radius_m}]"
    scenario = _scenario(scheme, isolation, start).value
    return CaseRunner(scenario, load_rig("mock", WITHOUT_GUARD).value, scenario.duration_s)


def nearest_m(scheme: str, isolation: str, across: float, flight: Flight) -> float:
    """Return the nearest distance of the true chaser to the target in ``flight``, m."""
    runner = _runner(scheme, isolation, across, flight.edge)
    fault = TimedFault(device=f"thruster.{flight.thruster}", kind=flight.kind, at_s=flight.at_s)
    truth: Scenario = runner.scenario.model_copy(update={"faults": (fault,)})
    runner.set_abort(flight.at_s if flight.ordered else math.inf)
    stats, stop = runner.run(truth, 0)
    if stop != "completed":
        raise RuntimeError(f"{flight}: {stop}")
    return float(stats.integrity.nearest)


def flights(scheme: str, step_s: float, isolation: str = "none") -> list[Flight]:
    """Return all flights, those of one line one after the other."""
    scenario = _scenario(scheme, isolation).value
    cruise_s = math.hypot(*scenario.initial.position_m) / scenario.gnc.guidance.approach_speed_mps
    onsets = [k * step_s for k in range(1 + int((cruise_s + _INTO_READY_S) // step_s))]
    thrusters = range(1, 1 + len(scenario.chaser.thrusters.position_m))
    return [Flight(*values) for values in product(EDGES, KINDS, thrusters, onsets, (True, False))]


def sweep(
    scheme: str, isolation: str, flown: Sequence[Flight], across: float = 0.8, workers: int = 1
) -> list[tuple[float, Flight]]:
    """Return the nearest distance of each flight."""
    one = partial(nearest_m, scheme, isolation, across)
    if workers == 1:
        return [(one(flight), flight) for flight in flown]
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        return list(zip(pool.map(one, flown, chunksize=50), flown, strict=True))


def main() -> None:
    """Fly the sweep and print its nearest distances."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("scheme", nargs="?", default="scheme-1")
    parser.add_argument("--isolation", choices=("none", "each", "bank"), default="none")
    parser.add_argument("--step", type=float, default=20.0)
    parser.add_argument("--across", type=float, default=0.8)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    if problems := check_abort(_scenario(given.scheme, given.isolation)):
        raise BadInput(problems)
    found = sweep(
        given.scheme, given.isolation, flights(given.scheme, given.step, given.isolation), given.across, given.workers
    )
    keep_out_m = load_scenario(given.scheme).value.keep_out.radius_m
    print(f"{given.scheme}, isolation {given.isolation}: {len(found)} flights, keep-out {keep_out_m:g} m")
    for kind, ordered in product(KINDS, (True, False)):
        part = [
            (distance_m, flight) for distance_m, flight in found if (flight.kind, flight.ordered) == (kind, ordered)
        ]
        distance_m, worst = min(part, key=lambda each: each[0])
        inside = sum(each[0] < keep_out_m for each in part)
        text = "with an abort ordered" if ordered else "found by the GNC"
        print(
            f"{kind:13} {text:22} {len(part):5} flights, nearest {distance_m:.3f} m "
            f"(thruster.{worst.thruster} at {worst.at_s:g} s, line {worst.edge}), {inside} inside"
        )


if __name__ == "__main__":
    main()
