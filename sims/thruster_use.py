"""Propellant, firings and limit cycles of the schemes over many seeds, as a table and a figure.

python sims/thruster_use.py docs/pictures/thruster-use.png --seeds 20 --latency 0.1
"""

from __future__ import annotations

import argparse
from typing import Any

import matplotlib as mpl
import numpy as np

import hil
from hil.params.ready import ROW_NAMES
from hil.report.verdict import TABLE_V

mpl.use("Agg")
from matplotlib import pyplot as plt

SCHEMES = ("scheme-1", "scheme-2", "scheme-3")
COLOURS = ("#0072b2", "#d55e00", "#009e73")  # distinguishable with colour blindness


def run(name: str, seed: int, latency_s: float) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Return the run's numbers, and y and its rate, mm and mm/s, of the truth in the ready phase."""
    found = hil.run(name, seed=seed, overrides={"vmu.latency_s": latency_s})
    late = found.t_s >= (found.ready_time_s if found.ready_time_s is not None else found.t_s[-1])
    return found.summary, 1e3 * found.truth.r_CT_H[late, 1], 1e3 * found.truth.v_CT_H[late, 1]


def row(name: str, runs: list[dict[str, Any]]) -> str:
    """Return the scheme's row of the table."""
    energy = [run["verdict"]["energy"] for run in runs]
    propellant = np.array([part["propellant_kg"] for part in energy])
    allowed = energy[0]["factor"] * energy[0]["least_propellant_kg"]
    ready = [run for run in runs if run["ready_phase"]]
    worst = max(
        float((np.array(run["ready_phase"][key]) / getattr(TABLE_V[name], key)).max())
        for run in ready
        for key in ROW_NAMES
    )
    size = np.median([np.array(run["ready_phase"]["position_m"]) for run in ready], axis=0)
    turn = np.median([np.array(run["ready_phase"]["attitude_deg"]) for run in ready], axis=0)
    cells = [
        name,
        f"{sum(run['passed'] for run in runs)} / {len(runs)}",
        f"{sum(run['passed_all_parts'] for run in runs)} / {len(runs)}",
        f"{np.median(propellant):.3f} ({propellant.max():.3f})",
        f"{allowed:.3f}",
        f"{np.median([part['firings'] for part in energy]):.0f}",
        " ".join(f"{1e3 * value:.1f}" for value in size),
        " ".join(f"{value:.3f}" for value in turn),
        f"{worst:.2f}",
        f"{max((run['ready_time_s'] for run in ready), default=float('nan')):.1f}",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--latency", type=float, default=0.1, help="of a pose, s")
    given = parser.parse_args()
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), constrained_layout=True)
    print(
        "| scheme | pass Table III | pass all parts | propellant, kg: median (max) | allowed, kg | firings | "
        "limit cycle x y z, mm | theta1..3, deg | worst / Table V | last ready, s |"
    )
    print("|---" * 10 + "|")
    for name, colour in zip(SCHEMES, COLOURS, strict=True):
        flown = [run(name, seed, given.latency) for seed in range(given.seeds)]
        print(row(name, [run for run, _, _ in flown]), flush=True)
        spent = sorted(run["thrusters"]["propellant_kg"] for run, _, _ in flown)
        axes[0].step(spent, (np.arange(len(spent)) + 1) / len(spent), where="post", color=colour, label=name)
        firings = sorted(run["verdict"]["energy"]["firings"] for run, _, _ in flown)
        axes[1].step(firings, (np.arange(len(firings)) + 1) / len(firings), where="post", color=colour)
        axes[2].plot(flown[0][1], flown[0][2], color=colour, linewidth=0.7)
    axes[0].set_xlabel("propellant, kg")
    axes[0].set_ylabel("fraction of seeds")
    axes[0].legend(loc="lower right")
    axes[1].set_xlabel("firings")
    axes[2].set_xlabel("y, mm")
    axes[2].set_ylabel("rate of y, mm/s")
    axes[2].set_title("ready phase, seed 0", loc="left", fontsize=10)
    figure.savefig(given.picture, dpi=110)


if __name__ == "__main__":
    main()
