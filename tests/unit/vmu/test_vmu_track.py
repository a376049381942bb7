"""From image to image: prediction, lost frames, a lock that turns out wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.vmu.unit import VisionUnit
from tests.support.vmu_scene import Truth, ring, spots_of

PERIOD_S = 0.16
NO_EXTRAS = np.zeros(
    0, spots_of(ring(), Truth(np.array([0.0, 0.0, 2.0]), np.zeros(3)), np.random.default_rng(0))[0].dtype
)


@pytest.fixture
def unit() -> VisionUnit:
    return VisionUnit(ring())


def flight(k: int) -> Truth:
    return Truth(np.array([0.1, 0.05 - 0.002 * k, 6.0 - 0.1 * k]), np.array([0.05, -0.002 * k, 0.3 + 0.01 * k]))


def test_the_prediction_holds_the_next_pose_and_grows(unit: VisionUnit, rng: np.random.Generator) -> None:
    for k in range(6):
        unit.solve_spots(*spots_of(unit.geometry, flight(k), rng), PERIOD_S * k)
    near, far = unit.track.predict(6 * PERIOD_S), unit.track.predict(9 * PERIOD_S)
    assert near is not None
    assert far is not None
    assert (np.abs(near.t_v - flight(6).t) < 4.0 * np.sqrt(np.diag(near.covariance)[:3])).all()
    assert (np.diag(far.covariance) > np.diag(near.covariance)).all()


def test_lost_frames_are_predicted_for_a_while_and_then_not(unit: VisionUnit, rng: np.random.Generator) -> None:
    for k in range(4):
        unit.solve_spots(*spots_of(unit.geometry, flight(k), rng), PERIOD_S * k)
    said = []
    for k in range(4, 14):
        solution = unit.solve(None, None, PERIOD_S * k)
        said.append(solution.status)
        assert (solution.pose is not None) == (solution.status == "predicted")
        if solution.pose is not None:
            assert flight(k).nees(solution.pose) < 40.0
            assert solution.frame(k, 0.0) is None  # only what was measured goes to the bench
    longest = int(unit.track.settings.longest_s / PERIOD_S)
    assert said == ["predicted"] * longest + ["too_few"] * (10 - longest)


def test_a_single_pose_is_no_ground_for_a_prediction(unit: VisionUnit, rng: np.random.Generator) -> None:
    unit.solve_spots(*spots_of(unit.geometry, flight(0), rng), 0.0)
    assert unit.solve(None, None, PERIOD_S).status == "too_few"


def test_a_flat_ring_keeps_its_identity_along_a_track(rng: np.random.Generator) -> None:
    unit = VisionUnit(ring(raised_m=0.0))
    near = [Truth(t.t * [1, 1, 0.4], t.turn + np.array([0.3, 0.0, 0.0])) for t in map(flight, range(20))]
    first = unit.solve_spots(*spots_of(unit.geometry, near[0], rng), 0.0, near[0].prediction(rng))
    assert first.status == "ok"
    for k in range(1, 20):
        solution = unit.solve_spots(*spots_of(unit.geometry, near[k], rng, decoys=1), PERIOD_S * k)
        assert solution.status == "ok"
        assert solution.pose is not None
        assert near[k].nees(solution.pose) < 40.0


def test_a_target_that_has_jumped_is_found_again(unit: VisionUnit, rng: np.random.Generator) -> None:
    for k in range(5):
        unit.solve_spots(*spots_of(unit.geometry, flight(k), rng), PERIOD_S * k)
    elsewhere = Truth(np.array([0.3, -0.2, 3.0]), np.array([-0.1, 0.2, -2.0]))
    solution = unit.solve_spots(*spots_of(unit.geometry, elsewhere, rng), PERIOD_S * 5)
    assert solution.pose is not None
    assert elsewhere.nees(solution.pose) < 40.0
    assert unit.track.poses == 1


def test_a_track_on_the_wrong_leds_is_given_up(rng: np.random.Generator) -> None:
    """A flat ring locked 60 deg off remains so; one raised LED reveals it at once."""
    unit = VisionUnit(ring())
    truth = Truth(np.array([0.1, 0.0, 3.0]), np.array([0.0, 0.0, 0.2]))
    off = Truth(truth.t, truth.turn + np.array([0.0, 0.0, np.radians(60.0)]))
    solution = unit.solve_spots(*spots_of(unit.geometry, truth, rng), 0.0, off.prediction(rng, 0.01, 1.0))
    assert solution.pose is not None
    assert truth.nees(solution.pose) < 40.0


def test_a_track_that_fails_again_and_again_is_dropped(unit: VisionUnit, rng: np.random.Generator) -> None:
    for k in range(5):
        unit.solve_spots(*spots_of(unit.geometry, flight(k), rng), PERIOD_S * k)
    for k in range(5, 5 + unit.track.settings.most_failures):
        unit.solve_spots(*spots_of(unit.geometry, flight(k), rng, lit=(), decoys=6), PERIOD_S * k)
    assert unit.track.predict(9 * PERIOD_S) is None


def test_time_that_runs_backwards_begins_a_new_track(unit: VisionUnit, rng: np.random.Generator) -> None:
    for t_s in (5.0, 5.16, 1.0):
        solution = unit.solve_spots(*spots_of(unit.geometry, flight(0), rng), t_s)
        assert solution.status == "ok"
    assert unit.track.poses == 1


def test_a_flat_ring_keeps_its_identity_while_its_tilt_is_open(rng: np.random.Generator) -> None:
    """Head-on from afar a frame has a position alone; close by the tilt shows, and the LEDs are still the same."""
    unit, said = VisionUnit(ring(raised_m=0.0)), []
    for k in range(45):
        truth = Truth(np.array([0.1, 0.01, 8.0 - 0.14 * k]), np.array([0.01, 0.02, 0.3 + 0.005 * k]))
        begin = truth.prediction(rng) if k == 0 else None
        solution = unit.solve_spots(*spots_of(unit.geometry, truth, rng, decoys=1), PERIOD_S * k, begin)
        said.append(solution.status)
        if solution.pose is not None:
            assert truth.nees(solution.pose) < 40.0
        else:
            assert (np.abs(solution.t - truth.t) < 4.5 * np.sqrt(np.diag(solution.covariance)[:3])).all()
    assert set(said[:10]) == {"ok_position"}
    assert set(said[-5:]) == {"ok"}


def test_solution_has_translation_rotation_and_covariance_or_nan(rng: np.random.Generator, tmp_path: Path) -> None:
    (tmp_path / "vmu.json").write_text(ring().model_dump_json(exclude_none=True))
    unit = VisionUnit(tmp_path / "vmu.json")
    assert unit.geometry == ring()
    truth = flight(0)
    found = unit.solve_spots(*spots_of(unit.geometry, truth, rng), 0.0)
    assert found.status == "ok"
    sigma = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.t - truth.t) < 4.0 * sigma[:3]).all()
    error = Rotation.from_matrix(found.R) * Rotation.from_rotvec(truth.turn).inv()
    assert (np.abs(error.as_rotvec()) < 4.0 * sigma[3:]).all()
    none = VisionUnit(ring()).solve(None, None, 0.0)
    assert [np.isnan(part).all() for part in (none.t, none.R, none.covariance)] == [True] * 3
    assert [part.shape for part in (none.t, none.R, none.covariance)] == [(3,), (3, 3), (6, 6)]


def test_a_jump_off_a_long_track_is_ambiguous_until_it_has_come_three_times(
    unit: VisionUnit, rng: np.random.Generator
) -> None:
    long = unit.track.settings.mature + 2
    for k in range(long):
        assert unit.solve_spots(*spots_of(unit.geometry, flight(k), rng), PERIOD_S * k).status == "ok"
    elsewhere = Truth(flight(long).t, flight(long).turn + np.array([0.0, 0.0, np.radians(60.0)]))
    once = unit.solve_spots(*spots_of(unit.geometry, elsewhere, rng), PERIOD_S * long)
    assert once.status == "ambiguous"
    assert once.pose is None
    back = unit.solve_spots(*spots_of(unit.geometry, flight(long + 1), rng), PERIOD_S * (long + 1))
    assert back.status == "ok"
    said = [
        unit.solve_spots(*spots_of(unit.geometry, elsewhere, rng), PERIOD_S * (long + 2 + k)).status for k in range(3)
    ]
    assert said == ["ambiguous", "ambiguous", "ok"]
