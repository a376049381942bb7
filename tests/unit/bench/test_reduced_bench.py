"""Benches with fixed axes, and with L not parallel to H."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.bench.bench_guard import BENCH_GUARD_MEMORY, check_bench
from hil.bench.guard import NOTHING
from hil.bench.keep_out import BREACH
from hil.bench.kinematics import BENCH_PARAMS, axes_of_pose, pose_of_axes, unseen
from hil.config.load import load_rig, load_scenario
from hil.core.messages import AXES, TRUTH, new
from hil.params import bench as bench_params
from tests.support.lab_benches import BENCHES, rig_file

ORDERS = list(permutations(range(3)))


def bench(
    order: tuple[int, ...] = (2, 1, 0), fixed: tuple[int, ...] = (0,) * 6, lab: Rotation | None = None
) -> np.record:
    """Return BENCH_PARAMS; fixed axes have the position 0.1 m or rad."""
    params = new(BENCH_PARAMS)
    params.dt_s, params.lever_arm, params.order = 0.02, (0.1, -0.2, 0.35), order
    params.low, params.high = [0.1 if f else -3.0 for f in fixed], [0.1 if f else 3.0 for f in fixed]
    params.rate_max, params.acceleration_max = [0.5] * 6, [0.6] * 6
    params.reduced, params.fixed = 1, fixed
    params.q_HL = (lab or Rotation.identity()).as_quat()
    return params


def axes_at(params: np.record, r: np.ndarray, v: np.ndarray, q: np.ndarray, w: np.ndarray) -> np.record:
    axes = new(AXES)
    axes_of_pose(params, r, v, q, w, axes)
    return axes


def pose_at(params: np.record, rail_m: np.ndarray, gimbal_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r, q = np.empty(3), np.empty(4)
    pose_of_axes(params, rail_m, gimbal_rad, r, q)
    return r, q


@pytest.mark.parametrize("order", ORDERS)
def test_axes_show_the_pose_that_they_give(order: tuple[int, ...], rng: np.random.Generator) -> None:
    for _ in range(20):
        fixed = tuple(rng.integers(0, 2, 6).tolist())
        params = bench(order, fixed, Rotation.random(random_state=rng))
        given = np.where(fixed, 0.1, rng.uniform(-1.2, 1.2, 6))
        r, q = pose_at(params, given[:3], given[3:])
        axes = axes_at(params, r, np.zeros(3), q, np.zeros(3))
        np.testing.assert_allclose([*axes.rail_m, *axes.gimbal_rad], given, atol=1e-9)
        left_out = np.empty((1, 6))
        unseen(params, r[None], q[None], new(AXES), left_out)
        np.testing.assert_allclose(left_out, 0.0, atol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
def test_rates_are_the_derivatives_of_the_positions(order: tuple[int, ...], rng: np.random.Generator) -> None:
    h = 1e-6
    for _ in range(10):
        fixed = tuple(rng.integers(0, 2, 6).tolist())
        lab = Rotation.random(random_state=rng)
        params = bench(order, fixed, lab)
        in_lab = Rotation.from_euler("".join("XYZ"[a] for a in order), rng.uniform(-1.2, 1.2, 3))
        start = lab.inv() * in_lab  # as in ``quat``: the inverse rotation transforms
        r, v, w = rng.standard_normal((3, 3))
        axes = axes_at(params, r, v, start.as_quat(), w)
        ends = [axes_at(params, r + s * v, v, (start * Rotation.from_rotvec(s * w)).as_quat(), w) for s in (-h, h)]
        np.testing.assert_allclose(axes.rail_mps, (ends[1].rail_m - ends[0].rail_m) / (2 * h), atol=1e-7)
        slope = (ends[1].gimbal_rad - ends[0].gimbal_rad) / (2 * h)
        np.testing.assert_allclose(axes.gimbal_radps, slope, rtol=1e-6, atol=1e-7)
        assert all(axes.rail_m[i] == 0.1 and axes.rail_mps[i] == 0.0 for i in range(3) if fixed[i])


def test_motion_along_a_fixed_axis_is_unseen() -> None:
    params, q = bench(fixed=(0, 0, 1, 0, 0, 0)), np.array([0.0, 0.0, 0.0, 1.0])
    left_out = np.empty((1, 6))
    shown, _ = pose_at(params, np.array([3.0, 0.0, 0.1]), np.zeros(3))
    unseen(params, (shown + np.array([0.0, 0.0, 0.1]))[None], q[None], new(AXES), left_out)
    np.testing.assert_allclose(left_out[0], [0.0, 0.0, 0.1, 0.0, 0.0, 0.0], atol=1e-12)


def test_guard_asks_for_what_the_axes_can_show() -> None:
    scenario, rig = load_scenario("scheme-1").value, load_rig("mock", ["rig.rails.z.fixed_m=0.0"]).value
    guard, params = bench_params.bench_guard(rig, scenario), bench_params.bench(rig, scenario.step_s)
    memory, truth, breach = new(BENCH_GUARD_MEMORY), new(TRUTH), new(BREACH)
    truth.r_CT_H, truth.q_CH = [3.0, 0.0, 0.2], [0.0, 0.0, 0.0, 1.0]  # 0.2 m and more along the axis that stands
    wanted = axes_at(params, truth.r_CT_H, np.zeros(3), truth.q_CH, np.zeros(3))
    behind = wanted.copy()
    behind.rail_m[0] += 0.1
    for cycle in range(200):
        t_s = 0.02 * cycle
        assert check_bench(guard, params, memory, t_s, truth, wanted, wanted, 0.0, 0.0, 0, breach) == NOTHING
    causes = [
        check_bench(guard, params, memory, 4.0 + 0.02 * k, truth, wanted, behind, 0.0, 0.0, 0, breach)
        for k in range(10)
    ]
    assert any(cause != NOTHING for cause in causes)


@pytest.mark.parametrize("name", BENCHES)
def test_bench_of_a_rig_file_shows_its_own_poses(name: str, tmp_path: Path, rng: np.random.Generator) -> None:
    rig = load_rig(rig_file(tmp_path, name)).value
    params = bench_params.bench(rig, 0.02)
    given = rng.uniform(0.3, 0.7, 6) * (params.high - params.low) + params.low
    r, q = pose_at(params, given[:3], given[3:])
    axes = axes_at(params, r, np.zeros(3), q, np.zeros(3))
    np.testing.assert_allclose([*axes.rail_m, *axes.gimbal_rad], given, atol=1e-9)
    lab = np.array(rig.bench.lab_axes)
    moved, _ = pose_at(params, given[:3] + np.array([0.0, 0.1, 0.0]), given[3:])
    np.testing.assert_allclose(moved - r, 0.1 * lab[1], atol=1e-12)
