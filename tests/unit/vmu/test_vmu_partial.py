"""Position and line of sight without a whole pose: few LEDs, and what must not be taken for them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from hil.core.messages import POSITION_ONLY
from hil.drivers.vmu.codec import checked_pose
from hil.parts.vision.cli.vmu import row
from hil.vmu.kernels.records import FIT
from hil.vmu.partial import OK_POSITION, OK_SIGHT, partial_pose
from hil.vmu.unit import Solution, VisionUnit
from tests.support.vmu_disturbances import USUAL, VERY_GOOD, Pose, known_geometry, real_bench, somewhere
from tests.support.vmu_pixels import PixelOptics, PixelScene


def solutions(
    lit: int, near_m: float, far_m: float, count: int, seed: int, strays: int = 0, usual: bool = False
) -> Iterator[tuple[Pose, Solution]]:
    """Yield solutions without a track of a ring with ``lit`` LEDs of six, and other lights around it."""
    errors = USUAL if usual else VERY_GOOD
    unit, rng = VisionUnit(known_geometry(errors)), np.random.default_rng([seed, 11])
    for _ in range(count):
        scene, truth = real_bench(errors, rng, PixelOptics()), somewhere(rng, near_m, far_m)
        others = truth.t_v + rng.uniform(-0.3, 0.3, (strays, 3))
        scene = _lit(scene, sorted(rng.choice(6, lit, replace=False).tolist()))
        scene = replace(scene, lights_v=np.column_stack([others, np.ones(strays)]))
        unit.track.drop()
        yield truth, unit.solve(*scene.pair(truth.turn, truth.t_v, rng), 0.0)


def _lit(scene: PixelScene, which: list[int]) -> PixelScene:
    return replace(scene, leds_m=scene.leds_m[which])


@pytest.mark.parametrize(("near_m", "far_m"), [(1.0, 6.0), (6.0, 16.0)])
def test_three_leds_without_a_track_give_the_position(near_m: float, far_m: float) -> None:
    for truth, solution in solutions(3, near_m, far_m, 8, 1):
        assert solution.status == OK_POSITION
        assert solution.pose is None
        frame = solution.frame(0, 0.0)
        assert frame is not None
        assert frame.status == POSITION_ONLY
        np.testing.assert_array_equal(frame.t_v, solution.t)
        assert checked_pose(frame) is not None  # the wire's other end takes it
        sigma = np.sqrt(np.diag(solution.covariance))
        np.testing.assert_allclose(np.sqrt(np.diag(frame.covariance)), [*sigma[:3], 1.0, 1.0, 1.0])
        assert (np.abs(solution.t - truth.t_v) < 4.5 * sigma[:3]).all()
        assert np.isinf(sigma[3:]).all()
        assert np.isnan(solution.R).all()


@pytest.mark.parametrize("usual", [False, True])
def test_ring_at_16_to_30_m_has_a_pose_or_a_position(usual: bool) -> None:
    """Its LEDs are 5 to 8 px apart there: one connected component of six lights."""
    for truth, solution in solutions(6, 16.0, 30.0, 8, 3, usual=usual):
        assert solution.status in ("ok", OK_POSITION)
        assert (np.abs(solution.t - truth.t_v) < 4.5 * np.sqrt(np.diag(solution.covariance)[:3])).all()


@pytest.mark.parametrize(("lit", "strays"), [(0, 3), (0, 4), (3, 1), (3, 2)])
def test_lights_that_may_be_others_give_no_position(lit: int, strays: int) -> None:
    for _, solution in solutions(lit, 1.0, 8.0, 8, 2, strays):
        assert solution.status not in (OK_POSITION, OK_SIGHT, "ok")
        assert solution.partial is None


def test_candidates_of_several_ranges_leave_the_line_of_sight() -> None:
    fits = np.zeros(2, FIT)
    fits["covariance"] = 1e-6 * np.eye(6)
    sight = np.array([0.1, 0.0, 1.0]) / math.hypot(0.1, 1.0)
    fits["t"] = [2.0 * sight, 3.0 * sight]
    found = partial_pose(list(fits))
    assert found is not None
    assert found.status == OK_SIGHT
    np.testing.assert_allclose(found.sight, sight)
    fits["t"][1] = 2.0 * sight + [0.004, 0.0, 0.0]
    near = partial_pose(list(fits))
    assert near is not None
    assert near.covariance is not None
    assert near.status == OK_POSITION
    assert near.covariance[0, 0] == pytest.approx(1e-6 + 0.002**2)
    fits["t"][1] = [-0.5, 0.0, 2.0]
    assert partial_pose(list(fits)) is None


def test_each_candidate_is_within_five_sigmas_however_unlikely() -> None:
    fits = np.zeros(2, FIT)
    fits["covariance"] = 1e-8 * np.eye(6)
    fits["t"], fits["score"] = [[0.0, 0.0, 5.0], [0.0, 0.0, 5.1]], [0.0, -7.9]
    found = partial_pose(list(fits))
    assert found is not None
    assert found.t_v is not None
    assert found.covariance is not None
    assert abs(5.1 - found.t_v[2]) < 5.0 * math.sqrt(found.covariance[2, 2])


def test_row_of_a_position_has_no_attitude() -> None:
    _, solution = next(solutions(3, 1.0, 6.0, 1, 1))
    found = row(7, solution, "proven")
    assert found["status"] == OK_POSITION
    assert float(found["z_m"]) == pytest.approx(solution.t[2], rel=1e-6)
    assert float(found["sigma_z_m"]) < 0.1
    assert math.isnan(float(found["rx_rad"]))
    assert math.isinf(float(found["sigma_rx_rad"]))
    assert float(found["sight_z"]) > 0.9
    assert 0.0 < float(found["sigma_sight_rad"]) < 0.01
