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
from hil.core.messages import IMU, POSE, new
from hil.gnc import akf, fusion, pkf
from hil.gnc.fusion import FUSION_STATE
from hil.params import gnc as gnc_params

REPEATS, CALLS = 9, 2000


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
def many(params, state, pose, zero, hill, what, n):
    """Run one of the four steps ``n`` times, without Python in between."""
    position, attitude = state.filters.pkf, state.filters.akf
    gain_a, out = np.empty((6, 3)), np.empty(3)
    gain_p, h, h_turn = np.empty((9, 3)), np.empty((3, 9)), np.empty((3, 3))
    for _ in range(n):
        if what == 0:
            pkf.predict(params.pkf, position, zero, attitude.x[0:4], attitude.p, attitude.phi, hill)
        elif what == 1:
            pkf.innovate(
                position, pose.z_TC_C, pose.covariance_position, 0.0, attitude.x[0:4], attitude.p,
                h, h_turn, gain_p, out,
            )  # fmt: skip
            pkf.update(position, pose.covariance_position, attitude.p, h, h_turn, gain_p, out)
        elif what == 2:
            akf.predict(params.akf, attitude, zero, hill)
        else:
            akf.innovate(attitude, pose.q_CH, pose.covariance_attitude, gain_a, out)
            akf.update(attitude, pose.covariance_attitude, gain_a, out)


def own_costs() -> dict[str, float]:
    params = gnc_params.navigation(load_scenario("scheme-1").value).fusion
    state, memory, imu, pose = new(FUSION_STATE), fusion.new_memory(params), new(IMU), new(POSE)
    pose.q_CH[3] = 1.0
    pose.z_TC_C[0] = -5.0
    pose.covariance_position, pose.covariance_attitude = 2.5e-5 * np.eye(3), 3.3e-7 * np.eye(3)
    fusion.advance(params, state, memory, imu)
    fusion.fuse(params, state, memory, pose)
    zero, hill = np.zeros(3), memory[0].hill
    names = ("PKF predict", "PKF update", "AKF predict", "AKF update")
    block = 100
    return {
        name: cost_us(lambda what=what: many(params, state, pose, zero, hill, what, block), CALLS // block) / block
        for what, name in enumerate(names)
    }


if __name__ == "__main__":
    own, reference = own_costs(), filterpy_costs()
    print(
        f"{'':12} {'hil, us':>9} {'filterpy, us':>13} {'ratio':>7}   (hil: inside compiled code, as the loop calls it)"
    )
    for name, us in own.items():
        print(f"{name:12} {us:9.2f} {reference[name]:13.2f} {reference[name] / us:7.1f}")
