"""Parameters of the integrity verdict, from the scenario's units to SI."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.faults import TimedFault
from hil.core.messages import new
from hil.gnc.integrity_verdict import INTEGRITY_PARAMS
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params
from hil.params.ready import ready_params, settled_s


def integrity(scenario: Scenario, rig: Rig | None = None) -> np.record:
    """Return INTEGRITY_PARAMS. rig: with the limits of the axes; None: their margins are not counted."""
    params = new(INTEGRITY_PARAMS)
    params.approach = gnc_params.approach_monitor(scenario)
    params.time_to_alert_s = scenario.integrity.time_to_alert_s
    params.decision.ready = ready_params(scenario.requirements)
    params.decision.required_s = scenario.requirements.go_valid_s
    params.decision.settled_s = settled_s(scenario.duration_s)
    set_faults(params, scenario.faults)
    limits = params.limits
    limits.acquisition_s = scenario.gnc.integrity.acquisition_s
    limits.converged_mps = gnc_params.converged_mps(scenario)
    limits.time_to_alert_s = scenario.integrity.time_to_alert_s
    limits.lost_after_s = scenario.gnc.integrity.lost_after_s
    limits.vision_range = gnc_params.vision_range_m(scenario)
    if rig is not None and rig.floating is not None:  # a measured truth has errors of its own, which the NEES lacks
        params.decision.settled_s = np.inf
    if rig is not None:
        limits.tracks = 1
        limits.axis_max, limits.axis_per_speed_s = bench_params.following_limits(rig)
    return params


def set_faults(params: np.record, faults: Sequence[TimedFault]) -> None:
    """Write the onsets of ``faults`` to ``params`` (INTEGRITY_PARAMS)."""
    params.faults = len(faults)
    params.fault_at_s[: len(faults)] = [fault.at_s for fault in faults]
    params.decision.first_fault_s = min((fault.at_s for fault in faults), default=np.inf)
