"""Targets that move, fly-around, attitude profile and departure: whole runs."""

from __future__ import annotations

import numpy as np
import pytest

import hil


@pytest.mark.parametrize("name", ["tumbling-5", pytest.param("tumbling-1", marks=pytest.mark.slow)])
def test_approach_along_a_body_axis_of_a_tumbling_target_passes_all_parts(name: str) -> None:
    run = hil.run(name)
    assert run.passed
    assert run.summary["passed_all_parts"]
    # the target has rotated in inertial space, and the chaser with it
    first, last = run.truth.q_HI[0], run.truth.q_HI[-1]
    assert abs(float(np.dot(first, last))) < 0.99
    assert np.degrees(np.linalg.norm(run.truth.w_CI_C[-1])) == pytest.approx(
        np.degrees(np.linalg.norm(run.truth.w_HI_H[-1])), abs=0.1
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tumbling-3", "limit-cycle", "inspection", "departure"])
def test_other_shipped_scenarios_of_moving_targets_and_paths_pass_all_parts(name: str) -> None:
    assert hil.run(name).summary["passed_all_parts"]
