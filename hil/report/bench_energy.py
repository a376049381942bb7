"""Energy that the axes add to a run, from its history."""

from __future__ import annotations

import numpy as np

from hil.bench.energy import add_work
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params
from hil.report.bench_error import encoders_at_truth

ENERGY_KEYS = ("translation_added_j", "translation_work_j", "rotation_added_j", "rotation_work_j")


def judge_energy_added(history: np.ndarray, scenario: Scenario, rig: Rig) -> dict[str, float]:
    """Return what the axes add to the thrusters' work on the truth, and that work, J, by ENERGY_KEYS.

    history: (n,) of CYCLE. Thrusters are those of the scenario, without errors; the truth's fractions are how long
    they were open.
    """
    rows, rail_m, gimbal_rad = encoders_at_truth(history)
    work = np.zeros(4)
    if len(rows) > 1:
        wrenches = gnc_params.wrenches_of(scenario.chaser.thrusters)
        fraction = rows["truth"]["thrust_fraction"][:, : len(wrenches)]
        add_work(
            bench_params.bench(rig, scenario.step_s, scenario.bench),
            fraction @ wrenches[:, :3],
            fraction @ wrenches[:, 3:],
            rail_m,
            gimbal_rad,
            np.ascontiguousarray(rows["truth"]["r_CT_H"]),
            np.ascontiguousarray(rows["truth"]["q_CH"]),
            work,
        )
    return dict(zip(ENERGY_KEYS, work.tolist(), strict=True))
