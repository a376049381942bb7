"""Every shipped scenario, with and without an error budget, through the one estimator."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario, shipped
from hil.core.messages import CYCLE
from hil.gnc.estimation.navigation import VISION_ALONE, VISION_AND_IMU
from hil.loop.runner import COMPLETED
from hil.params import gnc as gnc_params
from hil.params.sensors import error_states
from hil.parts.campaigns.case_runner import CaseRunner

KEY = "gnc.navigation.budget"
PLAIN = (
    f"{KEY}.vision_bias_sigma_m=[0.0, 0.0, 0.0]",
    f"{KEY}.vision_misalignment_sigma_deg=0.0",
    f"{KEY}.vision_scale_sigma=0.0",
    f"{KEY}.vision_correlated_fraction=0.0",
    f"{KEY}.vision_noise_scale_sigma=0.0",
    "gnc.navigation.thrust.enabled=false",
)
VISION = (
    f"{KEY}.vision_correlated_fraction=0.0",
    f"{KEY}.vision_bias_sigma_m=[0.002, 0.0005, 0.001]",
    f"{KEY}.vision_misalignment_sigma_deg=0.05",
    f"{KEY}.vision_scale_sigma=0.002",
    "gnc.navigation.thrust.enabled=true",
)
ALL = (
    *VISION,
    f"{KEY}.vision_correlated_fraction=0.3",
    f"{KEY}.vision_noise_scale_sigma=0.2",
    f"{KEY}.bench_sigma_m=0.0005",
    f"{KEY}.bench_sigma_deg=0.002",
    f"{KEY}.gyro_scale_sigma=0.01",
    f"{KEY}.gyro_misalignment_sigma_deg=0.5",
    f"{KEY}.gyro_instability_degps=1e-4",
    f"{KEY}.accelerometer_scale_sigma=0.02",
    f"{KEY}.accelerometer_misalignment_sigma_deg=1.0",
    f"{KEY}.accelerometer_instability_mps2=2e-5",
)
SCENARIOS = shipped("scenarios")


@pytest.mark.parametrize(("settings", "errors"), [(PLAIN, 15), (VISION, 25), (ALL, 49)], ids=["none", "vision", "all"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario_is_estimated_with_the_errors_that_it_asks_for(
    name: str, settings: tuple[str, ...], errors: int
) -> None:
    scenario = load_scenario(name, settings).value
    params = gnc_params.navigation(scenario)
    alone = params.sensors == VISION_ALONE  # the scale of its thrust
    of_target = {"aligned": 0, "limit_cycle": 3, "tumble": 6}[scenario.target.motion]  # rate; rate and moments
    more = len(error_states(scenario)) + (1 if alone else 0) + of_target
    assert params.fusion.errors.n == errors + more
    runner = CaseRunner(scenario, load_rig("mock").value, 5.0)
    history = np.zeros(runner.cycles, CYCLE)
    _, stop = runner.run(scenario, 0, history)
    assert stop == COMPLETED
    estimate = history["navigation"][-1]
    assert estimate["valid"] == 1
    error = history["truth"]["r_CT_H"][-2] - estimate["r_CT_H"]
    if gnc_params.navigation(scenario).sensors == VISION_AND_IMU:
        sigmas = np.concatenate([estimate["sigma_r_m"], estimate["sigma_v_mps"], estimate["sigma_attitude_rad"]])
        assert np.all((sigmas >= 0.0) & (sigmas < 0.1))
        assert np.sum(sigmas == 0.0) == (
            4 if scenario.chaser.planar else 0
        )  # y of position and velocity, two rotations
        assert np.all(np.abs(error) < 6.0 * estimate["sigma_r_m"] + 0.005)
