"""Cost of the navigation filters and of filterpy's of the same size, in microseconds, in one run.

python benchmarks/filters.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from numba import njit

from hil.config.load import load_scenario
from hil.core.messages import POSE, new
from hil.gnc.estimation import joint_filter, pose_model, step_memory
from hil.gnc.estimation.fusion import FUSION_STATE
from hil.params import gnc as gnc_params
from tests.support.plain_filters import PLAIN

REPEATS, CALLS = 9, 2000
_VISION = (
    "vision_bias_sigma_m=[0.002, 0.0005, 0.001]",
    "vision_misalignment_sigma_deg=0.05",
    "vision_scale_sigma=0.002",
)
_OTHERS = (
    "vision_correlated_fraction=0.3", "vision_correlation_time_s=4.0", "gyro_scale_sigma=0.01",
    "gyro_misalignment_sigma_deg=0.5", "gyro_instability_degps=1e-4", "gyro_instability_time_s=20.0",
    "accelerometer_scale_sigma=0.02", "accelerometer_misalignment_sigma_deg=1.0",
    "accelerometer_instability_mps2=2e-4", "accelerometer_instability_time_s=30.0",
)  # fmt: skip
BUDGETS = {
    name: tuple(f"gnc.navigation.budget.{setting}" for setting in settings)
    for name, settings in (("vision, 22", _VISION), ("all, 46", (*_VISION, *_OTHERS)))
}


def cost_us(call: Callable[[], object], calls: int = CALLS) -> float:
    """Return the median over the repeats of the mean cost of ``call``."""
    call()
    means = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        for _ in range(calls):
            call()
        means.append((time.perf_counter() - start) / calls)
    return 1e6 * float(np.median(means))


def filterpy_costs() -> dict[str, float]:
    kf = KalmanFilter(dim_x=9, dim_z=3)
    kf.x, kf.F, kf.H = np.zeros(9), np.eye(9), np.eye(3, 9)
    ekf = ExtendedKalmanFilter(dim_x=7, dim_z=3)
    ekf.x, ekf.F = np.zeros(7), np.eye(7)
    h, z = np.eye(3, 7), np.zeros(3)
    return {
        "PKF predict": cost_us(kf.predict),
        "PKF update": cost_us(lambda: kf.update(z)),
        "AKF predict": cost_us(ekf.predict),
        "AKF update": cost_us(lambda: ekf.update(z, lambda x: h, lambda x: x[:3])),
    }


@njit(nogil=True)
def many(params, state, memory, pose, what, n):
    """Run one of the steps ``n`` times, without Python in between."""
    errors, filters, noise = params.errors, state.filters, state.noise
    step = step_memory.step_at(params, memory, 0)
    for _ in range(n):
        if what == 0:
            joint_filter.predict(params, filters, step)
        elif what == 1:
            pose_model.innovate_position(
                errors, filters, noise, pose.z_TC_C, pose.covariance_position, 0.0, state.found_position
            )
            joint_filter.update(errors, filters, state.found_position)
        elif what == 2:
            pose_model.innovate_attitude(
                errors, filters, noise, pose.q_CH, pose.covariance_attitude, state.found_attitude
            )
            joint_filter.update(errors, filters, state.found_attitude)
        else:
            step_memory.keep_predicted(params, filters, memory, 0)


def own_costs(settings: tuple[str, ...] = ()) -> dict[str, float]:
    """Return the cost of the steps by name, us, for the plain filters of scheme 1 with ``settings``."""
    params = gnc_params.navigation(load_scenario("scheme-1", (*PLAIN, *settings)).value).fusion
    state, memory, pose = new(FUSION_STATE), step_memory.new_memory(params), new(POSE)
    pose.q_CH[3] = 1.0
    pose.z_TC_C[0] = -5.0
    pose.covariance_position, pose.covariance_attitude = 2.5e-5 * np.eye(3), 3.3e-7 * np.eye(3)
    pose_model.start(params, pose, state.noise, state.filters)
    block = 100
    return {
        name: cost_us(lambda what=what: many(params, state, memory, pose, what, block), CALLS // block) / block
        for what, name in enumerate(("predict", "position", "attitude", "keep"))
    }


if __name__ == "__main__":
    own, other = own_costs(), filterpy_costs()
    reference = {
        "predict": other["PKF predict"] + other["AKF predict"],
        "position": other["PKF update"],
        "attitude": other["AKF update"],
    }
    with_budget = {name: own_costs(settings) for name, settings in BUDGETS.items()}
    print("us per step inside compiled code, as the loop calls it; filterpy: two filters, 9 and 7 states, from Python")
    print(f"{'':10} {'15 errors':>10} " + " ".join(f"{name:>12}" for name in BUDGETS) + f" {'filterpy':>10}")
    for name, us in own.items():
        budgets = " ".join(f"{costs[name]:12.2f}" for costs in with_budget.values())
        print(f"{name:10} {us:10.2f} {budgets} {reference.get(name, np.nan):10.2f}")
