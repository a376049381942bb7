"""The docking monitor as its paper prints it (sections 3.1 and 3.2), compared with the exact one on rendered images.

    python sims/monitor_paper.py [portions]

Frame: cross centre by two orthogonal lines, circle by Gauss-Newton. Image axes as in 3.1: X = u - cx to the right, Y =
cy - v up. In them the bar across has the slope a = -phi3; the second residual is ``U + a V - c2`` and the centre
``((a c1 + c2), (a c2 - c1)) / (1 + a^2)`` (docs/explanation/papers.md).

Motion: Gauss-Newton on z over X_C - X_O, Y_C - Y_O, R, then regressions for v. Corrected: covariances propagated,
sigma^2 of the portion's own residuals with their degrees of freedom, time from the portion's last frame with the state
carried over. Printed: P = sigma^2 B^-1, one time origin, divisors 3K - 6 and K - 2, the prior's contribution included.
The printed U with its second row of zeros would give rates without variance: in both cases it is [[1, t], [0, 1]].
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.config.load import load_scene
from hil.config.scene import Scene
from hil.parts.monitor.features import ACROSS, DISC, UPRIGHT
from hil.parts.monitor.frame_tracker import FrameTracker
from hil.parts.monitor.kernels.edge_samples import BAR
from hil.parts.monitor.kernels.quantities import derive
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.render import TargetRenderer, film
from hil.parts.monitor.results import NEAR, QUANTITIES, FrameResult
from hil.parts.monitor.settings import MonitorSettings
from hil.parts.monitor.sources import VideoFrame

Floats = NDArray[np.float64]

_CIRCLE_TURNS: Final = 8
_TURNS: Final = 10
_FEWEST: Final = 2


@dataclass(frozen=True)
class PaperFrame:
    """The paper's six quantities X_C, Y_C, a, X_O, Y_O, R (px, image axes of 3.1) of a frame, and their covariance."""

    values: Floats
    covariance: Floats


def cross_centre(across: Floats, upright: Floats) -> tuple[Floats, Floats]:
    """Return (X_C, Y_C, a) and their covariance (3, 3) by linear least squares on two orthogonal lines.

    across, upright: (n, 4): X, Y, px, the variance across the bar, px^2, and the side of the bar (-1, 1; 0 for points
    of its centre line). The half widths of the bars are unknowns too, so that pairs of points contribute their middle.
    """
    wide = bool(np.any(across[:, 3] != 0.0)), bool(np.any(upright[:, 3] != 0.0))
    rows = np.zeros((len(across) + len(upright), 5))
    first, second = rows[: len(across)], rows[len(across) :]
    # a X - c1 = Y and a Y' - c2 = -X', the unknowns (a, c1, c2, half width across, half width upright)
    first[:, 0], first[:, 1], first[:, 3] = across[:, 0], -1.0, across[:, 3]
    second[:, 0], second[:, 2], second[:, 4] = upright[:, 1], -1.0, upright[:, 3]
    right = np.concatenate((across[:, 1], -upright[:, 0]))
    keep = [True, True, True, *wide]
    weights = 1.0 / np.concatenate((across[:, 2], upright[:, 2]))
    used = rows[:, keep]
    normal = used.T @ (weights[:, None] * used)
    covariance = np.linalg.inv(normal)[:3, :3]
    a, c1, c2 = np.linalg.solve(normal, used.T @ (weights * right))[:3]
    scale = 1.0 + a * a
    x, y = (a * c1 + c2) / scale, (a * c2 - c1) / scale
    slopes = np.array([
        [(c1 - 2.0 * a * x) / scale, a / scale, 1.0 / scale],
        [(c2 - 2.0 * a * y) / scale, -1.0 / scale, a / scale],
        [1.0, 0.0, 0.0],
    ])  # fmt: skip
    return np.array([x, y, a]), slopes @ covariance @ slopes.T


def first_circle(points: Floats) -> Floats:
    """Return (X, Y, R) of a circle by linear least squares on its equation; points (n, 2)."""
    middle = points.mean(axis=0)
    local = points - middle
    rows = np.column_stack((2.0 * local, np.ones(len(points))))
    x, y, c = np.linalg.lstsq(rows, np.sum(local**2, axis=1), rcond=None)[0]
    return np.array([x + middle[0], y + middle[1], np.sqrt(c + x * x + y * y)])


def circle(points: Floats, variances: Floats) -> tuple[Floats, Floats]:
    """Return (X_O, Y_O, R) and their covariance (3, 3), px, by Gauss-Newton on Phi_2; points (n, 2), variances (n,)."""
    found = first_circle(points)
    weights = 1.0 / variances
    normal = np.eye(3)
    for _ in range(_CIRCLE_TURNS):
        from_centre = points - found[:2]
        distance = np.hypot(from_centre[:, 0], from_centre[:, 1])
        rows = np.column_stack((from_centre / distance[:, None], np.ones(len(points))))
        normal = rows.T @ (weights[:, None] * rows)
        step = np.linalg.solve(normal, rows.T @ (weights * (distance - found[2])))
        found = found + step
        if np.max(np.abs(step)) < 1e-9:
            break
    return found, np.asarray(np.linalg.inv(normal))


def paper_frame(lens: Floats, samples: Any) -> PaperFrame | None:
    """Return X_C, Y_C, a, X_O, Y_O, R of the measured samples, or None if there are too few."""
    used = samples["good"] == 1
    x = samples["u"] + samples["shift"] * samples["nu"] - lens[1]
    y = lens[2] - samples["v"] - samples["shift"] * samples["nv"]
    bars = []
    for bar in (ACROSS, UPRIGHT):
        chosen = used & (samples["feature"] == bar)
        if chosen.sum() < _FEWEST:
            return None
        # outwards is up (right) on one side of a bar and down (left) on the other
        outwards = -samples["nv"][chosen] if bar == ACROSS else -samples["nu"][chosen]
        side = np.where(samples["kind"][chosen] == BAR, 0.0, np.sign(outwards))
        bars.append(np.column_stack((x[chosen], y[chosen], samples["variance"][chosen], side)))
    disc = used & (samples["feature"] == DISC)
    if disc.sum() < 2 * _FEWEST + 2:
        return None
    try:
        cross, cross_covariance = cross_centre(*bars)
        round_, round_covariance = circle(np.column_stack((x[disc], y[disc])), samples["variance"][disc])
    except np.linalg.LinAlgError:
        return None
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = cross_covariance, round_covariance
    values = np.concatenate((cross, round_))
    return PaperFrame(values, covariance) if np.all(np.isfinite(values)) else None


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

    def __init__(self, focal: float, offset: float, radius: float, q: float = 0.5, printed: bool = False) -> None:
        self._f, self._b, self._r = focal, offset, radius
        self._q, self._printed = q, printed
        self.previous: PaperState | None = None

    def fit(self, frames: Sequence[tuple[float, PaperFrame]], t_s: float) -> tuple[Floats, Floats] | None:
        """Return the motion (12,) at ``t_s`` and its covariance from frames with their times; None: not determined."""
        state = self._solve(frames, t_s) if len(frames) >= 3 else None
        if state is None:
            return None
        self.previous = state
        return self._at(state, t_s)

    def _solve(self, frames: Sequence[tuple[float, PaperFrame]], t_s: float) -> PaperState | None:
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
        found = self._positions(times, values, covariances, z0, self._q * b0, p0, before is not None)
        if found is None:
            return None
        z, z_normal, z_covariance = found
        v, v_normal, v_covariance = self._angles(times, values, covariances, z, v0, self._q * q0, pv0)
        return PaperState(origin, t_s, z, z_normal, z_covariance, v, v_normal, v_covariance)

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
    ) -> tuple[Floats, Floats, Floats] | None:
        """Return z, B and P by Gauss-Newton on Psi_n."""
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
            return z, normal, square * inverse
        # the residuals lose as many degrees of freedom as the portion itself determines
        square = own / max(3.0 * len(times) - float(np.trace(inverse @ information)), 1.0)
        return z, normal, inverse @ (c @ p0 @ c + max(square, 1e-3) * information) @ inverse

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

    def _at(self, state: PaperState, t_s: float) -> tuple[Floats, Floats]:
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
        return np.concatenate((z, v)), covariance


class PaperTracker(FrameTracker):
    """Tracker that also keeps the paper's six quantities of its last frame, from the same points of edges."""

    paper: PaperFrame | None = None

    def _measured(
        self, frame: VideoFrame, x: Floats, mode: str, tracked: bool, samples: Any, noise: float
    ) -> FrameResult:
        self.paper = paper_frame(self._features.lens, samples) if mode == NEAR else None
        return super()._measured(frame, x, mode, tracked, samples, noise)


def fit_of(scene: Scene, printed: bool = False) -> PaperMotionFit:
    """Return the paper's fit for the basic target of ``scene``, which needs a disc and a cross."""
    target = scene.target
    assert target.disc is not None
    assert target.cross is not None
    return PaperMotionFit(scene.camera.f, target.cross.offset_m, target.disc.radius_m, printed=printed)


def watched(
    scene: Scene, images: Iterable[VideoFrame], fits: Sequence[PaperMotionFit]
) -> list[list[tuple[Floats, Floats]]]:
    """Return values and sigmas (12,) of each portion: of the exact monitor, and of each of ``fits``."""
    monitor = DockingMonitor(scene)
    tracker = monitor._tracker = PaperTracker(scene, monitor.settings)
    portions: list[list[tuple[Floats, Floats]]] = []
    seen: list[tuple[float, PaperFrame]] = []
    for image in images:
        tracker.paper = None
        done = monitor.feed(image)
        if tracker.paper is not None:
            seen.append((image.t_s, tracker.paper))
        for portion in done:
            found = [fit.fit(seen, portion.t_s) for fit in fits]
            if portion.status == NEAR and None not in found:
                portions.append([(portion.values, portion.sigmas), *(derive(*each) for each in found if each)])
            seen = []
    return portions


def main() -> None:
    """Print errors of range and roll, and the ratios of errors to sigmas, of the third portion of many short films."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    scene = load_scene("atv").value
    renderer, n = TargetRenderer(scene), 3 * MonitorSettings().portion_frames
    chosen = [QUANTITIES.index(name) for name in ("range_m", "range_rate_mps", "phi3_rad")]
    print("root mean square of range, mm, and roll, deg; of error over sigma of range, range rate and roll")
    for d3 in (3.0, 6.0, 12.0):
        rows: list[list[list[Floats]]] = []
        for number in range(runs):
            rng = np.random.default_rng([number, int(1000 * d3)])
            w = np.zeros(12)
            w[0:4:2], w[4], w[5], w[6::2] = rng.uniform(-0.02, 0.02, 2) * d3, d3, -0.05, rng.uniform(-0.02, 0.02, 3)

            def flight(t_s: float, w: Floats = w) -> tuple[Floats, Floats]:
                return w[0:6:2] + t_s * w[1:6:2], w[6::2]

            done = watched(scene, film(renderer, flight, n, rng), [fit_of(scene), fit_of(scene, printed=True)])
            if len(done) == 3:
                w[4] += (n - 1) / scene.fps * w[5]
                truth = derive(w, np.eye(12))[0]
                rows.append([[(values - truth)[chosen], sigmas[chosen]] for values, sigmas in done[-1]])
        for name, found in zip(
            ("exact", "paper, corrected", "paper, printed"), np.moveaxis(np.array(rows), 1, 0), strict=True
        ):
            rms, ratio = (np.sqrt(np.mean(each**2, axis=0)) for each in (found[:, 0], found[:, 0] / found[:, 1]))
            cells = " ".join(f"{each:8.2f}" for each in ratio)
            print(f"{d3:6.1f} m  {name:17s} {1e3 * rms[0]:8.3f} {np.degrees(rms[2]):8.4f}  {cells}")


if __name__ == "__main__":
    main()
