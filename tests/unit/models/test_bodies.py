"""Distance that braking leaves between convex bodies."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from hil.config.tables.guard import BenchBody, SpacecraftBody
from hil.maths import quat
from hil.models.bodies import CLOSING, DISTANCE, PAIR, STOPPING, WHICH, clearance
from hil.params.bench import bodies

BOX = tuple(product((-0.1, 0.1), (-0.2, 0.2), (-0.3, 0.3)))
SPHERE = SpacecraftBody(on="target", vertices_m=((0.0, 0.0, 0.0),), radius_m=0.5)
NO_TURN = np.array([0.0, 0.0, 0.0, 1.0])


def left(
    moving: tuple[SpacecraftBody | BenchBody, ...],
    r: tuple[float, float, float],
    *,
    q: np.ndarray = NO_TURN,
    v: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rate: float = 0.0,
    enough: float = 100.0,
) -> tuple[float, np.ndarray]:
    """Return the clearance of ``moving`` from SPHERE and what was found; reaction 0.5 s, 0.1 m/s^2, 0.2 rad/s^2."""
    found = np.full(4, np.nan)
    given = (SPHERE, *moving)
    here, there = bodies(given, "chaser"), bodies(given, "target")
    distance = clearance(
        here, np.array(r), q, np.array(v), rate, there, 0.5, 0.1, 0.2, enough, found
    )  # fmt: skip
    return float(distance), found


def rod(length_m: float = 1.0) -> SpacecraftBody:
    return SpacecraftBody(on="chaser", vertices_m=((0.0, 0.0, 0.0), (-length_m, 0.0, 0.0)), radius_m=0.05)


def test_box_and_sphere_at_rest_are_apart_by_their_surfaces() -> None:
    box = SpacecraftBody(on="chaser", vertices_m=BOX)
    distance, found = left((box,), (2.0, 0.1, 0.1))
    assert distance == pytest.approx(2.0 - 0.1 - 0.5)
    assert (found[WHICH], found[DISTANCE]) == (PAIR * 2 + 1, distance)
    turned = quat.from_rotation_vector(np.array([0.0, 0.0, math.pi / 2]))
    assert left((box,), (2.0, 0.0, 0.0), q=turned)[0] == pytest.approx(2.0 - 0.2 - 0.5)


def test_rod_widened_by_a_radius_turns_with_the_chaser() -> None:
    assert left((rod(),), (3.0, 0.0, 0.0))[0] == pytest.approx(3.0 - 1.0 - 0.05 - 0.5)
    half_turn = quat.from_rotation_vector(np.array([0.0, 0.0, math.pi]))
    assert left((rod(),), (3.0, 0.0, 0.0), q=half_turn)[0] == pytest.approx(3.0 - 0.05 - 0.5)


def test_closing_rate_and_rotation_take_the_way_until_rest() -> None:
    way = 0.2 * 0.5 + 0.2**2 / (2.0 * 0.1)
    distance, found = left((rod(),), (3.0, 0.0, 0.0), v=(-0.2, 0.3, 0.0))
    assert distance == pytest.approx(1.45 - way)
    assert (found[CLOSING], found[STOPPING]) == pytest.approx((0.2, way))
    assert left((rod(),), (3.0, 0.0, 0.0), v=(0.2, 0.0, 0.0))[0] == pytest.approx(1.45)
    angle = 0.1 * 0.5 + 0.1**2 / (2.0 * 0.2)
    assert left((rod(),), (3.0, 0.0, 0.0), rate=0.1)[0] == pytest.approx(1.45 - 1.05 * angle)


def test_far_bodies_are_enough() -> None:
    assert left((rod(),), (3.0, 0.0, 0.0), enough=1.4)[0] == 1.4
    assert left((rod(),), (3.0, 0.0, 0.0), enough=1.5)[0] == pytest.approx(1.45)


def test_nearest_of_several_bodies_counts() -> None:
    distance, found = left((rod(0.3), rod(1.2), rod(0.7)), (3.0, 0.0, 0.0))
    assert distance == pytest.approx(3.0 - 1.25 - 0.5)
    assert found[WHICH] == PAIR * 3 + 1


def test_bodies_that_meet_or_are_at_no_number_are_never_far() -> None:
    assert left((rod(),), (1.0, 0.0, 0.0))[0] <= 0.0
    assert not left((rod(),), (math.nan, 0.0, 0.0))[0] >= 0.05
