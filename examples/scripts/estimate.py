"""Estimate against truth, with three standard deviations."""

import matplotlib.pyplot as plt

import hil

run = hil.run("scheme-1", seed=7, duration_s=100.0)
error, band = run.navigation.r_CT_H - run.truth.r_CT_H, 3.0 * run.navigation.sigma_r_m
plt.plot(run.t_s, 1e3 * error[:, 1], run.t_s, 1e3 * band[:, 1], "k--", run.t_s, -1e3 * band[:, 1], "k--")
plt.savefig("estimate.png")
