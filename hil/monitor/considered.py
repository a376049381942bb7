"""Errors of camera and optics that the monitor does not estimate, in the covariance of its motion.

Every tolerance shifts all edges of a frame alike and is the same in all frames of a portion: it does not average out.
That of the tone curve is not among them: with a tolerance it is estimated (``kernels/pose.py``).
With the normal matrix ``N`` and the Jacobian ``J`` of a frame's edges, weights ``W`` and shifts ``B`` of the edges per
standard deviation of each tolerance, the error of the pose is ``N^-1 J.T W B``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.config.scene import CameraTolerances, SceneCamera
from hil.models import docking_view
from hil.monitor.kernels.edges import WHITE
from hil.monitor.kernels.pose import HALF_SCALE, UNKNOWNS, attitude_derivatives
from hil.monitor.results import FrameResult

Floats = NDArray[np.float64]


def pose_errors(
    camera: SceneCamera, samples: NDArray[np.void], pose: Floats, normal: Floats, prior: Floats
) -> Floats | None:
    """Return the errors of a frame's pose by one standard deviation of each tolerance, (9, k); None without any.

    samples: EDGE_SAMPLE in use. pose, normal, prior: as in FrameResult.
    """
    if camera.tolerances.model_copy(update={"tone_px": 0.0, "time_s": 0.0}) == CameraTolerances():
        return None
    jacobian = edge_jacobian(camera.f, samples, pose)
    right = jacobian.T @ (edge_shifts(camera, samples) / samples["variance"][:, None])
    found: Floats = np.linalg.solve(normal + np.diag(prior), right)
    return found


def edge_jacobian(f: float, samples: NDArray[np.void], pose: Floats) -> Floats:
    """Return the derivatives of the edges' shifts by the pose, (n, 9): d, m, phi, rad, growth and tone, px."""
    slopes = np.empty((3, 3, 3))
    a = docking_view.attitude(pose[3:6])
    attitude_derivatives(np.ascontiguousarray(pose[3:6]), slopes)
    arm = np.column_stack([samples[name] for name in ("y1", "y2", "y3")]) - pose[:3]
    x = arm @ a
    scale = f / x[:, 2]
    gradient = np.column_stack([samples["nu"] * scale, -samples["nv"] * scale, np.zeros(len(samples))])
    gradient[:, 2] = -(gradient[:, 0] * x[:, 0] + gradient[:, 1] * x[:, 1]) / x[:, 2]
    out = np.zeros((len(samples), UNKNOWNS))
    out[:, :3] = -gradient @ a.T
    for k in range(3):
        out[:, 3 + k] = (gradient * (arm @ slopes[k])).sum(axis=1)
    low, high = np.minimum(samples["low"], WHITE), np.minimum(samples["high"], WHITE)
    out[:, 6] = samples["grows"]
    out[:, 7] = samples["grows"] * (low - high) / HALF_SCALE
    out[:, 8] = out[:, 7] * (1.0 - 0.5 * (low + high) / HALF_SCALE)
    return out


def edge_shifts(camera: SceneCamera, samples: NDArray[np.void]) -> Floats:
    """Return the shifts of the edges, px, by one standard deviation of each tolerance, (n, 5)."""
    stated = camera.tolerances
    nu, nv = samples["nu"], samples["nv"]
    across, down = samples["u"] - camera.cx, samples["v"] - camera.cy
    outwards = nu * across + nv * down
    corner = 0.5 * float(np.hypot(camera.width, camera.height))
    cubic = outwards * (across**2 + down**2) / corner**3
    return np.column_stack(
        [
            stated.focal_fraction * outwards,
            stated.aspect_fraction * nv * down,
            stated.principal_point_px * nu,
            stated.principal_point_px * nv,
            stated.distortion_px * cubic,
        ]
    )


def motion_covariance(camera: SceneCamera, frames: Sequence[FrameResult], w: Floats, t_s: float) -> Floats:
    """Return the covariance (12, 12) of the motion ``w`` (12,) at ``t_s`` by the camera's tolerances."""
    out = np.zeros((12, 12))
    each = [(frame.detection.t_s, frame.errors) for frame in frames if frame.errors is not None]
    if each:
        t = np.array([time for time, _ in each]) - t_s
        errors = np.array([error[:6].ravel() for _, error in each])
        design = np.column_stack([np.ones_like(t), t])
        if np.ptp(t) > 0.0:
            line, *_ = np.linalg.lstsq(design, errors, rcond=None)
        else:
            line = np.vstack([errors.mean(axis=0), np.zeros(errors.shape[1])])
        by_motion = np.zeros((12, each[0][1].shape[1]))
        by_motion[0::2], by_motion[1::2] = line[0].reshape(6, -1), line[1].reshape(6, -1)
        out += by_motion @ by_motion.T
    late = np.zeros(12)
    late[0::2] = camera.tolerances.time_s * w[1::2]
    found: Floats = out + np.outer(late, late)
    return found
