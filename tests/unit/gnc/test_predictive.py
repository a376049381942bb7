"""Predictive law: its program against HiGHS, signs, and a limit cycle that it keeps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from hil.gnc.predictive import STEPS, first_impulse, predicted_burn, write_program

LEAD, A, DT = 16.0, 0.01, 0.02
BANDS = np.array([0.004, 0.008, 0.012])


def by_highs(error: float, rate: float) -> float:
    """Return the least sum of impulses, m/s."""
    tableau = np.zeros((2 * STEPS + 1, 2 * STEPS + 1))
    write_program(error, rate, LEAD, BANDS, tableau)
    found = linprog(tableau[-1, :-1], A_ub=tableau[:-1, :-1], b_ub=tableau[:-1, -1], method="highs")
    return float(found.fun) / LEAD


def test_first_impulse_leaves_the_minimum_of_the_program() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        error, rate = rng.uniform(-0.03, 0.03), rng.uniform(-0.003, 0.003)
        first = first_impulse(error, rate, LEAD, BANDS)
        # with it, the rest of the program costs what is left of the minimum
        assert abs(first) + by_highs(error, rate + first) == pytest.approx(by_highs(error, rate), abs=1e-9)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_error_that_will_leave_its_band_is_pushed_back_and_one_that_stays_is_not(sign: float) -> None:
    assert sign * predicted_burn(0.0, sign * 0.001, A, LEAD, BANDS, DT) < -DT
    assert sign * predicted_burn(sign * 0.0035, sign * 0.0001, A, LEAD, BANDS, DT) < -DT
    assert predicted_burn(sign * 0.003, 0.0, A, LEAD, BANDS, DT) == 0.0
    assert predicted_burn(sign * 0.0035, -sign * 0.0002, A, LEAD, BANDS, DT) == 0.0  # it crosses by itself
    # within the band after one lead, but not after two
    assert sign * predicted_burn(-sign * 0.003, sign * 0.0004, A, LEAD, BANDS * [1.0, 1.0, 10.0], DT) < -DT


def test_axis_with_a_smallest_burn_keeps_within_its_band_with_few_of_them() -> None:
    error, rate, fired = 0.003, 0.0005, 0
    pulse, worst = A * DT, 0.0
    for k in range(20000):  # 400 s
        if k % 7 == 0:
            time = predicted_burn(error, rate, A, LEAD, BANDS, DT)
            bits = int(abs(time) / DT + 0.5)
            rate += np.sign(time) * bits * pulse
            fired += bits
        error += rate * DT
        worst = max(worst, abs(error))
    assert worst < BANDS[0]
    assert fired < 40
