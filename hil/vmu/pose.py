"""Pose solver: typed interface to the kernels of search, assignment and refinement."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.maths import quat
from hil.vmu.geometry import camera_pair, considered_covariance, led_positions, spot_floors
from hil.vmu.kernels.budget import chi_square_growth, equations, fill_shared
from hil.vmu.kernels.match import assign, chi_square_limit, fill_view, led_windows
from hil.vmu.kernels.pose_search import (
    SEARCH,
    STATE_FITS,
    STATE_FULL,
    STATE_STARTS,
    STATE_TRIPLES,
    STATE_WIDTH,
    add_settled,
    search,
)
from hil.vmu.kernels.records import CELLS, FIT, MAX_LEDS, MAX_SPOTS, SHARED, SPOT_RAY, RingScene, View
from hil.vmu.kernels.start_poses import orientation_of

_REMEMBERED, _FITS = 256, 64
_MOST_TRIPLES, _TRIPLES_PER_START = 14_000, 15  # pairings of three spots with three LEDs for a pair: about 40 ms
_COARSE = 5.0  # sigmas
_LINEAR = (0.6, 1.7)  # growth of chi-square relative to the covariance for which it is valid
_FAR = 5.0  # sigmas
_FLAT = 0.05  # thickness over extent
_STRAY_FACTOR = 10.0  # density of stray lights near the target relative to the whole image
_TURNED_RIGHT = np.array([SHARED - 6, SHARED - 5])  # the right camera about its u and v axes, in the tolerance
OPTICS_PX = 0.15  # error of a spot that gates and search allow in any case
_USUAL_MPS, _USUAL_RADPS, _USUAL_RANGE_M = 0.3, 0.05, 3.0  # of a target without a track
_TYPICAL_RANGE_M = 1.5  # at which they assess the tolerances
_TURNED = 2  # best hypotheses whose turns are compared
_SAME_TURN = 0.35  # of the least distance of two LEDs: by how much a turn of the ring may miss one


@dataclass(frozen=True, slots=True)
class SolverSettings:
    """Settings of identification and pose.

    near_m, far_m: range of the target. steepest_deg: largest angle between the target's axis -z_t and the line of
    sight. reach_px: largest initial distance of a spot from an LED's projection. decisive: logarithm of the odds at
    which one hypothesis is accepted and another one dropped. false_alarms: expected number of random patterns per image
    at which a pattern without a track is accepted. doubt: the same, at which a second pattern makes a pose doubtful.
    largest_sigma_deg: of the attitude, above which no pose is reported, if the LEDs in use are coplanar, and if not.
    """

    near_m: float = 0.2
    far_m: float = 32.0
    steepest_deg: float = 70.0
    reach_px: float = 1.5
    decisive: float = 8.0
    false_alarms: float = 1e-4
    doubt: float = 0.05
    largest_sigma_deg: tuple[float, float] = (1.0, 3.0)


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted pose of the target: the last pose propagated by a gyro or at constant rates.

    t_v: (3,), m. q_vt: (4,), scalar last, ``p_v = A(q_vt) p_t + t_v``. covariance: (6, 6) of t_v and of the small-angle
    rotation e about v's axes.
    """

    t_v: Array
    q_vt: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class TargetMotion:
    """Motion of the target in v. t_v: (3,), m. rates: (6,), m/s, rad/s about v's axes. covariance: (6, 6), of them."""

    t_v: Array
    rates: Array
    covariance: Array

    @property
    def table(self) -> Array:
        """Rates, and below their covariance, (7, 6)."""
        return np.vstack([self.rates, self.covariance])


_USUAL_MOTION = TargetMotion(
    np.array([0.0, 0.0, _USUAL_RANGE_M]), np.zeros(6), np.diag([_USUAL_MPS**2] * 3 + [_USUAL_RADPS**2] * 3)
)


class Solver:
    """Scene and scratch memory of one vision unit."""

    def __init__(self, geometry: VmuGeometry, settings: SolverSettings) -> None:
        self.settings = settings
        self.scene = scene_of(geometry, settings)
        self._still, self._sync_s = self.scene.tolerance, geometry.tolerances.sync_s
        self._rolling = bool(self.scene.lens["row_s"].any())
        self.begin_pair(None, geometry.tolerances.vibration_px)
        self.slack = _slack(self.scene)
        """Variance per camera, px^2, that gates and search add to a spot's, (2,)."""
        self.normal_t = thin_axis(self.scene.leds)
        self.centre_t = np.asarray(self.scene.leds.mean(axis=0))
        self._search = np.zeros(1, SEARCH).view(np.recarray)[0]
        self._search.near, self._search.far = settings.near_m, settings.far_m
        self._search.least_facing = math.cos(math.radians(settings.steepest_deg))
        self._search.reach_px = settings.reach_px
        self._search.gate_px = 2.0 * settings.reach_px
        self._search.normal, self._search.centre = self.normal_t, self.centre_t
        self._starts = np.zeros(_REMEMBERED + 1, FIT)
        self._starts["spot"] = -1
        self._fits = np.zeros(_FITS + 1, FIT)
        self._settled = np.zeros(_FITS + 1, FIT)
        self._state = np.zeros(STATE_WIDTH, np.int64)
        self._turns = list(ring_turns(self.scene.leds, self.normal_t))

    @property
    def is_exhausted(self) -> bool:
        """Return whether the searches of the pair have taken all of their time, so that not all poses were tried."""
        return self._triples <= 0

    def begin_pair(self, motion: TargetMotion | None, vibration_px: float) -> None:
        """Allow the searches of another pair of images their time, and set its motion and the vibration of the cameras.

        motion: of the target between the exposures of cameras and rows; None: unknown, of usual rates. A target that
        moves between them is one at rest for a right camera that moves the other way.
        """
        self._triples = _MOST_TRIPLES
        motion = motion or _USUAL_MOTION
        variance = (vibration_px / float(self.scene.lens[0]["fx"])) ** 2
        if self._sync_s or variance != self.scene.vibration:
            tolerance = _with_motion(self.scene, self._still, self._sync_s, motion)
            tolerance[_TURNED_RIGHT, _TURNED_RIGHT] += variance
            self.scene = self.scene._replace(tolerance=tolerance, vibration=variance)
        if self._rolling:
            self.scene = self.scene._replace(motion=motion.table)

    def view(self, left: np.ndarray, right: np.ndarray) -> View:
        """Return the spots (SPOT) of both images as rays; of more than MAX_SPOTS the brightest."""
        rays, counts = np.zeros((2, MAX_SPOTS), SPOT_RAY), np.zeros(2, np.int64)
        order, near = np.zeros((2, MAX_SPOTS), np.int64), np.zeros((2, CELLS, CELLS), np.uint8)
        for c, spots in enumerate((left, right)):
            chosen = np.arange(len(spots))
            if len(spots) > MAX_SPOTS:
                chosen = np.sort(np.argsort(spots["flux"])[::-1][:MAX_SPOTS])
            fill_view(self.scene.lens[c], self.slack[c], spots, chosen, rays[c], near[c])
            counts[c] = len(chosen)
            order[c, : len(chosen)] = chosen
        return View(rays, counts, order, near)

    def hypotheses(self, view: View, prediction: Prediction | None = None, level: int = 0) -> tuple[np.ndarray, bool]:
        """Return all distinct poses (FIT) that the spots allow, and whether none was dropped for lack of capacity.

        level: above 0, only poses by this number of spots of one camera or more are searched, which costs less. The
        prediction only admits hypotheses that are not significant without it: three spots of a single camera.
        """
        self._search.predicted, self._search.level = 0, level
        if prediction is not None:
            sigma = np.sqrt(np.diag(prediction.covariance))
            angle = min(_COARSE * float(np.linalg.norm(sigma[3:])), math.pi)
            self._search.predicted = 1
            self._search.r, self._search.t = matrix_of(prediction.q_vt), prediction.t_v
            self._search.away = _COARSE * float(np.linalg.norm(sigma[:3]))
            self._search.least_trace = 1.0 + 2.0 * math.cos(angle)
        self._search.most_triples = max(self._triples, 0)
        count = search(self.scene, view, self._search, self._starts, self._fits, self._state)
        complete = not self._state[STATE_FULL]
        self._triples -= int(self._state[STATE_TRIPLES] + _TRIPLES_PER_START * self._state[STATE_STARTS])
        fits = self._fit(view, self._fits[:count])
        turned = [turn for fit in fits[np.argsort(fits["score"])[::-1][:_TURNED]] for turn in self._turned(fit)]
        if turned:
            fits = self._fit(view, np.concatenate([fits, *turned]))
        return fits, complete

    def from_start(self, view: View, r: Array, t: Array, spots: npt.NDArray[np.int64]) -> np.ndarray:
        """Return the pose (FIT) fitted from a start with first ``spots`` (2, MAX_LEDS), and its mirror image.

        If no pose passes its test without a floor, those with the ring turned onto itself are added.
        """
        start = np.zeros(1, FIT)
        start["r"], start["t"], start["spot"] = r, t, spots
        fits = self._fit(view, start)
        if any(fits_within_budget(fit) for fit in fits):
            return fits
        turned = [turn for fit in fits[:1] for turn in self._turned(fit)]
        return self._fit(view, np.concatenate([fits, *turned])) if turned else fits

    def _fit(self, view: View, starts: np.ndarray) -> np.ndarray:
        """Return the distinct poses (FIT) within the error budget that follow from ``starts``, with their scores."""
        self._state[:] = 0
        density = self.stray_density(view)
        for start in starts[np.lexsort((starts["chi2"], -starts["points"]))]:
            add_settled(self.scene, view, self._search, density, start, self._settled, self._state)
        return self._settled[: self._state[STATE_FITS]].copy()

    def _turned(self, fit: np.void) -> list[np.ndarray]:
        """Return a start (FIT) for every turn of the ring onto itself: the same spots, each of another LED."""
        starts = []
        for turn, moved in self._turns:
            start = np.zeros(1, FIT)
            start["spot"] = -1
            start["r"] = fit["r"] @ turn.T
            start["t"] = fit["t"] + (fit["r"] - start["r"][0]) @ self.centre_t
            for n, m in enumerate(moved):
                start["spot"][0, :, m] = fit["spot"][:, n]
            starts.append(start)
        return starts

    def expected(
        self, view: View, r: Array, t: Array, covariance: Array, reach_px: float
    ) -> tuple[npt.NDArray[np.int64], int]:
        """Return the spots (2, MAX_LEDS) within the gates of a predicted pose, and the number of ambiguous gates."""
        spots = np.full((2, MAX_LEDS), -1, np.int64)
        return spots, assign(self.scene, view, r, t, covariance, reach_px, spots)

    def windows(self, prediction: Prediction) -> tuple[Array, Array]:
        """Return the windows (k, 4), px, of the predicted LEDs per camera: first pixel u, v, last pixel + 1."""
        out, counts = np.empty((2, len(self.scene.leds), 4)), np.zeros(2, np.int64)
        led_windows(self.scene, matrix_of(prediction.q_vt), prediction.t_v, prediction.covariance, out, counts)
        return out[0, : counts[0]], out[1, : counts[1]]

    def stray_density(self, view: View) -> Array:
        """Return the density of stray lights in each image used for the scores, px^-2, (2,)."""
        lens = self.scene.lens
        density: Array = _STRAY_FACTOR * (view.counts + 1.0) / (lens["width"] * lens["height"])
        return density

    def is_linear(self, view: View, fit: np.void) -> bool:
        """Return whether chi-square grows quadratically, as its covariance, along the two least certain rotations.

        For a flat target with a tilt of m sigmas, chi-square at zero tilt is m^2 / 4 above its minimum, and at n sigmas
        towards it (1 - n / 2m)^2 of the quadratic value: the test at five sigmas passes for m >= 11, for which the
        chi-square barrier to the mirror image is 31.
        """
        turn = fit["covariance"][3:, 3:]
        values, vectors = np.linalg.eigh(turn)
        for k in (1, 2):  # the tilt axis and the one perpendicular to it may be equally uncertain
            direction = fit["covariance"][:, 3:] @ vectors[:, k] / math.sqrt(values[k])
            ratios = [chi_square_growth(self.scene, view, fit, direction, sigmas) for sigmas in (-_FAR, _FAR)]
            if not all(_LINEAR[0] <= ratio <= _LINEAR[1] for ratio in ratios):
                return False
        return True


def scene_of(geometry: VmuGeometry, settings: SolverSettings) -> RingScene:
    """Return the scene record of ``geometry`` for the kernels."""
    pair, leds = camera_pair(geometry), led_positions(geometry)
    squares = ((leds[:, None, :] - leds[None, :, :]) ** 2).sum(axis=2)
    least_facing = math.cos(math.radians(settings.steepest_deg))
    n = len(leds)
    sides = np.array(
        [[[orientation_of(leds, p, q, s, least_facing) for s in range(n)] for q in range(n)] for p in range(n)],
        np.int64,
    )
    tolerance, floors = considered_covariance(geometry), spot_floors(geometry.tolerances.spot_px)
    moved = _USUAL_MOTION.table
    return RingScene(pair.lens, pair.rotation, pair.translation, leds, squares, sides, tolerance, floors, moved, 0.0)


def _with_motion(scene: RingScene, still: Array, sync_s: float, motion: TargetMotion) -> Array:
    """Return the covariance ``still`` of the considered parameters with the motion between the exposures added.

    With rates v, w of a target at t, and a right camera at b with axes R, the right image of ``sync_s`` later is that
    of a camera turned by ``-R.T w sync_s`` and at ``b + (w x (t - b) - v) sync_s``.
    """
    arm = motion.t_v + scene.rotation[1].T @ scene.translation[1]
    turn = np.array([[0.0, -arm[2], arm[1]], [arm[2], 0.0, -arm[0]], [-arm[1], arm[0], 0.0]])
    moved = np.block([[np.zeros((3, 3)), -scene.rotation[1]], [-np.eye(3), -turn]])
    second_moment = np.outer(motion.rates, motion.rates) + motion.covariance
    covariance = still.copy()
    covariance[SHARED - 6 : SHARED, SHARED - 6 : SHARED] += sync_s**2 * moved @ second_moment @ moved.T
    return covariance


def _slack(scene: RingScene) -> Array:
    """Return the variance per camera, px^2, that gates and search add: of the tolerances at a typical range."""
    n = len(scene.leds)
    which = np.array([[c, led] for c in range(2) for led in range(n)])
    eq = equations(which)
    fill_shared(scene, np.eye(3), np.array([0.0, 0.0, _TYPICAL_RANGE_M]), eq)
    variances = np.diag(eq.shared).reshape(2, 2 * n).max(axis=1)
    slack: Array = variances + OPTICS_PX**2
    return slack


def ring_turns(leds: Array, normal: Array) -> Iterator[tuple[Array, npt.NDArray[np.int64]]]:
    """Yield the rotations (3, 3) about ``normal`` that take the LEDs nearly onto each other, and where each LED goes.

    Offsets along ``normal`` do not count: a raised LED makes the ring unique, but only just, if it is far away.
    """
    flat = leds - leds.mean(axis=0)
    flat = flat - np.outer(flat @ normal, normal)
    apart = np.linalg.norm(flat[:, None] - flat[None, :], axis=2)
    reach = _SAME_TURN * float(apart[apart > 0.0].min(initial=np.inf))
    for m in range(1, len(leds)):
        cosine, sine = float(flat[0] @ flat[m]), float(normal @ np.cross(flat[0], flat[m]))
        turn = quat.to_matrix(quat.from_rotation_vector(-math.atan2(sine, cosine) * normal))
        away = np.linalg.norm((flat @ turn.T)[:, None] - flat[None, :], axis=2)
        moved = away.argmin(axis=1)
        if away.min(axis=1).max() < reach and len(set(moved.tolist())) == len(leds):
            yield turn, moved


def thin_axis(leds: Array) -> Array:
    """Return the unit vector (3,) along which the LEDs spread least."""
    _, _, axes = np.linalg.svd(leds - leds.mean(axis=0))
    normal: Array = np.ascontiguousarray(axes[2])
    return normal


def is_flat(leds: Array) -> bool:
    """Return whether ``leds`` (n, 3) are coplanar within the resolution of the cameras."""
    spread = np.linalg.svd(leds - leds.mean(axis=0), compute_uv=False)
    return len(leds) < 4 or bool(spread[2] < _FLAT * spread[0])


def fits_within_budget(fit: np.void) -> bool:
    """Return whether the residuals need no more than noise and tolerances as stated."""
    return bool(fit["misfit"] <= chi_square_limit(2 * int(fit["points"]) - 6))


def attitude_sigma_deg(fit: np.void) -> float:
    """Return the standard deviation of the least certain rotation."""
    return math.degrees(math.sqrt(float(np.linalg.eigvalsh(fit["covariance"][3:, 3:])[-1])))


def matrix_of(q_vt: Array) -> Array:
    """Return R (3, 3) with ``p_v = R p_t + t_v``."""
    r: Array = quat.to_matrix(q_vt)
    return r
