"""Pose solver: typed interface to the kernels of search, assignment and refinement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.maths import quat
from hil.vmu.geometry import camera_pair, led_positions
from hil.vmu.kernels.hypotheses import chi_square_growth
from hil.vmu.kernels.match import assign, fill_spot_ray, led_windows, score_fit
from hil.vmu.kernels.pose_search import SEARCH, STATE_FITS, STATE_FULL, add_converged, search
from hil.vmu.kernels.records import FIT, MAX_LEDS, MAX_SPOTS, SPOT_RAY, RingScene, View
from hil.vmu.kernels.start_poses import orientation_of

_REMEMBERED, _FITS = 256, 64
_COARSE = 5.0  # sigmas
_LINEAR = (0.6, 1.7)  # growth of chi-square relative to the covariance for which it is valid
_FAR = 5.0  # sigmas
_FLAT = 0.05  # thickness over extent
_STRAY_FACTOR = 10.0  # density of stray lights near the target relative to the whole image


@dataclass(frozen=True, slots=True)
class SolverSettings:
    """Settings of identification and pose.

    near_m, far_m: range of the target. steepest_deg: largest angle between the target's axis -z_t and the line of
    sight. reach_px: largest initial distance of a spot from an LED's projection. decisive: logarithm of the odds at
    which one hypothesis is accepted and another one dropped. false_alarms: expected number of random patterns per image
    at which a pattern without a track is accepted. largest_sigma_deg: of the attitude, above which no pose is reported,
    if the LEDs in use are coplanar, and if not.
    """

    near_m: float = 0.2
    far_m: float = 25.0
    steepest_deg: float = 70.0
    reach_px: float = 1.5
    decisive: float = 8.0
    false_alarms: float = 1e-4
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


class Solver:
    """Scene and scratch memory of one vision unit."""

    def __init__(self, geometry: VmuGeometry, settings: SolverSettings) -> None:
        self.settings = settings
        self.scene = scene_of(geometry, settings)
        self.normal_t = thin_axis(self.scene.leds)
        self.centre_t = np.asarray(self.scene.leds.mean(axis=0))
        self._search = np.zeros(1, SEARCH).view(np.recarray)[0]
        self._search.near, self._search.far = settings.near_m, settings.far_m
        self._search.least_facing = math.cos(math.radians(settings.steepest_deg))
        self._search.reach_px = settings.reach_px
        self._search.gate_px = 2.0 * settings.reach_px
        self._search.normal, self._search.centre = self.normal_t, self.centre_t
        self._starts = np.zeros(_REMEMBERED + 1, FIT)
        self._fits = np.zeros(_FITS + 1, FIT)
        self._state = np.zeros(4, np.int64)

    def view(self, left: np.ndarray, right: np.ndarray) -> View:
        """Return the spots (SPOT) of both images as rays; of more than MAX_SPOTS the brightest."""
        rays, counts = np.zeros((2, MAX_SPOTS), SPOT_RAY), np.zeros(2, np.int64)
        order = np.zeros((2, MAX_SPOTS), np.int64)
        for c, spots in enumerate((left, right)):
            chosen = np.arange(len(spots))
            if len(spots) > MAX_SPOTS:
                chosen = np.sort(np.argsort(spots["flux"])[::-1][:MAX_SPOTS])
            for k, index in enumerate(chosen):
                fill_spot_ray(self.scene.lens[c], spots[index], rays[c, k])
            counts[c] = len(chosen)
            order[c, : len(chosen)] = chosen
        return View(rays, counts, order)

    def hypotheses(self, view: View, prediction: Prediction | None = None) -> tuple[np.ndarray, bool]:
        """Return all distinct poses (FIT) that the spots allow, and whether none was dropped for lack of capacity.

        The prediction only admits hypotheses that are not significant without it: three spots of a single camera.
        """
        self._search.predicted = 0
        if prediction is not None:
            sigma = np.sqrt(np.diag(prediction.covariance))
            angle = min(_COARSE * float(np.linalg.norm(sigma[3:])), math.pi)
            self._search.predicted = 1
            self._search.r, self._search.t = matrix_of(prediction.q_vt), prediction.t_v
            self._search.away = _COARSE * float(np.linalg.norm(sigma[:3]))
            self._search.least_trace = 1.0 + 2.0 * math.cos(angle)
        count = search(self.scene, view, self._search, self._starts, self._fits, self._state)
        return self._scored(view, count), not self._state[STATE_FULL]

    def from_start(self, view: View, r: Array, t: Array, spots: npt.NDArray[np.int64]) -> np.ndarray:
        """Return the pose (FIT) converged from a start with first ``spots`` (2, MAX_LEDS), and its mirror image."""
        self._state[:] = 0
        start = self._starts[-1]
        start["r"], start["t"], start["spot"] = r, t, spots
        add_converged(self.scene, view, self._search, start, self._fits, self._state)
        return self._scored(view, self._state[STATE_FITS])

    def _scored(self, view: View, count: int) -> np.ndarray:
        density = self.stray_density(view)
        for fit in self._fits[:count]:
            score_fit(self.scene, view, density, fit)
        return self._fits[:count].copy()

    def expected(
        self, view: View, r: Array, t: Array, covariance: Array, reach_px: float
    ) -> tuple[npt.NDArray[np.int64], int]:
        """Return the spots (2, MAX_LEDS) within the gates of a predicted pose, and the number of ambiguous gates."""
        spots = np.full((2, MAX_LEDS), -1, np.int64)
        barred = np.full((2, MAX_LEDS), -1, np.int64)
        return spots, assign(self.scene, view, r, t, covariance, reach_px, barred, spots)

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
    return RingScene(pair.lens, pair.rotation, pair.translation, leds, squares, sides)


def thin_axis(leds: Array) -> Array:
    """Return the unit vector (3,) along which the LEDs spread least."""
    _, _, axes = np.linalg.svd(leds - leds.mean(axis=0))
    normal: Array = np.ascontiguousarray(axes[2])
    return normal


def is_flat(leds: Array) -> bool:
    """Return whether ``leds`` (n, 3) are coplanar within the resolution of the cameras."""
    spread = np.linalg.svd(leds - leds.mean(axis=0), compute_uv=False)
    return len(leds) < 4 or bool(spread[2] < _FLAT * spread[0])


def attitude_sigma_deg(fit: np.void) -> float:
    """Return the standard deviation of the least certain rotation."""
    return math.degrees(math.sqrt(float(np.linalg.eigvalsh(fit["covariance"][3:, 3:])[-1])))


def matrix_of(q_vt: Array) -> Array:
    """Return R (3, 3) with ``p_v = R p_t + t_v``."""
    r: Array = quat.to_matrix(q_vt)
    return r
