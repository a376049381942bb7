"""Hand-eye calibration: mounting of the camera on the turntable and of the target in the lab, in closed form.

``R_vt = A_vc A_ch B`` for every view: the rotation between two views has the same angle on both sides, and its axis
is rotated by A_vc (Park and Martin, 1994). The positions then follow linearly.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from hil.core.messages import Array
from hil.vmu.calibration.model import orthonormal

_WEAK = 1e-3  # weight of the rig file's values, for what the views leave open
_FAR = 5.0  # times the median


@dataclass(frozen=True, slots=True)
class HandEye:
    """camera_axes: A_vc. target_axes: B = A_th.T. arm: (3,), rotation centre to camera, in c. position: (3,), in H.

    good: (n,), which views are consistent.
    """

    camera_axes: Array
    target_axes: Array
    arm: Array
    position: Array
    good: Array


def hand_eye(
    rotations: Array, positions: Array, gimbals: Array, rails: Array, camera_axes: Array, arm: Array
) -> HandEye:
    """Return the mounting that fits the poses best; inconsistent views are excluded.

    rotations: (n, 3, 3), R_vt. positions: (n, 3), t_v, m. gimbals: (n, 3, 3), A_ch. rails: (n, 3), m.
    camera_axes, arm: nominal mounting; used only for what the views leave open.
    """
    good = np.ones(len(rotations), dtype=bool)
    while True:
        chosen = np.flatnonzero(good)
        solution = _closed_form(rotations[chosen], positions[chosen], gimbals[chosen], rails[chosen], camera_axes, arm)
        expected = solution[0] @ gimbals @ solution[1]
        angle = Rotation.from_matrix(rotations @ expected.transpose(0, 2, 1)).magnitude()
        at = (solution[3] - rails)[:, None, :] @ gimbals.transpose(0, 2, 1)
        distance = np.linalg.norm((at[:, 0] - solution[2]) @ solution[0].T - positions, axis=1)
        off = np.maximum(angle / _usual(angle[good], 5e-4), distance / _usual(distance[good], 5e-4))
        worst = int(np.argmax(np.where(good, off, 0.0)))
        if off[worst] < _FAR or good.sum() <= max(3, 2 * len(rotations) // 3):
            return HandEye(*solution, good)
        good[worst] = False


def _usual(values: Array, least: float) -> float:
    return max(float(np.median(values)), least)


def _closed_form(
    rotations: Array, positions: Array, gimbals: Array, rails: Array, camera_axes: Array, arm: Array
) -> tuple[Array, Array, Array, Array]:
    observed, made = [*(_WEAK * camera_axes.T)], [*(_WEAK * np.eye(3))]
    for i, j in combinations(range(len(rotations)), 2):
        observed.append(Rotation.from_matrix(rotations[i] @ rotations[j].T).as_rotvec())
        made.append(Rotation.from_matrix(gimbals[i] @ gimbals[j].T).as_rotvec())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # all axes parallel: the weak prior decides
        a_vc = Rotation.align_vectors(np.array(observed), np.array(made))[0].as_matrix()
    b = orthonormal(np.sum(gimbals.transpose(0, 2, 1) @ a_vc.T @ rotations, axis=0))
    # A_vc.T t_v + A_ch rails = A_ch position - arm
    n = len(rotations)
    left = np.zeros((3 * n + 3, 6))
    right = np.zeros(3 * n + 3)
    left[: 3 * n, :3] = gimbals.reshape(-1, 3)
    left[: 3 * n, 3:] = np.tile(-np.eye(3), (n, 1))
    right[: 3 * n] = (positions @ a_vc + np.einsum("nab,nb->na", gimbals, rails)).ravel()
    left[3 * n :, 3:] = _WEAK * np.eye(3)
    right[3 * n :] = _WEAK * arm
    solution: Array = np.linalg.lstsq(left, right, rcond=None)[0].astype(float)
    return a_vc, b, solution[3:], solution[:3]
