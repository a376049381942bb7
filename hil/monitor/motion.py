"""Motion from the frames of a portion, carried over to the next one (monitor paper 3.2, misprints corrected).

The motion is ``d = z + z' t``, ``phi = v + v' t``, with t from the portion's last frame. Each frame gives its pose
with the full normal matrix of its edges, so the fit is equivalent to one of all edges of all frames together. The
estimate of the previous portion is carried over and weighted by q (d) and q' (phi). An unknown acceleration of given
size is included; without it a smooth sway would make the covariance too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.monitor.results import FrameResult
from hil.monitor.settings import MonitorSettings

Floats = NDArray[np.float64]

_UNKNOWNS: Final = 19  # twelve of motion, six accelerations, the edges' growth
_FIRST_SIGMA: Final = np.array([1e3, 2.0] * 3 + [10.0, 0.2] * 3)  # m, m/s, rad, rad/s: initial
_WILD_FRAME: Final = 60.0  # chi-square of a frame's six pose components about the motion beyond which it may be dropped
_SIGNIFICANT: Final = 3.0
_MODEL_ERROR: Final = 0.25  # relative error of sigma^2 from the blur model and the noise estimate


@dataclass(frozen=True)
class Motion:
    """Camera position and motion at ``t_s``: w (12,), its normal matrix B and covariance P (12, 12)."""

    t_s: float
    w: Floats
    normal: Floats
    covariance: Floats


@dataclass(frozen=True)
class MotionSolution:
    """A portion's motion, the number of frames used, and its three square sums (see Result)."""

    motion: Motion
    frames: int
    sigma2_edges: float
    sigma2_common: float
    sigma2_motion: float
    consistent: bool


def transition(dt: float) -> Floats:
    """Return the matrix (12, 12) that propagates w by ``dt``, s, of uniform motion."""
    matrix = np.eye(12)
    for i in range(6):
        matrix[2 * i, 2 * i + 1] = dt
    return matrix


def _gains(dt: float) -> Floats:
    """Return the effect of accelerations (6,) on w (12,) after ``dt``, s."""
    matrix = np.zeros((12, 6))
    for i in range(6):
        matrix[2 * i, i], matrix[2 * i + 1, i] = 0.5 * dt * dt, dt
    return matrix


def _design(t: float) -> Floats:
    """Return the rows (7, 19) of a frame at ``t``, s, from the portion's last frame."""
    rows = np.zeros((7, _UNKNOWNS))
    for i in range(6):
        rows[i, 2 * i], rows[i, 2 * i + 1], rows[i, 12 + i] = 1.0, t, 0.5 * t * t
    rows[6, 18] = 1.0
    return rows


def _inverse(matrix: Floats) -> Floats:
    """Return the inverse of a symmetric positive definite matrix with mixed units."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    inverse = np.linalg.inv(matrix * np.outer(scale, scale))
    inverse = 0.5 * (inverse + inverse.T) * np.outer(scale, scale)
    return np.asarray(inverse)


class MotionFit:
    """Fits one portion after another; ``previous`` is the motion carried over."""

    def __init__(self, settings: MonitorSettings) -> None:
        self._settings = settings
        self._accelerations = np.diag(
            [settings.acceleration_mps2**2] * 3 + [settings.angular_acceleration_radps2**2] * 3
        )
        self.previous: Motion | None = None

    def reset(self) -> None:
        """Restart with the next portion."""
        self.previous = None

    def fit(self, frames: Sequence[FrameResult], t_s: float) -> MotionSolution | None:
        """Return the motion at ``t_s`` from the used frames; None if it is not determined."""
        kept = list(frames)
        while True:
            found = self._solve(kept, t_s)
            if found is None:
                return None
            fit, squares = found
            worst = int(np.argmax(squares))
            if len(kept) < 4 or squares[worst] < _WILD_FRAME or squares[worst] < 8.0 * np.median(squares):
                break
            del kept[worst]
        self.previous = fit.motion
        return fit

    def _solve(self, frames: Sequence[FrameResult], t_s: float) -> tuple[MotionSolution, Floats] | None:
        assumed, true, mean = self._prior(t_s)
        information, right = np.zeros((_UNKNOWNS, _UNKNOWNS)), np.zeros(_UNKNOWNS)
        designs = [_design(frame.detection.t_s - t_s) for frame in frames]
        for frame, rows in zip(frames, designs, strict=True):
            information += rows.T @ frame.normal @ rows
            # each frame's own prior is removed again, so that it counts once per portion
            right += rows.T @ ((frame.normal + np.diag(frame.prior)) @ frame.pose)
        held = self._held(frames)
        known = _inverse(assumed)
        weight = known + held
        total = weight + information
        try:
            inverse = _inverse(total)
        except np.linalg.LinAlgError:
            return None
        if not np.all(np.isfinite(inverse)):
            return None
        theta = inverse @ (known @ mean + right)
        edges, common, excess = _edge_squares(frames)
        squares = np.array([_square(frame, rows @ theta) for frame, rows in zip(frames, designs, strict=True)])
        motion2, motion_doubt = _motion_square(squares)
        widened = 1.0
        if motion2 > edges * (1.0 + _SIGNIFICANT * motion_doubt):
            widened = motion2 / edges
        noise = edges if excess == 0.0 else 1.0
        factor = noise * widened + len(frames) * excess
        carried = known @ true @ known + held
        covariance = inverse @ (carried + factor * information) @ inverse
        normal = _inverse(inverse[:12, :12])
        if self._settings.motion == "printed":  # 3.2 as printed: sigma^2 B^-1 with the divisor of K frames alone
            covariance = max(float(np.nan_to_num(motion2, nan=edges)), 1e-6) * inverse
        consistent = edges < 2.0 and excess == 0.0 and widened == 1.0
        fit = MotionSolution(
            Motion(t_s, theta[:12].copy(), normal, covariance[:12, :12].copy()),
            len(frames), edges, common, motion2, consistent,
        )  # fmt: skip
        return fit, squares

    def _held(self, frames: Sequence[FrameResult]) -> Floats:
        """Return the information (19, 19) that the passive angles are small, for frames without a cross."""
        matrix = np.zeros((_UNKNOWNS, _UNKNOWNS))
        d3 = float(frames[-1].pose[2])
        weight = 1.0 / (self._settings.passive_angle_rad * d3) ** 2
        matrix[0, 0] = matrix[2, 2] = weight
        return matrix

    def _prior(self, t_s: float) -> tuple[Floats, Floats, Floats]:
        """Return the covariance (19, 19) assumed by the fit a priori, the true one, and the mean (19,)."""
        settings = self._settings
        assumed, mean = np.zeros((_UNKNOWNS, _UNKNOWNS)), np.zeros(_UNKNOWNS)
        assumed[18, 18] = settings.growth_px**2
        assumed[12:18, 12:18] = self._accelerations
        true = assumed.copy()
        if self.previous is None:
            assumed[:12, :12] = np.diag(_FIRST_SIGMA**2)
            return assumed, assumed, mean
        dt = t_s - self.previous.t_s
        carry, gains = transition(dt), _gains(dt)
        mean[:12] = carry @ self.previous.w
        spread = gains @ self._accelerations @ gains.T
        forget = np.repeat([1.0 / np.sqrt(max(settings.q, 1e-9)), 1.0 / np.sqrt(max(settings.q_attitude, 1e-9))], 6)
        for matrix, covariance in ((assumed, _inverse(self.previous.normal)), (true, self.previous.covariance)):
            known = carry @ covariance @ carry.T
            if matrix is assumed:
                known = known * np.outer(forget, forget)
            matrix[:12, :12] = known + spread
            matrix[:12, 12:18] = gains @ self._accelerations
            matrix[12:18, :12] = matrix[:12, 12:18].T
        return assumed, true, mean


def _edge_squares(frames: Sequence[FrameResult]) -> tuple[float, float, float]:
    """Return sigma^2 of the points, of the common part of the points of an edge, and their excess over the noise.

    The excess does not average out over the frames of a portion: it is the same in all of them.
    """
    sums = np.array([frame.sums for frame in frames])
    free_points = max(float((sums[:, 1] - 7.0).sum()), 1.0)
    free_edges = max(float(np.maximum(sums[:, 3] - 7.0, 0.0).sum()), 1e-9)
    points, common = float(sums[:, 0].sum()) / free_points, float(sums[:, 2].sum()) / free_edges
    too_large = (
        points > 1.0 + _MODEL_ERROR + _SIGNIFICANT * np.sqrt(2.0 / free_points),
        free_edges >= 3.0 and common > 1.0 + _MODEL_ERROR + _SIGNIFICANT * np.sqrt(2.0 / free_edges),
    )
    largest = max(points, common) if free_edges >= 3.0 else points
    return points, common, largest - 1.0 if any(too_large) else 0.0


def _square(frame: FrameResult, at: Floats) -> float:
    """Return chi-square of the frame's six pose components about the motion, the growth eliminated."""
    gap = frame.pose - at
    full = frame.normal + np.diag(frame.prior)
    loose = full[:6, :6] - np.outer(full[:6, 6], full[6, :6]) / full[6, 6]
    return float(gap[:6] @ loose @ gap[:6])


def _motion_square(squares: Floats) -> tuple[float, float]:
    """Return sigma^2 of the frames about the motion and its statistical deviation."""
    freedom = 6.0 * len(squares) - 12.0
    if freedom < 6.0:
        return float("nan"), float("inf")
    return float(squares.sum()) / freedom, float(np.sqrt(2.0 / freedom))
