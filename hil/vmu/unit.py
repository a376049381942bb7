"""Vision unit: from a stereo pair of images to a pose with status and covariance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from hil.config.load import load_geometry
from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import POSITION_ONLY, UNKNOWN_ATTITUDE_RAD, Array, PoseFrame
from hil.core.public import public
from hil.maths import quat
from hil.vmu import refusals
from hil.vmu.consistency import Consistency
from hil.vmu.detect import SpotDetector
from hil.vmu.flicker import Flicker
from hil.vmu.ghosts import LensGhosts
from hil.vmu.identify import (
    AMBIGUOUS,
    GEOMETRY,
    GEOMETRY_FILE,
    NO_MATCH,
    NOT_TOGETHER,
    OK,
    TOO_FEW,
    Identifier,
    LedIdentification,
)
from hil.vmu.kernels.hypotheses import difference
from hil.vmu.kernels.lens import project
from hil.vmu.kernels.records import SPOT, RingScene, View
from hil.vmu.kernels.refine import place_when_seen
from hil.vmu.long_sample import LongSample
from hil.vmu.partial import PartialPose, partial_pose
from hil.vmu.pose import Prediction, Solver, SolverSettings
from hil.vmu.reflections import Doubt, doubt_of_lights
from hil.vmu.track import Track, TrackSettings
from hil.vmu.vibration import Vibration, with_pointing

PREDICTED: Final = "predicted"
SUSPECT: Final = "suspect"
RESIDUALS: Final = "residuals"
WRONG_SIZE: Final = "rejected_size"
DARK: Final = "rejected_dark"
BACKGROUND: Final = "rejected_background"
BUDGET: Final = "rejected_time"
BRIGHT: Final = "rejected_bright"
CROWDED: Final = "rejected_crowded"

_NO_SPOTS: Final = np.zeros(0, SPOT)
_OPEN_TILT_RAD, _OPEN_TURN_RAD = 0.15, 0.03
_BRIGHT_FRACTION = 0.1  # of the pixels at full scale: more than LEDs cover
_SWAPPED_TRIED = 3  # pairs that are compared with the opposite baseline
_WINDOW_LIMIT = 0.6  # fraction of the image: larger windows are no faster than the whole image
_FAINT_SNR = 25.0  # signal-to-noise ratio of a light beyond which no other of its kind is lost in noise
_USUAL_SHIFT = 2.0  # sigmas between the two images
_USUAL_SCALE = 2.3  # sigmas of the residuals' scale, which one good pair in a hundred exceeds
_LARGEST_SCALE = 4.0  # of the residuals: beyond it cameras or ring are not those of the geometry file


@dataclass(frozen=True, slots=True)
class Pose:
    """``p_v = A(q_vt) p_t + t_v``. covariance: (6, 6) of t_v and of e about v's axes, ``R_est = exp([e]x) R_true``.

    noise: (6, 6), the part of it that is independent between images. The rest is of the calibration, the LEDs and the
    optics: it changes slowly along an approach, and an average over images does not reduce it.
    """

    t_v: Array
    q_vt: Array
    covariance: Array
    noise: Array

    @property
    def rotation_vector(self) -> Array:
        """Return the rotation vector (3,), rad, of R with ``p_v = R p_t + t_v``."""
        phi: Array = -quat.to_rotation_vector(self.q_vt)
        return phi


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of one stereo pair.

    status: ``ok``, ``predicted``, ``suspect``, ``ok_position``, ``ok_sight``, ``ambiguous``, ``too_few`` or
    ``rejected_<why>``. pose: with the first three only. partial: with the next two only.
    spots: SPOT of each image, as far as it was searched. leds: for each image, the index into spots of each
    LED, -1 for none. chi2, degrees: of the fit. candidates: number of remaining poses. epipolar_px: root mean square
    distance of the right spots from the epipolar lines of the left ones, NaN unless both images have spots of an LED.
    scale: of the residuals relative to noise and tolerances as stated, 1 if these are right. doubt: what makes the pose
    ``suspect``, and by how much.
    """

    t_s: float
    status: str
    pose: Pose | None
    spots: tuple[np.ndarray, np.ndarray]
    leds: tuple[tuple[int, ...], tuple[int, ...]]
    chi2: float = float("nan")
    degrees: int = 0
    candidates: int = 0
    full_frame: bool = True
    epipolar_px: float = math.nan
    scale: float = math.nan
    doubt: Doubt | None = None
    partial: PartialPose | None = None

    @property
    def t(self) -> Array:
        """Position of the target's frame t in the left camera's frame v, (3,), m; nan without pose and position."""
        if self.pose is not None:
            return self.pose.t_v
        return np.full(3, np.nan) if self.partial is None or self.partial.t_v is None else self.partial.t_v

    @property
    def R(self) -> Array:
        """Rotation matrix, (3, 3), t to v: ``p_v = R p_t + t``; nan without a pose."""
        if self.pose is None:
            return np.full((3, 3), np.nan)
        rotation: Array = quat.to_matrix(self.pose.q_vt)
        return rotation

    @property
    def covariance(self) -> Array:
        """Covariance, (6, 6), of t and of the small rotation e about v's axes, ``R_est = exp([e]x) R_true``.

        m^2, m rad, rad^2; nan without a pose, infinite variances of e with a position alone.
        """
        if self.pose is not None:
            return self.pose.covariance
        covariance = np.full((6, 6), np.nan)
        if self.partial is not None and self.partial.covariance is not None:
            covariance = np.diag(np.full(6, np.inf))
            covariance[:3, :3] = self.partial.covariance
        return covariance

    @property
    def n_leds(self) -> int:
        """Return the number of LEDs used from at least one camera."""
        return sum(1 for pair in zip(*self.leds, strict=True) if max(pair) >= 0)

    def bits(self, camera: int) -> int:
        """Return the LEDs used of a camera, bit n for LED n."""
        return sum(1 << n for n, k in enumerate(self.leds[camera]) if k >= 0)

    def frame(self, counter: int, received_s: float, only_noise: bool = False) -> PoseFrame | None:
        """Return the measured pose as the bench's message, None without one.

        A position alone has the status POSITION_ONLY. only_noise: the covariance of a pose is that of the part that is
        independent between images.
        """
        partial = self.partial
        if partial is not None and partial.t_v is not None:
            covariance = np.diag(np.full(6, UNKNOWN_ATTITUDE_RAD**2))
            covariance[:3, :3] = partial.covariance
            return PoseFrame(counter, self.t_s, received_s, partial.t_v, partial.q_vt, covariance, 0, 0, POSITION_ONLY)
        if self.pose is None or self.status != OK:
            return None
        p = self.pose
        bits = self.bits(0), self.bits(1)
        covariance = p.noise if only_noise else p.covariance
        return PoseFrame(counter, self.t_s, received_s, p.t_v, p.q_vt, covariance, bits[0], bits[1])


@public
class VisionUnit:
    """Solves stereo pairs one after the other, with a track between them. Not thread-safe.

    geometry: cameras and LEDs, or the path of their file, TOML or JSON; raises BadInput for an invalid file.
    """

    def __init__(
        self,
        geometry: VmuGeometry | str | Path,
        settings: SolverSettings | None = None,
        track: TrackSettings | None = None,
    ) -> None:
        self.geometry = geometry if isinstance(geometry, VmuGeometry) else load_geometry(str(geometry)).value
        geometry = self.geometry
        self.solver = Solver(geometry, settings or SolverSettings())
        self.track = Track(track or TrackSettings())
        self._jump = Track(self.track.settings)
        self._sample = LongSample()
        self._identifier = Identifier(self.solver, geometry.marked_led)
        self._flicker = tuple(Flicker(camera.row_time_s or 0.0) for camera in (geometry.left, geometry.right))
        self._vibration = Vibration(geometry.tolerances.vibration_px)
        self._consistency = Consistency(self.solver.scene, geometry.tolerances.sync_s)
        self._shapes = tuple((camera.height, camera.width) for camera in (geometry.left, geometry.right))
        self._detectors = tuple(SpotDetector(shape, sensor=geometry.sensor) for shape in self._shapes)
        self._none = tuple([-1] * len(geometry.leds_m))
        self._swapped: VisionUnit | None = None
        self._swapped_tried, self._fits_opposite = 0, False

    @public
    def solve(
        self, left: np.ndarray | None, right: np.ndarray | None, t_s: float, prediction: Prediction | None = None
    ) -> Solution:
        """Return the solution of the images (h, w), uint8, taken at ``t_s``; None for a missing image.

        prediction: of the pose at ``t_s``, if better known than by constant rates (from a gyro).
        """
        images = (left, right)
        for side, image, shape in zip(("left", "right"), images, self._shapes, strict=True):
            if image is not None and not _fits(image, shape):
                actual = " x ".join(map(str, image.shape))
                text = f"{side} image is {actual} {image.dtype}, expected {shape[0]} x {shape[1]} uint8 (rows, columns)"
                return Solution(t_s, WRONG_SIZE, None, (_NO_SPOTS, _NO_SPOTS), (self._none,) * 2, doubt=Doubt(text))
        if left is None and right is None:
            return self._predicted(t_s, TOO_FEW)
        expected = prediction or self.track.predict(t_s)
        self.solver.begin_pair(self.track.motion(t_s), self._vibration.sigma_px)
        solution = self._by_windows(images, t_s, expected) if expected is not None else None
        solution = solution or self._by_search(images, t_s, expected)
        if solution.status not in (CROWDED, BUDGET):  # of which some lights are missing
            for camera, lights in zip(self._flicker, solution.spots, strict=True):
                camera.add(lights)
        if solution.status in (OK, SUSPECT):
            return solution
        why = refusals.blooming(images) or next(filter(None, (camera.reason() for camera in self._flicker)), "")
        return replace(solution, doubt=Doubt(why)) if why else solution

    @property
    def ghosts(self) -> tuple[LensGhosts, ...]:
        """Return what the lens of each camera makes of its lights, as learnt so far."""
        return self._identifier.ghosts

    def warm_up(self) -> None:
        """Call every kernel once, which compiles it after a change of the sources."""
        ahead, facing = np.array([0.0, 0.0, 3.0]), np.eye(3)
        left, right = (self._ideal_spots(c, facing, ahead) for c in range(2))
        view = self.solver.view(left, right)
        fits, _ = self.solver.hypotheses(view)
        for fit in fits[:1]:
            self.solver.is_linear(view, fit)
            self.solver.expected(view, fit["r"], fit["t"], fit["covariance"], 1.0)
        track, self.track = self.track, Track(self.track.settings)
        consistency, self._consistency = self._consistency, Consistency(self.solver.scene, 0.0)
        for t_s in (0.0, 0.1, 0.2):
            self.solve_spots(left, right, t_s, Prediction(ahead, np.array([0.0, 0.0, 0.0, 1.0]), 1e-6 * np.eye(6)))
        self.track, self._consistency = track, consistency
        self.solver.windows(Prediction(ahead, np.array([0.0, 0.0, 0.0, 1.0]), 1e-6 * np.eye(6)))
        for detector, shape in zip(self._detectors, self._shapes, strict=True):
            image = np.full(shape, 10, np.uint8)
            detector.spots(image)
            detector.spots(image, np.array([[0.0, 0.0, 8.0, 8.0]]))

    def _ideal_spots(self, camera: int, r: Array, t: Array) -> np.ndarray:
        """Return the spots of all LEDs in one camera without noise."""
        scene, arm, point = self.solver.scene, np.empty(3), np.empty(3)
        spots = np.zeros(len(scene.leds), SPOT)
        for spot, led in zip(spots, scene.leds, strict=True):
            place_when_seen(scene, camera, led, r, t, arm, point)
            spot["u"], spot["v"] = project(scene.lens[camera], point[0], point[1], point[2])
            spot["var_u"] = spot["var_v"] = 0.01
        return spots

    def solve_spots(
        self, left: np.ndarray, right: np.ndarray, t_s: float, prediction: Prediction | None = None
    ) -> Solution:
        """Return the solution of spots (SPOT) of the whole images; see ``solve``."""
        expected = prediction or self.track.predict(t_s)
        self.solver.begin_pair(self.track.motion(t_s), self._vibration.sigma_px)
        view = self.solver.view(left, right)
        verdict = self._identifier.tracked(view, expected) if expected is not None and not self._recheck() else None
        verdict = verdict or self._identifier.search(view, expected, self.track.is_mature)
        return self._conclude(verdict, view, (left, right), t_s, full_frame=True)

    def _by_windows(
        self, images: tuple[np.ndarray | None, np.ndarray | None], t_s: float, expected: Prediction
    ) -> Solution | None:
        """Return the solution from windows around the predicted LEDs, None if the whole images are needed.

        Where LEDs are missing, weak lights are taken too: in so few pixels noise is hardly one of them.
        """
        if self._recheck():
            return None
        regions = self.solver.windows(expected)
        if any(_area(r) > _WINDOW_LIMIT * s[0] * s[1] for r, s in zip(regions, self._shapes, strict=True)):
            return None
        for weak in (False, True):
            spots = self._detect(images, regions, weak)
            view = self.solver.view(*spots)
            verdict = self._identifier.tracked(view, expected)
            if verdict is not None and verdict.status == OK:
                return self._conclude(verdict, view, spots, t_s, full_frame=False)
            if min(map(len, spots)) >= min(map(len, regions)):
                break
        return None

    def _by_search(
        self, images: tuple[np.ndarray | None, np.ndarray | None], t_s: float, expected: Prediction | None
    ) -> Solution:
        spots = self._detect(images, (None, None), weak=False)
        is_overfull = any(detector.overfull for detector in self._detectors)
        view = self.solver.view(*spots)
        verdict = self._identifier.search(view, expected, self.track.is_mature)
        is_complete = not (is_overfull or self._is_exhausted)
        if is_complete and verdict.fit is None and not verdict.jump and self._may_be_faint(spots):
            verdict, view, spots = self._by_faint_lights(images, t_s, expected) or (verdict, view, spots)
        if verdict.status in (TOO_FEW, NO_MATCH) and not (is_overfull or self._is_exhausted):
            verdict, view, spots = self._before_steps(images, expected) or (verdict, view, spots)
        if verdict.fit is None and not verdict.jump and any(is_bright(image) for image in images):
            clipped = max(refusals.overexposed(image) for image in images if image is not None)
            return self._no_pose(
                t_s, BRIGHT, f"{100.0 * clipped:.0f} % of an image at full scale: shorten the exposure"
            )
        if not any(len(side) for side in spots):
            return self._without_light(images, t_s, is_overfull)
        if self._is_exhausted and verdict.status in (TOO_FEW, NO_MATCH, GEOMETRY):
            return replace(self._predicted(t_s, BUDGET, spots), doubt=Doubt(refusals.reason_of_time(images, spots)))
        solution = self._conclude(verdict, view, spots, t_s, full_frame=True)
        if solution.pose is not None or solution.partial is not None or solution.doubt is not None:
            return solution
        settings = self.solver.settings
        why = refusals.reason(verdict, spots, len(self._none), settings, lambda: self._fits_swapped(spots))
        return replace(solution, doubt=Doubt(why)) if why else solution

    @property
    def _is_exhausted(self) -> bool:
        """Return whether searches or fits of the pair have taken all of their time."""
        return self.solver.is_exhausted or any(detector.is_exhausted for detector in self._detectors)

    def _without_light(
        self, images: tuple[np.ndarray | None, np.ndarray | None], t_s: float, is_overfull: bool
    ) -> Solution:
        """Return the result for images without a spot."""
        if is_overfull:
            return self._no_pose(t_s, CROWDED, "too many lights: shorten the exposure, or darken what is behind")
        brightest, above = refusals.contrast(images)
        if above < refusals.DARK_LEVELS:
            return self._no_pose(
                t_s, DARK, f"brightest pixel {brightest} levels: LEDs off, lens covered, short exposure?"
            )
        why = f"brightest pixel {brightest} levels, but no light stands out: darken what is behind"
        return self._no_pose(t_s, BACKGROUND, why)

    def _fits_swapped(self, spots: tuple[np.ndarray, np.ndarray]) -> bool:
        """Return whether the spots have a pose with the opposite baseline; only the first few pairs are tried."""
        if self._swapped is None:
            opposite = tuple(-x for x in self.geometry.baseline_m)
            self._swapped = VisionUnit(self.geometry.model_copy(update={"baseline_m": opposite}), self.solver.settings)
        if not self._fits_opposite and self._swapped_tried < _SWAPPED_TRIED:
            self._swapped_tried += 1
            self._swapped.track.drop()
            self._fits_opposite = self._swapped.solve_spots(*spots, 0.0).status == OK
        return self._fits_opposite

    def _by_faint_lights(
        self, images: tuple[np.ndarray | None, np.ndarray | None], t_s: float, expected: Prediction | None
    ) -> tuple[LedIdentification, View, tuple[np.ndarray, np.ndarray]] | None:
        """Return identification, view and spots with weak lights too, or without a track by a long sample.

        None if no pose fits them.
        """
        spots = self._detect(images, (None, None), weak=True)
        view = self.solver.view(*spots)
        verdict = self._identifier.search(view, expected, self.track.is_mature)
        if verdict.fit is None and expected is None and (lights := self._sample.add(t_s, spots)) is not None:
            long = self.solver.view(*lights)
            identification = self._identifier.search(long, None)
            if identification.fit is not None:
                return replace(identification, fit=self._sample.accelerated(identification.fit)), long, lights
        return (verdict, view, spots) if verdict.status in (OK, AMBIGUOUS) else None

    def _before_steps(
        self, images: tuple[np.ndarray | None, np.ndarray | None], expected: Prediction | None
    ) -> tuple[LedIdentification, View, tuple[np.ndarray, np.ndarray]] | None:
        """Return identification, view and spots of lights before a background of steps; None if no pose fits them."""
        spots = self._detect(images, (None, None), weak=False, steps=True)
        if any(detector.overfull for detector in self._detectors):
            return None
        view = self.solver.view(*spots)
        verdict = self._identifier.search(view, expected, self.track.is_mature)
        return (verdict, view, spots) if verdict.status in (OK, AMBIGUOUS) else None

    def _may_be_faint(self, spots: tuple[np.ndarray, np.ndarray]) -> bool:
        """Return whether LEDs are missing in an image, and the few lights that it shows are weak."""
        n, both = len(self._none), np.concatenate(spots)
        if min(map(len, spots)) >= n or max(map(len, spots)) > 2 * n:
            return False
        return not len(both) or float(np.median(2.0 * both["size"] ** 2 / both["var_u"])) < _FAINT_SNR**2

    def _detect(
        self,
        images: tuple[np.ndarray | None, np.ndarray | None],
        regions: tuple[Array | None, Array | None],
        weak: bool,
        steps: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        (left, right), (of_left, of_right) = images, regions
        if left is None or right is None or of_left is not None or of_right is not None:
            return self._spots(0, left, of_left, weak, steps), self._spots(1, right, of_right, weak, steps)
        with ThreadPoolExecutor(1) as beside:  # whole images take milliseconds, and the kernel leaves the interpreter
            of_right_image = beside.submit(self._spots, 1, right, None, weak, steps)
            return self._spots(0, left, None, weak, steps), of_right_image.result()

    def _spots(
        self, camera: int, image: np.ndarray | None, region: Array | None, weak: bool, steps: bool
    ) -> np.ndarray:
        if image is None:
            return _NO_SPOTS
        return self._detectors[camera].spots(image, region, weak, steps, retry=weak or steps)

    def _recheck(self) -> bool:
        every = self.track.settings.recheck
        return self.track.failures == 0 < self.track.poses and self.track.poses % every == 0

    def _conclude(
        self, verdict: LedIdentification, view: View, spots: tuple[np.ndarray, np.ndarray], t_s: float, full_frame: bool
    ) -> Solution:
        kept = view.order
        if verdict.jump:
            verdict = self._confirmed(verdict, t_s)
        if verdict.fit is None:
            if verdict.status == AMBIGUOUS:
                if verdict.on_track:
                    self.track.update(t_s, widened(verdict.candidates))
                else:
                    self.track.fail()
                return self._partly(verdict, view, spots, t_s)
            if verdict.status in (NOT_TOGETHER, GEOMETRY_FILE):
                self.track.fail()
                return Solution(t_s, verdict.status, None, spots, (self._none, self._none))
            expected = self._predicted(t_s, verdict.status, spots)
            return expected if expected.pose is not None else self._partly(verdict, view, spots, t_s)
        self._sample.clear()
        fit = with_pointing(with_strained_tolerances(verdict.fit), self.solver.scene.vibration)
        self.track.update(t_s, fit)
        doubt = doubt_of_lights(self.solver.scene, view, fit)
        if self.track.poses == 1:
            self._consistency.restart()
        self._vibration.add(fit, is_first=self.track.poses == 1)
        if doubt is None:
            if self.solver.scene.vibration == 0.0:
                self._consistency.add(view, fit)
            doubt = self._consistency.doubt
            if self._consistency.refuses:
                return Solution(t_s, GEOMETRY_FILE, None, spots, (self._none, self._none), doubt=doubt)
        degrees, scale = residual_scale(fit)
        if doubt is None and scale > _LARGEST_SCALE:
            doubt = Doubt(RESIDUALS, scale, "times those stated: state spot_px, or calibrate")
        status = OK if doubt is None else SUSPECT
        pose = Pose(fit["t"].copy(), quat.from_matrix(fit["r"]), fit["covariance"].copy(), fit["noise"].copy())
        n = len(self._none)
        left, right = (tuple(int(kept[c][k]) if k >= 0 else -1 for k in fit["spot"][c][:n]) for c in range(2))
        candidates = len(verdict.candidates)
        distance_px = epipolar_distance(self.solver.scene, view, fit["spot"])
        return Solution(
            t_s, status, pose, spots, (left, right), float(fit["chi2"]), degrees, candidates, full_frame, distance_px,
            scale, doubt,
        )  # fmt: skip

    def _partly(
        self, verdict: LedIdentification, view: View, spots: tuple[np.ndarray, np.ndarray], t_s: float
    ) -> Solution:
        """Return the solution without a pose, with what all candidates agree on."""
        partial = partial_pose(verdict.candidates) if self._identifier.partly(view, verdict) else None
        if partial is not None and (
            self._consistency.doubt or doubt_of_lights(self.solver.scene, view, verdict.candidates[0])
        ):
            partial = None
        status = verdict.status if partial is None else partial.status
        candidates = len(verdict.candidates) if verdict.status == AMBIGUOUS else 0
        return Solution(t_s, status, None, spots, (self._none, self._none), candidates=candidates, partial=partial)

    def _confirmed(self, verdict: LedIdentification, t_s: float) -> LedIdentification:
        """Return a jump off the track as ``ok`` once it has come several times in a row; the old track then ends."""
        fit = verdict.candidates[0]
        if self.track.failures == 0:
            self._jump.drop()
        self._jump.update(t_s, fit)
        if self._jump.poses < self.track.settings.jumps:
            return verdict
        self.track.drop()
        return LedIdentification(OK, fit, verdict.candidates)

    def _predicted(
        self, t_s: float, status: str, spots: tuple[np.ndarray, np.ndarray] = (_NO_SPOTS, _NO_SPOTS)
    ) -> Solution:
        """Return the track's prediction, or ``status`` without a pose if there is no track of at least two poses."""
        expected = self.track.predict(t_s)
        tracked = expected is not None and self.track.poses > 1
        if spots[0] is not _NO_SPOTS:
            self.track.fail()
        if not tracked or expected is None:
            return Solution(t_s, status, None, spots, (self._none, self._none))
        pose = Pose(expected.t_v, expected.q_vt, expected.covariance, expected.covariance)
        return Solution(t_s, PREDICTED, pose, spots, (self._none, self._none))

    def _no_pose(self, t_s: float, status: str, why: str = "") -> Solution:
        doubt = Doubt(why) if why else None
        return Solution(t_s, status, None, (_NO_SPOTS, _NO_SPOTS), (self._none, self._none), doubt=doubt)


def residual_scale(fit: np.void) -> tuple[int, float]:
    """Return the degrees of freedom of the residuals of ``fit`` and their RMS over the stated; nan without any."""
    degrees = 2 * int(fit["points"]) - 6
    return degrees, math.sqrt(float(fit["misfit"]) / degrees) if degrees > 0 else math.nan


def with_strained_tolerances(fit: np.void) -> np.void:
    """Return ``fit`` with larger tolerances if its images are further apart than they usually are by those stated.

    The part of the covariance that is not noise grows with the square of the shift between the images. Residuals that
    are larger as a whole show the size of an error that is not stated, not its kind; of one that the spots share, as in
    the lens, the pose absorbs most. They count with the square of their scale.
    """
    degrees, scale = residual_scale(fit)
    unusual = scale > 1.0 + _USUAL_SCALE / math.sqrt(2.0 * max(degrees, 1))
    strain = max(float(np.abs(fit["shift"]).max()) / _USUAL_SHIFT, scale**2 if unusual else 1.0)
    if strain <= 1.0:
        return fit
    strained = fit.copy()
    strained["covariance"] = fit["noise"] + strain**2 * (fit["covariance"] - fit["noise"])
    return strained


def is_bright(image: np.ndarray | None) -> bool:
    """Return whether more of ``image`` is at or near full scale than LEDs can cover: its background is overexposed."""
    return image is not None and refusals.overexposed(image) > _BRIGHT_FRACTION


def epipolar_distance(scene: RingScene, view: View, spots: np.ndarray) -> float:
    """Return the root mean square distance, px, of the right spots from the epipolar lines of the left ones.

    spots: (2, MAX_LEDS), indices into the view's spots, -1 for none. NaN without an LED in both images.
    """
    both = spots[:, (spots >= 0).all(axis=0)]
    if not both.shape[1]:
        return math.nan
    turn = scene.rotation[1] @ scene.rotation[0].T
    left, right = view.spots["ray"][0, both[0]] @ turn.T, view.spots["ray"][1, both[1]]
    normals = np.cross(scene.translation[1] - turn @ scene.translation[0], left)
    away = (normals * right).sum(axis=1) / right[:, 2] / np.hypot(normals[:, 0], normals[:, 1])
    return float(scene.lens[1]["fx"] * np.sqrt(np.mean(away**2)))


def widened(candidates: Sequence[np.void]) -> np.void:
    """Return the best of several poses with a covariance that includes them all, and a large one of the tilt.

    For the track only: position and rotation about the line of sight are known well enough to continue it.
    """
    best = candidates[0].copy()
    d = np.empty(6)
    for other in candidates[1:]:
        difference(other["r"], other["t"], best["r"], best["t"], d)
        best["covariance"] += np.outer(d, d)
    best["covariance"][3:, 3:] += np.diag(np.array([_OPEN_TILT_RAD, _OPEN_TILT_RAD, _OPEN_TURN_RAD]) ** 2)
    return best


def _fits(image: np.ndarray, shape: tuple[int, int]) -> bool:
    return image.shape == shape and image.dtype == np.uint8


def _area(regions: Array) -> float:
    return float(np.prod(regions[:, 2:] - regions[:, :2], axis=1).sum())
