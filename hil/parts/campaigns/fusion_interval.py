"""Sampling error of the fusion study: how far rmse over bound may be above one after a number of runs.

A run gives the mean square error m of an axis over its n steady poses. If the error is Gaussian with the
autocovariance C(i, j), ``var m = 2 sum C(i, j)^2 / n^2`` (Isserlis 1918), and m has the variance of a chi-square of
``2 E(m)^2 / var m`` degrees of freedom (Satterthwaite 1946). Consecutive errors are correlated over seconds, in
attitude over minutes, so that a run is worth far fewer independent errors than it has poses. The autocovariance is
that of the optimal filter of one axis: a double integrator with the accelerometer's noise and bias, and a rotation
with the gyro's noise and drift.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from hil.core.messages import Array


@dataclass(frozen=True, slots=True)
class AxisProblem:
    """One axis of the study between two poses. Its first state is measured with variance ``noise``.

    transition, process_noise: (n, n), of one step. start: (n, n), covariance of the errors at the start.
    """

    transition: Array
    process_noise: Array
    start: Array
    noise: float


def degrees_of_freedom(problem: AxisProblem, steps_per_pose: int, first: int, poses: int) -> float:
    """Return the degrees of freedom of a run's mean square error over ``poses`` poses from number ``first`` on."""
    n, p = len(problem.start), problem.start
    moved = np.linalg.matrix_power(problem.transition, steps_per_pose)
    errors, carried = [], []
    for _ in range(poses):
        for _ in range(steps_per_pose):
            p = problem.transition @ p @ problem.transition.T + problem.process_noise
        keep = np.eye(n)
        keep[:, 0] -= p[:, 0] / (p[0, 0] + problem.noise)
        p = keep @ p
        errors.append(p)
        carried.append(keep @ moved)
    covariance, transition = np.array(errors[first:]), np.array(carried[first:])
    mean, total, n = float(covariance[:, 0, 0].mean()), 0.0, len(covariance)
    for lag in range(n):
        total += (1.0 if lag == 0 else 2.0) * float((covariance[:, 0, 0] ** 2).sum())
        covariance = transition[lag + 1 :] @ covariance[: n - lag - 1]
    return mean**2 * n**2 / total


def largest_ratio(freedom: float, runs: int, ratios: int, confidence: float) -> float:
    """Return the limit below which all of so many ratios of rmse to bound lie with ``confidence`` after ``runs``.

    freedom: degrees of freedom of a run's mean square error, if the filter is on the bound.
    """
    n = runs * freedom
    return math.sqrt(float(chi2.ppf(1.0 - (1.0 - confidence) / ratios, n)) / n)
