"""Comparison of a tracker with encoders along a path of the axes: times, rejected samples, displacements."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.params import bench as bench_params
from hil.parts.tracker.comparison import BenchComparison, Deviation
from hil.parts.tracker.encoder_poses import EncoderPoses, pose_of
from hil.parts.tracker.mock import MockTracker
from hil.parts.tracker.table import Tracker

STEP_S = 0.02
BODIES: dict[str, dict[str, Any]] = {
          "chaser": {"body": 1, "position_m": [0.1, -0.05, 0.2], "rotation_deg": [10.0, -20.0, 30.0]},
          "target": {"body": 2, "rotation_deg": [0.0, 0.0, 90.0]}, "reference": {"body": 3}}  # fmt: skip
NAMES = ("rails.x", "rails.y", "rails.z", "turntable.roll", "turntable.pitch", "turntable.yaw")


def path(t_s: float) -> np.ndarray:
    """Return rails, m, and gimbals, rad, of an approach with turns, (6,)."""
    swing = math.sin(0.3 * t_s), math.sin(0.5 * t_s + 1.0), math.cos(0.4 * t_s)
    rails = -4.0 + 0.04 * t_s + 0.05 * swing[0], 0.2 * swing[1], 0.1 * swing[2]
    return np.array([*rails, 0.1 * swing[2], 0.05 * swing[0], 0.1 * swing[1]])


def _table(**keys: Any) -> Tracker:
    return Tracker.model_validate({"driver": "mock", "rate_hz": 50.0, **BODIES, **keys}, strict=False)


class Flight:
    """Comparison over the path. found: deviations by time, in steps of a tenth of a second.

    assumed: keys of the table of the comparison that are other than those of the tracker.
    """

    def __init__(self, duration_s: float, seed: int = 0, assumed: dict[str, Any] | None = None, **keys: Any) -> None:
        table = _table(**keys)
        bench = bench_params.bench(load_rig("mock").value, STEP_S)
        self.comparison = BenchComparison(_table(**keys, **(assumed or {})), EncoderPoses(bench, STEP_S))
        mock = MockTracker(table, seed, lambda t_s: pose_of(bench, path(t_s)))
        self.found: list[tuple[float, dict[str, Deviation]]] = []
        waiting = []
        for k in range(round(duration_s / STEP_S)):
            now_s = STEP_S * k
            self.comparison.encoders.add(now_s, path(now_s))
            waiting += [(self.comparison.moment_of(frame), frame) for frame in mock.poll(now_s)]
            while waiting and self.comparison.is_due(*waiting[0]):
                t_s, frame = waiting.pop(0)
                self.comparison.compare(frame, t_s)
            if k % 5 == 0:
                self.found.append((now_s, self.comparison.deviations(self.comparison.last_s)))

    def first_beyond(self, *roles: str) -> float | None:
        """Return the time at which a body of ``roles`` was first beyond its bound, None if none ever was."""
        beyond = (t for t, found in self.found if any(found[r].excess > 1.0 for r in roles if r in found))
        return next(beyond, None)

    def cause(self) -> str:
        """Return the cause of the last deviations."""
        return self.comparison.cause(self.found[-1][1], NAMES)


@pytest.mark.parametrize(("latency_s", "seed"), [(0.0, 0), (0.005, 1), (0.02, 2)])
def test_latency_is_found_within_half_a_millisecond_whatever_the_clock(latency_s: float, seed: int) -> None:
    flown = Flight(45.0, seed, latency_s=latency_s, clock_offset_s=-1e3, clock_scale=1.00004)
    assert flown.comparison.latency.value_s == pytest.approx(latency_s, abs=5e-4)
    assert flown.comparison.clock.numbers()["clock_drift_ppb"] == pytest.approx(40_000, abs=2000)
    assert flown.first_beyond("chaser", "target") is None


def test_error_of_geometry_is_not_taken_for_latency() -> None:
    mounted = BODIES["chaser"] | {"position_m": [0.1007, -0.05, 0.2], "rotation_deg": [10.0, -20.04, 30.0]}
    flown = Flight(45.0, latency_s=0.005, assumed={"chaser": mounted})
    assert flown.comparison.latency.value_s == pytest.approx(0.005, abs=5e-4)


def test_mounting_that_is_wrong_by_more_than_its_bound_is_found_at_once() -> None:
    mounted = BODIES["chaser"] | {"position_m": [0.115, -0.05, 0.2]}
    found_s = Flight(5.0, assumed={"chaser": mounted}).first_beyond("chaser")
    assert found_s is not None
    assert found_s < 2.0  # as soon as the frame is known


@pytest.mark.parametrize(
    ("kind", "count"), [("swapped", "swapped"), ("lost", "lost"), ("no_pose", "lost"), ("frozen", "frozen")]
)
def test_samples_that_show_nothing_are_rejected_and_raise_nothing(kind: str, count: str) -> None:
    flown = Flight(15.0, faults=[{"kind": kind, "at_s": 8.0, "until_s": 9.0}])
    assert flown.first_beyond("chaser", "target") is None
    assert 45 <= flown.comparison.counts[count] <= 51
    assert flown.comparison.last_s > 14.9


def test_clock_that_jumps_is_followed_and_raises_nothing() -> None:
    for jump_s in (-0.5, 0.5):
        flown = Flight(20.0, faults=[{"kind": "clock_jump", "at_s": 10.0, "value": jump_s}])
        assert flown.first_beyond("chaser", "target") is None
        assert flown.comparison.last_s > 19.9
        assert flown.comparison.counts["old"] > 10


@pytest.mark.parametrize("axis", range(3))
def test_base_that_moves_by_three_millimetres_is_found_within_two_seconds(axis: int) -> None:
    moved = [0.003 * (i == axis) for i in range(3)]
    flown = Flight(22.5, seed=axis, faults=[{"kind": "moved", "at_s": 20.0, "value": moved}])
    found_s = flown.first_beyond("chaser")
    assert found_s is not None
    assert 20.0 < found_s <= 22.0
    assert flown.first_beyond("target", "reference") is None
    name, _, error = flown.cause().partition(" or its base: ")
    assert name == NAMES[axis]
    assert float(error.partition(" mm")[0]) == pytest.approx(3.0, abs=0.6)


@pytest.mark.parametrize(
    ("of", "reference", "cause"),
    [
        ("tracker", True, "the tracker has moved"),
        ("bench", True, "the base of the bench has moved"),
        ("tracker", False, "(see tracker.reference)"),
        ("target", True, "the target has moved"),
    ],
)
def test_what_has_moved_is_distinguished(of: str, reference: bool, cause: str) -> None:
    keys: dict[str, Any] = {} if reference else {"reference": None}
    flown = Flight(23.0, faults=[{"kind": "moved", "of": of, "at_s": 20.0, "value": [0.0, 0.002, 0.002]}], **keys)
    assert flown.first_beyond("chaser", "target") is not None
    assert cause in flown.cause()


def test_chaser_that_is_rotated_is_found_and_its_gimbal_named() -> None:
    flown = Flight(23.0, faults=[{"kind": "rotated", "at_s": 20.0, "value": [0.0, 0.0, 0.4]}])
    assert flown.first_beyond("chaser") is not None
    assert "turntable.yaw" in flown.cause()


def test_displacement_beyond_the_gate_is_found_too() -> None:
    flown = Flight(23.0, faults=[{"kind": "moved", "at_s": 20.0, "value": [0.2, 0.0, 0.0]}])
    found_s = flown.first_beyond("chaser")
    assert found_s is not None
    assert found_s <= 22.0
    assert flown.comparison.counts["outlier"] > 20


def test_wrong_tables_are_refused() -> None:
    for keys, text in (
        ({"target": None}, "needed to measure the tracker's frame"),
        ({"target": {"body": 1}}, "must differ"),
        ({"driver": "natnet", "chaser": {"body": "one"}}, "streaming IDs"),
        ({"driver": "qtm"}, "names of bodies"),
        ({"faults": [{"kind": "moved", "at_s": 1.0}]}, "needs value"),
        ({"faults": [{"kind": "lost", "at_s": 1.0, "of": "bench"}]}, "lost takes chaser, target, reference"),
        ({"faults": [{"kind": "drift", "at_s": 1.0}]}, "a tracker has no_pose"),
    ):
        with pytest.raises(ValueError, match=text):
            _table(**keys)


def test_base_that_moves_along_no_axis_is_stated_by_its_displacement() -> None:
    flown = Flight(23.0, faults=[{"kind": "moved", "at_s": 20.0, "value": [0.002, -0.002, 0.002]}])
    assert "the base of the rails, or the geometry, off by +" in flown.cause()
