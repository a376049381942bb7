"""Motion as printed in the paper (3.2): Gauss-Newton on z over X_C - X_O, Y_C - Y_O, R, then regressions for v.

"corrected": covariances propagated, sigma^2 of the portion's own residuals with their degrees of freedom, time from
the portion's last frame with the state carried over. "printed": P = sigma^2 B^-1, one time origin, divisors 3K - 6
and K - 2, the prior's contribution included. The printed U with its second row of zeros would give rates without
variance: in both cases it is [[1, t], [0, 1]].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.monitor.motion import Motion, MotionSolution
from hil.monitor.results import FrameResult, PaperFrame
from hil.monitor.settings import MonitorSettings

Floats = NDArray[np.float64]

_TURNS: Final = 10


@dataclass(frozen=True)
class PaperState:
    """z, v (6,) with time from ``origin_s``, their normal matrices B, Q and covariances (6, 6) of z and of v's own."""

    origin_s: float
    t_s: float
    z: Floats
    z_normal: Floats
    z_covariance: Floats
    v: Floats
    v_normal: Floats
    v_covariance: Floats


def pair(t: float) -> Floats:
    """Return the matrix (6, 6) that transforms (z1, z2, ...) to a time origin later by ``t``, s."""
    return np.kron(np.eye(3), np.array([[1.0, t], [0.0, 1.0]]))


class PaperMotionFit:
    """Fits one portion after another from the paper's six quantities per frame."""

    def __init__(self, settings: MonitorSettings, focal: float, offset: float, radius: float) -> None:
        self._settings = settings
        self._f, self._b, self._r = focal, offset, radius
        self._printed = settings.motion == "printed"
        self.previous: PaperState | None = None

    def reset(self) -> None:
        """Restart with the next portion."""
        self.previous = None

    def fit(self, frames: Sequence[FrameResult], t_s: float) -> MotionSolution | None:
        """Return the motion at ``t_s`` from the used frames; None if it is not determined."""
        used = [(frame.detection.t_s, frame.paper) for frame in frames if frame.paper is not None]
        if len(used) < 3:
            return None
        state, squares = self._solve(used, t_s)
        if state is None:
            return None
        self.previous = state
        return self._as_fit(state, len(used), squares, t_s)

    def _solve(self, frames: list[tuple[float, PaperFrame]], t_s: float) -> tuple[PaperState | None, float]:
        before = self.previous
        origin = t_s if not self._printed else (before.origin_s if before is not None else frames[0][0])
        times = np.array([t for t, _ in frames]) - origin
        values = np.array([paper.values for _, paper in frames])
        covariances = np.array([paper.covariance for _, paper in frames])
        zeros = np.zeros((6, 6))
        z0, b0, p0, v0, q0, pv0 = np.zeros(6), zeros, zeros, np.zeros(6), zeros, zeros
        if before is not None:
            carry = pair(origin - before.origin_s)
            back = np.linalg.inv(carry)
            z0, v0 = carry @ before.z, carry @ before.v
            b0, q0 = back.T @ before.z_normal @ back, back.T @ before.v_normal @ back
            p0, pv0 = carry @ before.z_covariance @ carry.T, carry @ before.v_covariance @ carry.T
        found = self._positions(times, values, covariances, z0, self._settings.q * b0, p0, before is not None)
        if found is None:
            return None, float("nan")
        z, z_normal, z_covariance, squares = found
        v, v_normal, v_covariance = self._angles(times, values, covariances, z, v0, self._settings.q_attitude * q0, pv0)
        return PaperState(origin, t_s, z, z_normal, z_covariance, v, v_normal, v_covariance), squares

    def _model(self, times: Floats, z: Floats) -> tuple[Floats, Floats]:
        """Return X_C - X_O, Y_C - Y_O, R of the motion z, (n, 3), and their derivatives (n, 3, 6)."""
        f, b, r = self._f, self._b, self._r
        d1, d2, d3 = (z[2 * i] + z[2 * i + 1] * times for i in range(3))
        gap = f * b / (d3 * (d3 - b))
        bend = -gap * (2.0 * d3 - b) / (d3 * (d3 - b))
        model = np.column_stack((-gap * d1, gap * d2, f * r / d3))
        slopes = np.zeros((len(times), 3, 6))
        for row, (index, slope) in enumerate(((0, -gap), (1, gap), (2, -f * r / d3**2))):
            slopes[:, row, 2 * index], slopes[:, row, 2 * index + 1] = slope, slope * times
        for row, sign, d in ((0, -1.0, d1), (1, 1.0, d2)):
            slopes[:, row, 4], slopes[:, row, 5] = sign * bend * d, sign * bend * d * times
        return model, slopes

    def _positions(
        self, times: Floats, values: Floats, covariances: Floats, z0: Floats, c: Floats, p0: Floats, carried: bool
    ) -> tuple[Floats, Floats, Floats, float] | None:
        """Return z, B, P and sigma^2 by Gauss-Newton on Psi_n."""
        measured = np.column_stack((values[:, 0] - values[:, 3], values[:, 1] - values[:, 4], values[:, 5]))
        variances = np.column_stack((
            covariances[:, 0, 0] + covariances[:, 3, 3],
            covariances[:, 1, 1] + covariances[:, 4, 4],
            covariances[:, 5, 5],
        ))  # fmt: skip
        weights = 1.0 / variances
        z = z0.copy() if carried else self._start(times, values)
        information = np.zeros((6, 6))
        for _ in range(_TURNS):
            model, slopes = self._model(times, z)
            left = measured - model
            information = np.einsum("ki,kia,kib->ab", weights, slopes, slopes)
            right = np.einsum("ki,kia,ki->a", weights, slopes, left) + c @ (z0 - z)
            try:
                step = np.linalg.solve(information + c, right)
            except np.linalg.LinAlgError:
                return None
            z = z + step
            if np.max(np.abs(step)) < 1e-12:
                break
        left = measured - self._model(times, z)[0]
        own = float(np.sum(weights * left**2))
        normal = information + c
        inverse: Floats = np.asarray(np.linalg.inv(normal), float)
        freedom = max(3 * len(times) - 6, 1)
        if self._printed:
            square = (own + float((z - z0) @ c @ (z - z0))) / freedom
            return z, normal, square * inverse, square
        # the residuals lose as many degrees of freedom as the portion itself determines
        square = own / max(3.0 * len(times) - float(np.trace(inverse @ information)), 1.0)
        return z, normal, inverse @ (c @ p0 @ c + max(square, 1e-3) * information) @ inverse, square

    def _start(self, times: Floats, values: Floats) -> Floats:
        f, b = self._f, self._b
        d3 = f * self._r / values[:, 5]
        gain = d3 * (d3 - b) / (f * b)
        z = np.zeros(6)
        for i, d in enumerate((-gain * (values[:, 0] - values[:, 3]), gain * (values[:, 1] - values[:, 4]), d3)):
            z[2 * i + 1], z[2 * i] = np.polyfit(times, d, 1)
        return z

    def _angles(
        self, times: Floats, values: Floats, covariances: Floats, z: Floats, v0: Floats, c: Floats, p0: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return v, its normal matrix and covariance by three regressions (F_n)."""
        f = self._f
        d1, d2, d3 = (z[2 * i] + z[2 * i + 1] * times for i in range(3))
        alphas = np.column_stack((values[:, 4] / f - d2 / d3, -values[:, 3] / f - d1 / d3, -values[:, 2]))
        variances = np.column_stack((covariances[:, 4, 4] / f**2, covariances[:, 3, 3] / f**2, covariances[:, 2, 2]))
        v, normal, covariance = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6))
        rows = np.column_stack((np.ones(len(times)), times))
        for i in range(3):
            at = slice(2 * i, 2 * i + 2)
            information = rows.T @ rows / variances[:, i].mean()
            total = information + c[at, at]
            right = rows.T @ alphas[:, i] / variances[:, i].mean() + c[at, at] @ v0[at]
            inverse = np.linalg.inv(total)
            v[at] = inverse @ right
            own = float(np.sum((alphas[:, i] - rows @ v[at]) ** 2)) / variances[:, i].mean()
            if self._printed:
                step = v[at] - v0[at]
                square = (own + float(step @ c[at, at] @ step)) / max(len(times) - 2, 1)
                covariance[at, at] = square * inverse
            else:
                square = own / max(len(times) - float(np.trace(inverse @ information)), 1.0)
                covariance[at, at] = inverse @ (c[at, at] @ p0[at, at] @ c[at, at] + square * information) @ inverse
            normal[at, at] = total
        return v, normal, covariance

    def _as_fit(self, state: PaperState, frames: int, square: float, t_s: float) -> MotionSolution:
        carry = pair(t_s - state.origin_s)
        z, v = carry @ state.z, carry @ state.v
        pz, pv = carry @ state.z_covariance @ carry.T, carry @ state.v_covariance @ carry.T
        covariance = np.zeros((12, 12))
        covariance[:6, :6], covariance[6:, 6:] = pz, pv
        if not self._printed:
            # alpha is the pointing minus the effect of the position: errors of d propagate to phi
            share = np.zeros((6, 6))
            for angle, place in ((0, 1), (1, 0)):
                for k in range(2):
                    share[2 * angle + k, 2 * place + k] = -1.0 / z[4]
                    share[2 * angle + k, 4 + k] = z[2 * place] / z[4] ** 2
            covariance[6:, :6] = share @ pz
            covariance[:6, 6:] = covariance[6:, :6].T
            covariance[6:, 6:] += share @ pz @ share.T
        motion = Motion(t_s, np.concatenate((z, v)), np.zeros((12, 12)), covariance)
        return MotionSolution(motion, frames, square, float("nan"), square, square < 2.0)
