"""PoseObservations that a machine with given parameters predicts, and their slopes by the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.bench.kinematics import BENCH_PARAMS
from hil.bench.machine_poses import camera_poses_of_machines, poses_of_machines
from hil.config.rig import Rig
from hil.config.tables.machine import PARAMETERS
from hil.core.messages import Array
from hil.maths import quat
from hil.params.bench import bench, set_geometry
from hil.params.bench_budget import STEP, machines_about
from hil.sensors.mounting import MOUNTING
from hil.sensors.vision_unit.parameters import mounting_of

STEP_S: Final = 0.02
"""Period of a cycle, on which the geometry does not depend."""


@dataclass(frozen=True)
class Predicted:
    """Poses (n, 3), m, and (n, 4) of n observations, and their slopes by the parameters, (n, 6, PARAMETERS)."""

    r: Array
    q: Array
    slopes: Array

    def residuals(self, value: Array) -> Array:
        """Return observed less predicted poses, (n, 6): m, and the rotation from the predicted one, rad.

        value: (n, 6), observed positions, m, and rotation vectors, rad.
        """
        observed = np.array([quat.from_rotation_vector(phi) for phi in value[:, 3:]]).reshape(-1, 4)
        return np.hstack([value[:, :3] - self.r, rotations_between(observed, self.q)])


class MachineModel:
    """Prediction of the observations of a rig."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig

    def predict(self, vector: Array, axes: Array, source: np.ndarray) -> Predicted:
        """Return what a machine with ``vector`` (PARAMETERS,), m and rad, shows at encoders (n, 6) to each source."""
        vectors = np.vstack([vector, vector + STEP * np.eye(PARAMETERS)])
        r, q = self._poses(machines_about(self.rig, STEP_S, vector), vectors, axes, source == "vmu")
        turned = rotations_between(q[1:], np.broadcast_to(q[0], q[1:].shape))
        slopes = np.concatenate([r[1:] - r[0], turned], axis=2) / STEP
        return Predicted(r[0], q[0], slopes.transpose(1, 2, 0))

    def observed(self, vector: Array, axes: Array, source: str) -> Array:
        """Return the observations, (n, 6): m and rotation vectors, rad, without noise."""
        machine = np.zeros(1, BENCH_PARAMS).view(np.recarray)
        machine[0] = bench(self.rig, STEP_S)
        set_geometry(machine[0], self.rig, vector)
        r, q = self._poses(machine, vector[None], axes, np.full(len(axes), source == "vmu"))
        return np.hstack([r[0], [quat.to_rotation_vector(each) for each in q[0]]])

    def _poses(self, machines: np.ndarray, vectors: Array, axes: Array, by_camera: np.ndarray) -> tuple[Array, Array]:
        """Return the poses (m, n, 3), m, and (m, n, 4) of ``machines`` (m,) with ``vectors``; by_camera: mask (n,)."""
        m, n, rails, gimbals = len(vectors), len(axes), axes[:, :3].copy(), axes[:, 3:].copy()
        r, q = np.empty((m, n, 3)), np.empty((m, n, 4))
        poses_of_machines(machines, rails, gimbals, r, q)
        if by_camera.any():
            mountings, r_v, q_v = np.zeros(m, MOUNTING).view(np.recarray), np.empty_like(r), np.empty_like(q)
            for k, vector in enumerate(vectors):
                mountings[k] = mounting_of(self.rig, vector)
            camera_poses_of_machines(machines, mountings, rails, gimbals, r_v, q_v)
            r[:, by_camera], q[:, by_camera] = r_v[:, by_camera], q_v[:, by_camera]
        return r, q


def rotations_between(p: Array, q: Array) -> Array:
    """Return the rotation vectors (..., 3), rad, from frames ``q`` to frames ``p`` (..., 4)."""
    sign = np.array([-1.0, -1.0, -1.0, 1.0])
    b = q * sign
    vector = p[..., 3:] * b[..., :3] + b[..., 3:] * p[..., :3] - np.cross(p[..., :3], b[..., :3])
    scalar = p[..., 3] * b[..., 3] - (p[..., :3] * b[..., :3]).sum(axis=-1)
    sine = np.linalg.norm(vector, axis=-1)
    angle = 2.0 * np.arctan2(sine, np.abs(scalar)) * np.where(scalar < 0.0, -1.0, 1.0)
    factor = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)
    rotated: Array = vector * factor[..., None]
    return rotated


def with_noise(predicted: Array, sigma: Array, rng: np.random.Generator) -> Array:
    """Return observations (n, 6) with white noise ``sigma`` (n, 6): of position, m, and a small rotation, rad."""
    noise = sigma * rng.standard_normal(sigma.shape)
    rotated = [
        quat.to_rotation_vector(quat.multiply(quat.from_rotation_vector(e), quat.from_rotation_vector(phi)))
        for e, phi in zip(noise[:, 3:], predicted[:, 3:], strict=True)
    ]
    return np.hstack([predicted[:, :3] + noise[:, :3], rotated])
