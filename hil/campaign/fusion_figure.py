"""The errors of one run with their 3-sigma band, as bench paper Fig. 5."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np

from hil.campaign.fusion import Reading, Study
from hil.campaign.fusion_kernel import SNAPSHOTS_S, STUDY_RESULT
from hil.core.messages import new

_COLOURS = ("#0072b2", "#d55e00", "#009e73")  # told apart by the colour-blind


def draw(reading: Reading, seed: int, settings: tuple[str, ...], path: str) -> None:
    """Draw run 0 of the study of ``seed`` into ``path``."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    study = Study(settings, reading, seed)
    trace = np.zeros((round(SNAPSHOTS_S[-1] / study.step_s), 12))
    study.run(0, new(STUDY_RESULT), trace)
    t_s = (1 + np.arange(len(trace))) * study.step_s
    figure, axes = plt.subplots(3, 2, figsize=(11, 7), sharex=True, constrained_layout=True)
    for column, (title, unit, scale) in enumerate((("position", "mm", 1e3), ("attitude", "deg", 180.0 / np.pi))):
        late = t_s >= 20.0
        for i in range(3):
            plot = axes[i, column]
            error, sigma = trace[:, 3 * column + i] * scale, trace[:, 6 + 3 * column + i] * scale
            plot.fill_between(t_s, -3.0 * sigma, 3.0 * sigma, color="0.9", linewidth=0)
            plot.plot(t_s, error, color=_COLOURS[i], linewidth=0.8)
            limit = 3.5 * sigma[late].max()
            plot.set_ylim(-limit, limit)
            plot.set_ylabel(f"{'xyz'[i]}, {unit}" if column == 0 else f"theta{i + 1}, {unit}")
        axes[0, column].set_title(f"{title} error and 3 sigma, vision noise as {reading}", loc="left", fontsize=10)
        axes[2, column].set_xlabel("time, s")
    figure.savefig(path, dpi=110)
    plt.close(figure)
