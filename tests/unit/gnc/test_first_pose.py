"""First pose that is wrong: whole runs."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE
from hil.loop.runner import COMPLETED
from hil.parts.campaigns.case_runner import CaseRunner
from tests.support.run_settings import faults_setting

_DURATION_S = 5.0


@pytest.mark.parametrize("offset_m", [(0.3, 0.0, 0.0), (-0.8, 0.0, 0.0), (0.0, 0.1, -0.2)])
def test_wrong_first_pose_is_replaced_before_anything_relies_on_it(offset_m: tuple[float, ...]) -> None:
    """Without protection until a second pose agrees, the estimate is right when two others have agreed."""
    base = (f"duration_s={_DURATION_S}",)
    fault = faults_setting({"device": "vmu", "kind": "offset", "value": list(offset_m), "at_s": 0.0, "until_s": 0.1})
    scenario, truth = load_scenario("scheme-1", base).value, load_scenario("scheme-1", (*base, fault)).value
    runner = CaseRunner(scenario, load_rig("mock").value, _DURATION_S)
    cycles = np.zeros(runner.cycles, CYCLE).view(np.recarray)
    stats, reason = runner.run(truth, 4, cycles)
    assert reason == COMPLETED
    error = np.abs(cycles.truth.r_CT_H - cycles.navigation.r_CT_H).max(axis=1)
    valid = cycles.navigation.valid != 0
    wrong = valid & (error > 0.03)
    assert np.any(wrong)
    assert cycles.t_s[wrong].max() < 0.5  # poses come each 0.16 s
    assert np.all(np.isinf(cycles.navigation.protection_level_m[wrong]))
    assert np.all(np.isinf(cycles.navigation.protection_level_rad[wrong]))
    assert np.all(np.isfinite(cycles.navigation.protection_level_m[cycles.t_s > 0.6]))
    assert stats.integrity.decision.over_level < 1.0
    assert stats.integrity.hmi_cycles == 0
