"""Motion from the frames of a portion, carried over to the next one (monitor paper 3.2, misprints corrected).

The motion is ``d = z + z' t``, ``phi = v + v' t``, with t from the portion's last frame. Each frame gives its pose
with the full normal matrix of its edges, so the fit is equivalent to one of all edges of all frames together. The
estimate of the previous portion is carried over and weighted by q (d) and q' (phi), that of the camera's unknowns by
their correlation time. An unknown acceleration of given size is included; without it a smooth sway would make the
covariance too small.

Frames that scatter about their motion are explained, if their likelihood is much larger then, by a vibration of the
camera (a random rotation in each frame), by images lost unnoticed, by fields in the other order, or by wild or
repeated frames, which are left out. What remains widens all sigmas, or refuses the portion if it is much; other times
of the frames are accepted only if little does.

Growth and tone curve are estimated. The errors of the lens are considered: frames estimate them, so that they do not
appear as errors of the edges, but a motion that relies on such estimates would be as good as the edges' model only. It
takes the lens as stated, and its covariance includes the effect of the lens's tolerances, the same in all portions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.config.scene import Scene
from hil.parts.monitor.displacement import off_the_line, repeated
from hil.parts.monitor.kernels.pose import FOCAL, GROWTH, UNKNOWNS
from hil.parts.monitor.results import FrameResult
from hil.parts.monitor.settings import MonitorSettings

Floats = NDArray[np.float64]

_CAMERA: Final = UNKNOWNS - GROWTH
_CARRIED: Final = 12 + _CAMERA  # motion and camera
_STATES: Final = _CARRIED + 6  # with accelerations
_LENS: Final = slice(12 + FOCAL - GROWTH, _CARRIED)
_FREE: Final = np.r_[0 : 12 + FOCAL - GROWTH, _CARRIED:_STATES]  # all states but those of the lens
_FIRST_SIGMA: Final = np.array([1e3, 2.0] * 3 + [10.0, 0.2] * 3)  # m, m/s, rad, rad/s: initial
_WILD_FRAME: Final = 60.0  # chi-square of a frame's six pose components about the motion: some may be left out
_FEWEST: Final = 4  # frames of which others are left out, and that are kept
_CONTRADICTION: Final = 30.0  # scatter that nothing explains, thrusters included: no motion
_SIGNIFICANT: Final = 3.0
_MODEL_ERROR: Final = 0.25  # relative error of sigma^2 from the blur model and the noise estimate
_MODEL_PX: Final = 0.0055  # scatter of frames by the edges' model, which differs with their places in the pixels
_JITTERS_PX: Final = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)
_BETTER: Final = 12.0  # gain in twice the log-likelihood: about the number of explanations tried
_TIMING: Final = 24.0  # the same, of images lost at up to two places
_LARGE_SCATTER: Final = 3.0  # of the frames, relative to their noise: images may have been lost
_DROPPED: Final = 30.0  # the same, of a frame left out
_LEFT_OVER: Final = 6.0  # scatter besides a vibration, relative to that of the model, up to which it is the model's
_SLIGHT: Final = 2.0  # up to which other times of the frames explain it
_MOST_LOST: Final = 10  # images in one portion
_CHANGES: Final = 3  # explanations in one portion
NOT_ESTIMATED: Final = 1e-6
"""Prior of an unknown of the camera that is not estimated, px or relative."""


@dataclass(frozen=True)
class Motion:
    """Camera position and motion at ``t_s``: w (12,), its normal matrix B and covariance P (12, 12)."""

    t_s: float
    w: Floats
    normal: Floats
    covariance: Floats


@dataclass(frozen=True)
class MotionSolution:
    """A portion's motion, the number of frames used, its three square sums, jitter and timing (see Result)."""

    motion: Motion
    frames: int
    sigma2_edges: float
    sigma2_common: float
    sigma2_motion: float
    consistent: bool
    jitter_px: float = 0.0
    timing: str = ""


@dataclass(frozen=True)
class _Hypothesis:
    """Explanation of a portion: its frames, their times, s, from the last one, jitter, px, and errors of time.

    ends: the last frames, which are left out, show another motion than those that are kept.
    """

    frames: tuple[FrameResult, ...]
    times: tuple[float, ...]
    jitter_px: float = 0.0
    lost: int = 0
    exchanged: bool = False
    ends: bool = False

    @property
    def timing(self) -> str:
        """Return the difference of the frames' times from those stated as text, "" without one."""
        words = ["fields exchanged"] if self.exchanged else []
        return ", ".join(words + ([f"{self.lost} images lost"] if self.lost else []))


@dataclass(frozen=True)
class _Carried:
    """Motion and camera after a portion: x (21,), the covariance assumed by the next fit and the true one, (21, 21).

    by_lens: (21, 5), errors by one unit of each error of the lens, which ``true`` does not contain.
    """

    t_s: float
    x: Floats
    assumed: Floats
    true: Floats
    by_lens: Floats


@dataclass(frozen=True)
class _Fit:
    """Solution of a hypothesis. squares: of each frame about the motion, scatter: their mean over noise and model.

    cost: -2 ln of its likelihood.
    """

    solution: MotionSolution
    carried: _Carried
    squares: Floats
    scatter: float
    cost: float
    scattered: bool


def transition(dt: float) -> Floats:
    """Return the matrix (12, 12) that propagates w by ``dt``, s, of uniform motion."""
    matrix = np.eye(12)
    for i in range(6):
        matrix[2 * i, 2 * i + 1] = dt
    return matrix


def _gains(dt: float) -> Floats:
    """Return the effect of accelerations (6,) on motion and camera (21,) after ``dt``, s."""
    matrix = np.zeros((_CARRIED, 6))
    for i in range(6):
        matrix[2 * i, i], matrix[2 * i + 1, i] = 0.5 * dt * dt, dt
    return matrix


def _design(t: float) -> Floats:
    """Return the rows (15, 27) of a frame at ``t``, s, from the portion's last frame."""
    rows = np.zeros((UNKNOWNS, _STATES))
    for i in range(6):
        rows[i, 2 * i], rows[i, 2 * i + 1], rows[i, _CARRIED + i] = 1.0, t, 0.5 * t * t
    for i in range(_CAMERA):
        rows[6 + i, 12 + i] = 1.0
    return rows


def _inverse(matrix: Floats) -> Floats:
    """Return the inverse of a symmetric positive definite matrix with mixed units."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    inverse = np.linalg.inv(matrix * np.outer(scale, scale))
    inverse = 0.5 * (inverse + inverse.T) * np.outer(scale, scale)
    return np.asarray(inverse)


class MotionFit:
    """Fits one portion after another, and carries motion and camera over."""

    def __init__(self, settings: MonitorSettings, scene: Scene) -> None:
        self._settings = settings
        self._focal_px = scene.camera.f
        self._period_s = 1.0 / scene.fps
        self._interlaced = scene.fields != "whole"
        self._accelerations = np.diag(
            [settings.acceleration_mps2**2] * 3 + [settings.angular_acceleration_radps2**2] * 3
        )
        self._camera = np.diag(np.maximum(settings.camera_sigmas(scene.camera), NOT_ESTIMATED) ** 2)
        self._carried: _Carried | None = None

    def reset(self) -> None:
        """Restart with the next portion."""
        self._carried = None

    def fit(self, frames: Sequence[FrameResult], t_s: float) -> MotionSolution | None:
        """Return the motion at ``t_s`` from the used frames; None if it is not determined, or if they contradict it."""
        chosen = _Hypothesis(tuple(frames), tuple(frame.detection.t_s - t_s for frame in frames))
        solved = self._solve(chosen, t_s)
        for _ in range(_CHANGES):
            if solved is None or not solved.scattered:
                break
            others = [(self._solve(one, t_s), one, charge) for one, charge in self._others(chosen, solved, t_s)]
            rated = [
                (fit.cost + charge * max(fit.scatter, 1.0), k)
                for k, (fit, one, charge) in enumerate(others)
                if fit is not None and not (fit.scattered and fit.scatter > _SLIGHT and one.timing != chosen.timing)
            ]
            if not rated or not min(rated)[0] < solved.cost:
                break
            solved, chosen, _ = others[min(rated)[1]]
        if solved is None:
            return None
        if chosen.ends or (solved.scattered and solved.scatter > _CONTRADICTION):
            self.reset()
            return None
        self._carried = solved.carried
        return solved.solution

    def _others(self, chosen: _Hypothesis, fit: _Fit, t_s: float) -> Iterator[tuple[_Hypothesis, float]]:
        """Yield other explanations of the frames, each with the gain of -2 ln of the likelihood that it needs."""
        if chosen.jitter_px == 0.0:
            yield from ((replace(chosen, jitter_px=jitter), _BETTER) for jitter in _JITTERS_PX)
        if self._interlaced and not chosen.exchanged:
            half = 0.5 * self._period_s
            numbers = [frame.detection.number for frame in chosen.frames]
            times = (t + (half if number % 2 == 0 else -half) for t, number in zip(chosen.times, numbers, strict=True))
            yield replace(chosen, times=tuple(times), exchanged=True), _TIMING
        if not chosen.lost and fit.scatter > _LARGE_SCATTER:
            gaps = [
                k
                for k, frame in enumerate(chosen.frames)
                if k and not (self._interlaced and frame.detection.number % 2)
            ]
            for lost in [(gap,) for gap in gaps] + list(combinations_with_replacement(gaps, 2)):
                yield self._with_gaps(chosen, lost), _TIMING
            if chosen.jitter_px == 0.0:
                yield from ((one, _TIMING + one.lost) for one in self._many_lost(chosen, gaps))
        if len(chosen.frames) >= _FEWEST and fit.squares.max() > _WILD_FRAME:
            poses, information = _six_of(chosen.frames)
            wild = off_the_line(np.array(chosen.times), poses, information)
            still = repeated(poses, information)
            for left_out, charge in ((wild, _DROPPED * wild.sum()), (still, _DROPPED)):
                if left_out.any() and len(wild) - left_out.sum() >= _FEWEST:
                    kept = np.flatnonzero(~left_out)
                    frames, at = tuple(chosen.frames[k] for k in kept), tuple(chosen.times[k] for k in kept)
                    yield replace(chosen, frames=frames, times=at, ends=bool(left_out[-2:].all())), charge

    def _with_gaps(self, chosen: _Hypothesis, lost: Sequence[int]) -> _Hypothesis:
        """Return ``chosen`` with an image lost before each frame of ``lost``."""
        times = (t - self._period_s * sum(k < gap for gap in lost) for k, t in enumerate(chosen.times))
        return replace(chosen, times=tuple(times), lost=chosen.lost + len(lost))

    def _many_lost(self, chosen: _Hypothesis, gaps: Sequence[int]) -> Iterator[_Hypothesis]:
        """Yield explanations with as many images lost before each frame as the target has moved further there."""
        poses, information = _six_of(chosen.frames)
        weights = information.mean(axis=0)
        steps = np.diff(poses, axis=0) @ weights @ (poses[-1] - poses[0])
        periods = np.diff(chosen.times) / self._period_s
        for usual in set(np.quantile(steps / periods, (0.1, 0.25, 0.5)).tolist()):
            if usual > 0.0:
                more = np.maximum(np.rint(steps / usual - periods), 0).astype(int)
                lost = [gap for gap in gaps for _ in range(more[gap - 1])]
                if 2 < len(lost) <= _MOST_LOST:
                    yield self._with_gaps(chosen, lost)

    def _solve(self, chosen: _Hypothesis, t_s: float) -> _Fit | None:
        frames = chosen.frames
        assumed, true, mean = self._prior(t_s)
        jitter = chosen.jitter_px / self._focal_px
        information, right = np.zeros((_STATES, _STATES)), np.zeros(_STATES)
        designs = [_design(t) for t in chosen.times]
        normals, spread = [], 0.0
        fixed = [_with_stated_lens(frame) for frame in frames]
        for frame, rows in zip(frames, designs, strict=True):
            # each frame's own prior is removed again, so that it counts once per portion
            edges = (frame.normal + np.diag(frame.prior)) @ frame.pose
            normal, share, log_det = _with_jitter(frame, jitter)
            normals.append(normal)
            spread += log_det
            information += rows.T @ normal @ rows
            right += rows.T @ (edges - share @ edges)
        held = self._held(frames)
        prior = _inverse(assumed)
        total = (prior + held + information)[np.ix_(_FREE, _FREE)]
        inverse = np.zeros((_STATES, _STATES))
        try:
            inverse[np.ix_(_FREE, _FREE)] = _inverse(total)
        except np.linalg.LinAlgError:
            return None
        if not np.all(np.isfinite(inverse)):
            return None
        theta = inverse @ (prior @ mean + right)
        edges2, common, excess = _edge_squares(frames)
        squares = np.array([
            _square(frame, pose, normal, rows @ theta)
            for frame, pose, normal, rows in zip(frames, fixed, normals, designs, strict=True)
        ])  # fmt: skip
        motion2, doubt = _motion_square(squares)
        widened = motion2 / edges2 if motion2 > edges2 * (1.0 + _SIGNIFICANT * doubt) else 1.0
        noise = edges2 if excess == 0.0 else 1.0
        floor = 1.0 + _MODEL_PX**2 * _image_information(frames, self._focal_px)
        if jitter > 0.0 and motion2 > _LEFT_OVER * noise * floor:
            floor = 1.0
        scattered = widened > floor * (1.0 + _SIGNIFICANT * doubt)
        factor = noise * widened + len(frames) * excess
        covariance = inverse @ (prior @ true @ prior + held + factor * information) @ inverse
        by_lens = inverse @ (prior @ self._carried_by_lens(t_s) + information[:, _LENS])
        reported = covariance + by_lens @ self._camera[FOCAL - GROWTH :, FOCAL - GROWTH :] @ by_lens.T
        normal12 = _inverse(inverse[:12, :12])
        consistent = edges2 < 2.0 and excess == 0.0 and widened == 1.0 and not chosen.timing
        solution = MotionSolution(
            Motion(t_s, theta[:12].copy(), normal12, reported[:12, :12].copy()),
            len(frames), edges2, common, motion2, consistent, chosen.jitter_px, chosen.timing,
        )  # fmt: skip
        carried = _Carried(
            t_s, theta[:_CARRIED].copy(), inverse[:_CARRIED, :_CARRIED].copy(),
            covariance[:_CARRIED, :_CARRIED].copy(), by_lens[:_CARRIED],
        )  # fmt: skip
        for matrix in (carried.assumed, carried.true):
            matrix[_LENS, _LENS] = self._camera[FOCAL - GROWTH :, FOCAL - GROWTH :]
        scale = np.sqrt(np.diag(total))
        determinant = 2.0 * float(np.log(scale).sum()) + float(np.linalg.slogdet(total / np.outer(scale, scale))[1])
        cost = float(squares.sum()) / noise + spread + determinant
        scatter = float(np.nan_to_num(motion2 / (noise * floor), nan=1.0))
        return _Fit(solution, carried, squares, scatter, cost, scattered)

    def _carried_by_lens(self, t_s: float) -> Floats:
        """Return the errors (27, 5) of the carried motion at ``t_s`` by one unit of each error of the lens."""
        out = np.zeros((_STATES, _CARRIED - _LENS.start))
        if self._carried is not None:
            out[:_CARRIED] = self._carried.by_lens
            out[:12] = transition(t_s - self._carried.t_s) @ out[:12]
        return out

    def _held(self, frames: Sequence[FrameResult]) -> Floats:
        """Return the information (27, 27) that the passive angles are small, for frames without a cross.

        It counts in the first portion only: in each later one it would be the same once more.
        """
        matrix = np.zeros((_STATES, _STATES))
        if self._carried is None:
            d3 = float(frames[-1].pose[2])
            matrix[0, 0] = matrix[2, 2] = 1.0 / (self._settings.passive_angle_rad * d3) ** 2
        return matrix

    def _prior(self, t_s: float) -> tuple[Floats, Floats, Floats]:
        """Return the covariance (27, 27) assumed by the fit a priori, the true one, and the mean (27,)."""
        settings, previous = self._settings, self._carried
        assumed, mean = np.zeros((_STATES, _STATES)), np.zeros(_STATES)
        assumed[_CARRIED:, _CARRIED:] = self._accelerations
        if previous is None:
            assumed[:12, :12] = np.diag(_FIRST_SIGMA**2)
            assumed[12:_CARRIED, 12:_CARRIED] = self._camera
            return assumed, assumed, mean
        true = assumed.copy()
        dt = t_s - previous.t_s
        kept = math.exp(-max(dt, 0.0) / settings.camera_s)
        carry, gains = kept * np.eye(_CARRIED), _gains(dt)
        carry[:12, :12] = transition(dt)
        mean[:_CARRIED] = carry @ previous.x
        spread = gains @ self._accelerations @ gains.T
        spread[12:, 12:] += (1.0 - kept * kept) * self._camera
        forget = np.ones(_CARRIED)
        forget[:6], forget[6:12] = max(settings.q, 1e-9) ** -0.5, max(settings.q_attitude, 1e-9) ** -0.5
        for matrix, covariance in ((assumed, previous.assumed), (true, previous.true)):
            predicted = carry @ covariance @ carry.T
            if matrix is assumed:
                predicted = _at_most(predicted * np.outer(forget, forget))
            matrix[:_CARRIED, :_CARRIED] = predicted + spread
            matrix[:_CARRIED, _CARRIED:] = gains @ self._accelerations
            matrix[_CARRIED:, :_CARRIED] = matrix[:_CARRIED, _CARRIED:].T
        return assumed, true, mean


def _at_most(covariance: Floats) -> Floats:
    """Return a covariance (21, 21) with the initial uncertainty of the motion as its upper bound."""
    information = _inverse(covariance)
    information[np.arange(12), np.arange(12)] += _FIRST_SIGMA**-2
    return _inverse(information)


def _with_jitter(frame: FrameResult, jitter: float) -> tuple[Floats, Floats, float]:
    """Return the information (15, 15) of a frame whose pointing has a random error of ``jitter``, rad.

    Also the fraction (15, 15) of the edges' right-hand side that it removes, and ln of the determinant's growth.
    """
    if jitter == 0.0:
        return frame.normal, np.zeros((UNKNOWNS, UNKNOWNS)), 0.0
    pointing = frame.normal[:, 3:5]
    inner = np.eye(2) / jitter**2 + pointing[3:5]
    share = np.zeros((UNKNOWNS, UNKNOWNS))
    share[:, 3:5] = pointing @ np.linalg.inv(inner)
    loose = _without_camera((frame.normal + np.diag(frame.prior))[:FOCAL, :FOCAL])[3:5, 3:5]
    return (
        frame.normal - share[:, 3:5] @ pointing.T,
        share,
        float(np.linalg.slogdet(np.eye(2) + jitter**2 * loose)[1]),
    )


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


def _image_information(frames: Sequence[FrameResult], focal_px: float) -> float:
    """Return the information, px^-2, of a frame's edges on the displacement of its image, the mean of the frames."""
    return float(np.mean([0.5 * (frame.normal[3, 3] + frame.normal[4, 4]) for frame in frames])) / focal_px**2


def _with_stated_lens(frame: FrameResult) -> Floats:
    """Return the pose (15,) of a frame for a lens without errors."""
    lens = frame.pose[FOCAL:]
    if not lens.any():
        return frame.pose
    full = frame.normal + np.diag(frame.prior)
    out = np.zeros(UNKNOWNS)
    out[:FOCAL] = frame.pose[:FOCAL] + np.linalg.solve(full[:FOCAL, :FOCAL], full[:FOCAL, FOCAL:] @ lens)
    return out


def _without_camera(full: Floats) -> Floats:
    """Return the information (6, 6) of ``full`` (n, n) on the pose, those of the camera eliminated."""
    loose: Floats = full[:6, :6] - full[:6, 6:] @ np.linalg.solve(full[6:, 6:], full[6:, :6])
    return loose


def _six_of(frames: Sequence[FrameResult]) -> tuple[Floats, Floats]:
    """Return the poses (n, 6) of the frames and their information (n, 6, 6), those of the camera eliminated."""
    full = [(one.normal + np.diag(one.prior))[:FOCAL, :FOCAL] for one in frames]
    poses = np.array([_with_stated_lens(one)[:6] for one in frames])
    return poses, np.array([_without_camera(each) for each in full])


def _square(frame: FrameResult, pose: Floats, normal: Floats, at: Floats) -> float:
    """Return chi-square of a frame's pose (15,), six components, about the motion; those of the camera eliminated."""
    gap = (pose - at)[:6]
    full = normal + np.diag(frame.prior)
    return float(gap @ _without_camera(full[:FOCAL, :FOCAL]) @ gap)


def _motion_square(squares: Floats) -> tuple[float, float]:
    """Return sigma^2 of the frames about the motion and its statistical deviation."""
    freedom = 6.0 * len(squares) - 12.0
    if freedom < 6.0:
        return float("nan"), float("inf")
    return float(squares.sum()) / freedom, float(np.sqrt(2.0 / freedom))
