"""Figures 6 and 7 of the bench paper for a scheme: relative position, speed, attitude and rate over time.

python sims/scheme_pictures.py scheme-1 docs/pictures/scheme-1.png
"""

from __future__ import annotations

import sys

import matplotlib as mpl
import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.report.verdict import deviations, judge, tolerances
from hil.session import build

mpl.use("Agg")
from matplotlib import pyplot as plt

ROWS = (
    ("position_m", "distance, m", ("x - 0.4 m", "y", "z")),
    ("velocity_mps", "rate, m/s", ("x", "y", "z")),
    ("attitude_deg", "angle, deg", ("theta1", "theta2", "theta3")),
    ("rate_degps", "angular rate, deg/s", ("omega1", "omega2", "omega3")),
)
COLOURS = ("#0072b2", "#d55e00", "#009e73")  # distinguishable with colour blindness


def main(name: str, path: str) -> None:
    scenario = load_scenario(name)
    job = build.Job(scenario, load_rig("mock"), 0, scenario.value.duration_s, 1.0)
    with build.runner(job, lambda *_: None, print) as runner:
        history = runner.run().history
    wanted = scenario.value.requirements
    found = deviations(history, wanted)
    verdict = judge(found, wanted)
    figure, axes = plt.subplots(4, 2, figsize=(11, 10), constrained_layout=True, width_ratios=(2, 1))
    for row, (key, label, names) in enumerate(ROWS):
        limits = tolerances(wanted)[key]
        for column in (0, 1):
            plot = axes[row, column]
            for i in range(3):
                plot.plot(found.t_s, getattr(found, key)[:, i], color=COLOURS[i], label=names[i], linewidth=1)
            if verdict.ready_time_s is not None:
                plot.axvline(verdict.ready_time_s, color="0.4", linestyle=":", linewidth=1)
        axes[row, 0].set_ylabel(label)
        axes[row, 0].legend(loc="upper right", ncols=3, fontsize=8)
        close = axes[row, 1]
        for limit in sorted(set(np.round(limits, 9))):
            close.axhspan(-limit, limit, color="0.93", zorder=0)
        close.set_ylim(-1.3 * limits.max(), 1.3 * limits.max())
        close.set_xlim(max(0.0, (verdict.ready_time_s or found.t_s[-1] - 60.0) - 20.0), found.t_s[-1])
    axes[0, 0].set_title(f"{name}: truth against the ready state; dotted: ready", loc="left", fontsize=10)
    axes[0, 1].set_title("ready phase, grey: Table III", loc="left", fontsize=10)
    for plot in axes[3]:
        plot.set_xlabel("time, s")
    figure.savefig(path, dpi=110)
    print(f"{path}: ready at {verdict.ready_time_s} s")


if __name__ == "__main__":
    main(*sys.argv[1:3])
