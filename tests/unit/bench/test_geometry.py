"""A bench with errors of its geometry: against the same machine as a chain of frames, and its compensation."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.bench.kinematics import axes_of_pose, pose_on_bench
from hil.config.rig import Rig
from hil.config.tables.machine import NAMES, PARAMETERS, ROTATIONS, parts_of
from hil.core.messages import AXES, Array, new
from hil.maths import quat
from hil.params.bench import bench, set_geometry
from tests.support.machine import axes_within, twelve_errors

STEP_S = 0.02


def machine(rig: Rig, vector: Array) -> np.record:
    """Return BENCH_PARAMS of ``rig`` with the errors ``vector``."""
    params = bench(rig, STEP_S)
    set_geometry(params, rig, vector)
    return params


def pose_of(params: np.record, axes: Array) -> tuple[Array, Array]:
    r, q = np.empty(3), np.empty(4)
    pose_on_bench(params, axes[:3], axes[3:], r, q)
    return r, quat.to_matrix(q).T


def axes_for(params: np.record, r: Array, r_hc: Array, earlier: Array | None = None) -> Array:
    axes, rest = new(AXES), np.zeros(3)
    if earlier is not None:
        axes.rail_m, axes.gimbal_rad = earlier[:3], earlier[3:]
    axes_of_pose(params, r, rest, quat.from_matrix(r_hc.T.copy()), rest, axes)
    return np.concatenate([axes.rail_m, axes.gimbal_rad])


def chain(rig: Rig, vector: Array, axes: Array) -> tuple[Array, Array]:
    """Return position, m, and axes of c in L of the machine as a chain of exact frames, rails x y z from the floor."""
    of = parts_of(vector)
    turn = Rotation.from_rotvec(of["base_deg"]).as_matrix()
    r = of["base_m"].copy()
    s = of["squareness_deg"]
    directions = np.array([[1.0, 0.0, 0.0], [-s[0], 1.0, 0.0], [-s[2], -s[1], 1.0]])
    for i, name in enumerate("xyz"):
        low, high = rig.rails.axes[i].limits[:2]
        t = (axes[i] - 0.5 * (low + high)) / (0.5 * (high - low))
        p = np.array([np.polynomial.legendre.Legendre.basis(n)(t) for n in (1, 2, 3)])
        shift = np.zeros(3)
        shift[i] = of[f"{name}_position_m"] @ p
        for k, axis in enumerate(axis for axis in range(3) if axis != i):
            shift[axis] = of[f"{name}_straightness_m"][2 * k : 2 * k + 2] @ p[1:]
        r = r + turn @ (directions[i] * axes[i] + shift)
        turn = turn @ Rotation.from_rotvec(of[f"{name}_rotation_deg"].reshape(3, 3) @ p).as_matrix()
    x, y, z = np.eye(3)  # gimbals yaw, pitch, roll
    turn = turn @ Rotation.from_rotvec(of["turntable_deg"]).as_matrix()
    turn = turn @ Rotation.from_rotvec(z * axes[5]).as_matrix()
    r = r + turn @ (x * of["middle_m"][0])
    turn = turn @ Rotation.from_rotvec(x * of["middle_deg"][0]).as_matrix()
    turn = turn @ Rotation.from_rotvec(y * (axes[4] + of["middle_deg"][1])).as_matrix()
    r = r + turn @ (z * of["inner_m"][0] + y * of["inner_m"][1])
    turn = turn @ Rotation.from_rotvec(z * of["inner_deg"][0]).as_matrix()
    turn = turn @ Rotation.from_rotvec(x * axes[3]).as_matrix()
    turn = turn @ Rotation.from_rotvec(of["reference_deg"]).as_matrix()
    return r + turn @ (np.array(rig.bench.lever_arm_m) + of["reference_m"]), turn


def angle(a: Array, b: Array) -> float:
    return float(np.linalg.norm(Rotation.from_matrix(a.T @ b).as_rotvec()))


@pytest.mark.parametrize("k", range(PARAMETERS), ids=NAMES)
def test_each_error_of_the_machine_acts_as_in_a_chain_of_frames(mock_rig: Rig, k: int) -> None:
    vector = np.zeros(PARAMETERS)
    vector[k] = np.radians(0.05) if ROTATIONS[k] else 1e-3
    params = machine(mock_rig, vector)
    for axes in axes_within(mock_rig, 12, k):
        (r, turn), (r_chain, turn_chain) = pose_of(params, axes), chain(mock_rig, vector, axes)
        assert np.abs(r - r_chain).max() < 5e-6
        assert angle(turn, turn_chain) < 1e-6


def test_several_errors_at_once_are_off_by_their_products_alone(mock_rig: Rig) -> None:
    vector = twelve_errors(1)
    params = machine(mock_rig, vector)
    for axes in axes_within(mock_rig, 50, 2):
        (r, turn), (r_chain, turn_chain) = pose_of(params, axes), chain(mock_rig, vector, axes)
        assert np.abs(r - r_chain).max() < 2e-5
        assert angle(turn, turn_chain) < 4e-6


def test_a_machine_without_errors_is_the_ideal_one(mock_rig: Rig) -> None:
    ideal, params = bench(mock_rig, STEP_S), machine(mock_rig, np.zeros(PARAMETERS))
    assert not ideal.geometry.enabled
    for axes in axes_within(mock_rig, 20, 3):
        (r, turn), (r_ideal, turn_ideal) = pose_of(params, axes), pose_of(ideal, axes)
        assert np.abs(r - r_ideal).max() < 1e-14
        assert np.abs(turn - turn_ideal).max() < 1e-14
        assert np.abs(axes_for(params, r, turn) - axes).max() < 1e-13


@pytest.mark.parametrize("size", [0.1, 1.0, 20.0])
def test_compensated_axes_show_the_pose(mock_rig: Rig, size: float) -> None:
    params = machine(mock_rig, size * twelve_errors(4))
    for axes in axes_within(mock_rig, 50, 5):
        r, turn = pose_of(bench(mock_rig, STEP_S), axes)
        shown, shown_turn = pose_of(params, axes_for(params, r, turn))
        assert np.abs(shown - r).max() < max(1.5e-5, 2.5e-6 * size)
        assert angle(shown_turn, turn) < max(1e-5, 1e-6 * size)


@pytest.mark.parametrize("off_m", [1e-3, 0.04, 5.0, np.nan])
def test_an_earlier_solution_leads_to_the_same_axes(mock_rig: Rig, off_m: float) -> None:
    params = machine(mock_rig, 3.0 * twelve_errors(4))
    for axes in axes_within(mock_rig, 50, 5):
        r, turn = pose_of(params, axes)
        assert np.abs(axes_for(params, r, turn, axes + off_m) - axes).max() < 2e-5


def test_zero_offsets_and_the_pose_of_the_rails_may_be_large(mock_rig: Rig) -> None:
    vector = np.zeros(PARAMETERS)
    for name, value in (
        ("base_m[0]", 0.05),
        ("base_deg[2]", 0.03),
        ("turntable_deg[2]", 0.05),
        ("middle_deg[1]", 0.04),
    ):
        vector[NAMES.index(name)] = value
    params = machine(mock_rig, vector)
    for axes in axes_within(mock_rig, 20, 6):
        (r, turn), (r_chain, turn_chain) = pose_of(params, axes), chain(mock_rig, vector, axes)
        assert np.abs(r - r_chain).max() < 1e-12
        assert angle(turn, turn_chain) < 1e-9
        assert np.abs(axes_for(params, r, turn) - axes).max() < 1e-9


def test_the_correction_is_smooth_along_a_path(mock_rig: Rig) -> None:
    params = machine(mock_rig, twelve_errors(7))
    path = np.linspace([2.0, -0.5, 0.3, -0.2, 0.1, 0.3], [4.0, 0.6, -0.4, 0.3, -0.2, -0.1], 400)
    off = []
    for axes in path:
        r, turn = pose_of(bench(mock_rig, STEP_S), axes)
        off.append(axes_for(params, r, turn) - axes)
    steps = np.array([b - a for a, b in pairwise(off)])
    assert np.abs(steps).max() < 3.0 * np.abs(steps).mean() + 2e-5
