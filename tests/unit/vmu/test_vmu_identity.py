"""Which spot is which LED: right or not at all."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hil.vmu.identify import OK, Identifier
from hil.vmu.kernels.records import MAX_SPOTS, SPOT
from hil.vmu.unit import VisionUnit
from tests.support.vmu_scene import ring, somewhere, spots_of

RIGHT = 40.0  # chi-square of six components that a right pose exceeds once in two million


@pytest.fixture(scope="module")
def raised() -> VisionUnit:
    return VisionUnit(ring())


@pytest.fixture(scope="module")
def flat() -> VisionUnit:
    return VisionUnit(ring(raised_m=0.0))


@pytest.mark.parametrize("decoys", [0, 2, 5])
def test_six_leds_are_identified_without_a_track(raised: VisionUnit, rng: np.random.Generator, decoys: int) -> None:
    for _ in range(25):
        truth = somewhere(rng)
        raised.track.drop()
        solution = raised.solve_spots(*spots_of(raised.geometry, truth, rng, decoys=decoys), 0.0)
        assert solution.status == "ok"
        assert solution.pose is not None
        assert truth.nees(solution.pose) < RIGHT
        assert solution.n_leds == 6


@pytest.mark.parametrize("count", [3, 4, 5])
@pytest.mark.parametrize("black", [None, 0, 1])
def test_no_subset_of_leds_is_taken_for_another(
    raised: VisionUnit, rng: np.random.Generator, count: int, black: int | None
) -> None:
    for lit in itertools.combinations(range(6), count):
        truth = somewhere(rng)
        raised.track.drop()
        left, right = spots_of(raised.geometry, truth, rng, lit, decoys=int(rng.integers(3)), black=black)
        solution = raised.solve_spots(left, right, 0.0)
        if solution.status == "ok":
            assert solution.pose is not None
            assert truth.nees(solution.pose) < RIGHT
        else:
            assert solution.pose is None


def test_five_leds_of_one_camera_make_a_pose(raised: VisionUnit, rng: np.random.Generator) -> None:
    found = 0
    for black in (0, 1) * 10:
        truth = somewhere(rng, far_m=4.0)
        raised.track.drop()
        solution = raised.solve_spots(*spots_of(raised.geometry, truth, rng, (0, 1, 2, 3, 4), 0, black), 0.0)
        if solution.pose is not None:
            found += 1
            assert truth.nees(solution.pose) < RIGHT
            assert solution.bits(black) == 0
    assert found >= 15


def test_a_flat_ring_is_ambiguous_without_a_track(flat: VisionUnit, rng: np.random.Generator) -> None:
    for _ in range(20):
        flat.track.drop()
        truth = somewhere(rng)
        solution = flat.solve_spots(*spots_of(flat.geometry, truth, rng, decoys=1), 0.0)
        assert solution.status in ("ambiguous", "ok_position")  # the decoy may be near the ring
        assert solution.pose is None
        if solution.partial is not None:
            assert (np.abs(solution.t - truth.t) < 4.5 * np.sqrt(np.diag(solution.covariance)[:3])).all()
        assert solution.candidates >= 6


def test_a_prediction_identifies_the_leds_of_a_flat_ring(flat: VisionUnit, rng: np.random.Generator) -> None:
    solved = 0
    for _ in range(30):
        truth = somewhere(rng, far_m=3.0)
        flat.track.drop()
        spots = spots_of(flat.geometry, truth, rng, decoys=2)
        solution = flat.solve_spots(*spots, 0.0, truth.prediction(rng))
        if solution.pose is not None:
            solved += 1
            assert truth.nees(solution.pose) < RIGHT
    assert solved >= 25


def test_a_flat_ring_seen_head_on_from_afar_does_not_claim_a_tilt(flat: VisionUnit, rng: np.random.Generator) -> None:
    for _ in range(20):
        truth = somewhere(rng, 9.0, 12.0, tilt_deg=2.0)
        flat.track.drop()
        spots = spots_of(flat.geometry, truth, rng)
        solution = flat.solve_spots(*spots, 0.0, truth.prediction(rng, 0.1, 3.0))
        if solution.pose is not None:
            assert np.abs(truth.error(solution.pose)[3:]).max() < 4.0 * np.sqrt(solution.pose.covariance[3:, 3:].max())
        else:
            assert solution.status == "ok_position"
            assert (np.abs(solution.t - truth.t) < 4.5 * np.sqrt(np.diag(solution.covariance)[:3])).all()


def test_a_marked_led_identifies_the_leds_of_a_flat_ring(rng: np.random.Generator) -> None:
    unit = VisionUnit(ring(raised_m=0.0, marked_led=2))
    for _ in range(10):
        truth = somewhere(rng, 1.0, 2.0)
        unit.track.drop()
        solution = unit.solve_spots(*spots_of(unit.geometry, truth, rng, bright=2), 0.0)
        assert solution.status in ("ok", "ok_position")  # the tilt of a flat ring may still be open
        if solution.pose is not None:
            assert truth.nees(solution.pose) < RIGHT
        assert solution.candidates <= 2


def test_three_leds_of_one_camera_need_a_prediction(raised: VisionUnit, rng: np.random.Generator) -> None:
    with_track = 0
    for _ in range(20):
        truth = somewhere(rng, far_m=3.0)
        spots = spots_of(raised.geometry, truth, rng, (0, 2, 4), black=1)
        raised.track.drop()
        assert raised.solve_spots(*spots, 0.0).pose is None
        raised.track.drop()
        solution = raised.solve_spots(*spots, 0.0, truth.prediction(rng, 0.01, 1.0))
        if solution.pose is not None:
            with_track += 1
            assert truth.nees(solution.pose) < RIGHT
    assert with_track >= 10


def test_a_wrong_prediction_does_not_bias_the_solution(raised: VisionUnit, rng: np.random.Generator) -> None:
    for _ in range(10):
        truth, elsewhere = somewhere(rng), somewhere(rng)
        raised.track.drop()
        solution = raised.solve_spots(*spots_of(raised.geometry, truth, rng), 0.0, elsewhere.prediction(rng))
        assert solution.pose is not None
        assert truth.nees(solution.pose) < RIGHT


def test_strays_alone_make_no_pose(raised: VisionUnit, rng: np.random.Generator) -> None:
    for _ in range(30):
        raised.track.drop()
        spots = spots_of(raised.geometry, somewhere(rng), rng, lit=(), decoys=7)
        assert raised.solve_spots(*spots, 0.0).pose is None


def test_the_covariance_covers_the_truth(raised: VisionUnit, rng: np.random.Generator) -> None:
    squares, within = [], []
    for _ in range(400):
        truth = somewhere(rng)
        raised.track.drop()
        solution = raised.solve_spots(*spots_of(raised.geometry, truth, rng), 0.0)
        assert solution.pose is not None
        squares.append(truth.nees(solution.pose))
        within.append(np.abs(truth.error(solution.pose)) < 2.0 * np.sqrt(np.diag(solution.pose.covariance)))
    assert 5.4 < np.mean(squares) < 6.6  # six, with 3.5 sigma of the mean
    assert 0.93 < np.mean(within) < 0.975


def test_a_spot_that_is_off_is_left_out(raised: VisionUnit, rng: np.random.Generator) -> None:
    for _ in range(20):
        truth = somewhere(rng, far_m=5.0)
        left, right = spots_of(raised.geometry, truth, rng)
        left["u"][3] += 1.5
        raised.track.drop()
        solution = raised.solve_spots(left, right, 0.0)
        assert solution.pose is not None
        assert 3 not in solution.leds[0]
        assert truth.nees(solution.pose) < RIGHT


def test_images_of_more_lights_than_are_used_are_not_searched_one_by_one(
    raised: VisionUnit, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pattern in one of them proves nothing, and to look for it costs as much as for the pose."""
    calls = []
    monkeypatch.setattr(Identifier, "_each_alone", lambda *_: calls.append(1) or OK)
    for lights in (MAX_SPOTS - 1, MAX_SPOTS):
        images = np.zeros((2, lights), SPOT)
        images["u"], images["v"] = rng.uniform(50.0, 950.0, (2, 2, lights))
        images["var_u"] = images["var_v"] = 0.01
        raised.track.drop()
        assert raised.solve_spots(*images, 0.0).pose is None
    assert len(calls) == 1
