"""Plan of calibration views: within travel, image and clearance, and better than random views."""

from __future__ import annotations

import numpy as np
import pytest

from hil.bench.kinematics import pose_of_axes
from hil.config.load import load_rig, load_scenario
from hil.core.messages import Array
from hil.errors import BadInput
from hil.params import bench as bench_params
from hil.parts.vision.view_plan import Clearance, PlanRequest, plan_views
from hil.vmu.calibration.model import Setup, TurntableModel, project_view
from hil.vmu.calibration.refine import weak_prior
from hil.vmu.geometry import geometry_of_rig

AXIS_SIGMA = np.array([5e-5] * 3 + [np.radians(0.005)] * 3)
RIG = load_rig("emulated").value
BENCH = bench_params.bench(RIG, 0.02)
SETUP = Setup.of(geometry_of_rig(RIG), RIG.bench)
LEAST_M = 0.8
_SCENARIO = load_scenario("scheme-1", ("keep_out.inspects=true",)).value
_ALONE = load_rig("emulated", ("rig.bench.bodies=[]",)).value
CLEARANCE = Clearance(BENCH, bench_params.axis_guard(_ALONE, _SCENARIO), LEAST_M - _SCENARIO.keep_out.radius_m)


def planned(count: int, far_m: float = 4.0) -> Array:
    held = weak_prior(SETUP, (), AXIS_SIGMA, 1e-3, 0.0)
    request = PlanRequest(count, 0.7, far_m, np.radians(20.0))
    return plan_views(SETUP, BENCH, held, request, CLEARANCE, np.random.default_rng(0))


def test_views_are_within_travel_image_and_clearance_and_tilt_and_spread() -> None:
    plan = planned(10)
    turntable = TurntableModel.of(RIG.bench)
    assert plan.shape == (10, 6)
    assert (plan > BENCH.low).all()
    assert (plan < BENCH.high).all()
    r, q = np.empty(3), np.empty(4)
    for axes in plan:
        pixels = project_view(SETUP, turntable, axes).pixels
        assert ((pixels > 0.0) & (pixels < SETUP.sizes[:, None] - 1.0)).all(axis=-1).sum(axis=1).min() >= 5
        pose_of_axes(BENCH, axes[:3], axes[3:], r, q)
        assert np.linalg.norm(r) >= LEAST_M
    assert np.ptp(plan[:, 0]) > 1.0
    assert (np.degrees(np.ptp(plan[:, 3:], axis=0)) > 15.0).all()


def test_a_way_past_the_target_is_not_clear() -> None:
    clear = CLEARANCE
    left, right = np.array([0.0, -1.4, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, 1.4, 0.0, 0.0, 0.0, 0.0])
    assert clear(left, left)
    assert clear(right, right)
    assert not clear(left, right)


def test_ranges_that_the_rails_do_not_reach_are_refused() -> None:
    with pytest.raises(BadInput, match="views with the LEDs in both images"):
        plan_views(
            SETUP,
            BENCH,
            weak_prior(SETUP, (), AXIS_SIGMA, 1e-3, 0.0),
            PlanRequest(10, 30.0, 40.0, 0.3),
            CLEARANCE,
            np.random.default_rng(0),
        )
