"""Pose from a frame: follow the target or detect it in the whole region, measure, and validate."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.config.scene import Scene
from hil.models import docking_view
from hil.parts.monitor import validation
from hil.parts.monitor.detector import TargetDetector
from hil.parts.monitor.features import ACROSS, LABEL, UPRIGHT, TargetFeatures, quarter_rolled, target_features
from hil.parts.monitor.field_check import FieldDifference
from hil.parts.monitor.kernels import measure
from hil.parts.monitor.kernels.edge_samples import EDGE_SAMPLE
from hil.parts.monitor.kernels.pose import GROWTH, UNKNOWNS
from hil.parts.monitor.motion import NOT_ESTIMATED, Motion
from hil.parts.monitor.preprocess import LEAST_CONTRAST, prepare
from hil.parts.monitor.results import FAR, NEAR, NO_TARGET, FrameDetection, FrameResult
from hil.parts.monitor.settings import MonitorSettings, Region
from hil.parts.monitor.sources import LOWER, UPPER, Image, VideoFrame, lines_of

Floats = NDArray[np.float64]

_MOST_SAMPLES: Final = 4096
_TRACK_REACHES_PX: Final = (4.0, 10.0)
_SEARCH_REACHES_PX: Final = (3.0, 6.0, 12.0)
_FEWEST_AGREEING: Final = 12
_MOST_AGREE: Final = 0.7  # fraction of the edges
_TRIED: Final = 5  # hypotheses per frame
_USUAL_NOISE: Final = 9.0  # variance of a pixel, at first and at least
_MARGIN_PX: Final = 24.0
_TURNS: Final = np.array([0.5, 1.0, 1.5]) * math.pi  # in which a cross looks the same


class FrameTracker:
    """Measures one target frame by frame; keeps its last pose and the camera's noise."""

    def __init__(self, scene: Scene, settings: MonitorSettings) -> None:
        self._settings = settings
        self._features = target_features(scene.camera, scene.chosen(settings.target))
        self._detector = TargetDetector(self._features)
        self._tuning = settings.tuning(scene.camera)
        self._sigmas, self._tolerances = np.array(settings.camera_sigmas(scene.camera)), scene.camera.tolerances
        self._samples = np.zeros(_MOST_SAMPLES, EDGE_SAMPLE)
        self._left, self._normal, self._sums = np.zeros(_MOST_SAMPLES), np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(4)
        self._state = _fresh_camera()
        self._last: tuple[float, Floats] | None = None
        self._motion: Motion | None = None
        self._near = np.ones(self._features.feature_count, np.int64)
        self._far = self._near.copy()
        self._far[[ACROSS, UPRIGHT, LABEL]] = 0
        self._whole = Region(0, 0, scene.camera.width, scene.camera.height)
        self._search: Region | None = None
        self._shown: list[Image | None] = [None, None, None]  # the last image of each field
        self._roll_max = math.radians(scene.roll_max_deg)
        self._excluded = np.zeros(len(_TURNS), bool)  # turns that the parts seen so far exclude
        self._rolled: list[TargetFeatures] = []  # the target rolled by those turns, if its boxes show them
        if self._features.target.boxes and self._features.target.cross is not None:
            rolled = self._features.target
            for _ in _TURNS:
                rolled = quarter_rolled(rolled)
                self._rolled.append(target_features(scene.camera, rolled))

    def expect(self, motion: Motion | None) -> None:
        """Predict the pose of the next frames by ``motion``; None: it stays as in the last frame."""
        self._motion = motion

    def search_in(self, region: Region | None) -> bool:
        """Search in ``region`` alone from the next frame on, None: in the whole image.

        Return whether the followed target is outside of it and is therefore no longer followed.
        """
        self._search = region or self._whole
        if self._last is None or self._search.contains(*self._middle(self._last[1])):
            return False
        self._last = None
        return True

    def process(self, frame: VideoFrame) -> FrameResult:
        """Return the measurement of ``frame``."""
        image = frame.image
        patch = image[:: max(image.shape[0] // 64, 1), :: max(image.shape[1] // 64, 1)]
        if int(patch.max()) - int(patch.min()) < LEAST_CONTRAST:
            return self._no_result(frame, NO_TARGET, "black")
        previous, self._shown[frame.field] = self._shown[frame.field], image
        if previous is not None and np.array_equal(previous[::16], image[::16]) and np.array_equal(previous, image):
            return self._no_result(frame, "rejected_frozen", "equal to the image before")
        followed = self._follow(frame)
        if followed is not None and followed.used:
            return followed
        detected = self._find(frame)
        if detected is not None and detected.used:
            return detected
        for candidate in (followed, detected):
            if candidate is not None:
                return candidate
        return self._no_result(frame, NO_TARGET, "not found")

    def _follow(self, frame: VideoFrame) -> FrameResult | None:
        """Measure at the pose predicted from the last frames (task 1b)."""
        if self._last is None or frame.t_s - self._last[0] > self._settings.lost_s:
            return None
        dt = frame.t_s - self._last[0]
        x = self._last[1].copy()
        if self._motion is not None:
            x[:6] += dt * self._motion.w[1::2]
        if not self._align(frame, x, _TRACK_REACHES_PX):
            return None
        return self._measure(frame, x, tracked=True)

    def _find(self, frame: VideoFrame) -> FrameResult | None:
        """Search the region that was set; else the initial one, then the whole image (task 1a)."""
        best: FrameResult | None = None
        first = [self._settings.region] if self._settings.region is not None and self._last is None else []
        for region in [self._search] if self._search is not None else [*first, self._whole]:
            for result in self._find_in(frame, region):
                if result.used:
                    return result
                best = best or result
        return best

    def _find_in(self, frame: VideoFrame, region: Region) -> list[FrameResult]:
        first = math.ceil((region.top - frame.first_line) / frame.line_step)
        last = math.ceil((region.bottom - frame.first_line) / frame.line_step)
        patch = np.ascontiguousarray(frame.image[max(first, 0) : last, region.left : region.right])
        prepared = prepare(patch)
        if prepared.contrast < LEAST_CONTRAST:
            return []
        shifted = Region(region.left, max(first, 0), region.right, last)
        results: list[FrameResult] = []
        guesses = self._detector.hypotheses(prepared, shifted, float(frame.first_line), float(frame.line_step))
        for guess in guesses[:_TRIED]:
            self._state = _fresh_camera(patch)
            x = guess.pose.copy()
            if not self._align(frame, x, _SEARCH_REACHES_PX):
                continue
            result = self._measure(frame, x, tracked=False)
            results.append(result)
            if result.used:
                break
        return results

    def _align(self, frame: VideoFrame, x: Floats, reaches: tuple[float, ...]) -> bool:
        """Align x (15,) with the edges, using the first of ``reaches``, px, for which most agree, else the best."""
        noise = math.sqrt(self._state["noise_0"] + 100.0 * self._state["noise_1"])
        model, start, best, aligned = self._features, x.copy(), 0, x.copy()
        for reach in reaches:
            trial = start.copy()
            agreeing, share = measure.align_pose(
                frame.image, float(frame.first_line), float(frame.line_step), model.lens, model.circles, model.lines,
                model.borders, trial, self._state, self._tuning, reach, max(3.0 * noise, 4.0), self._samples,
            )  # fmt: skip
            if agreeing > best:
                best, aligned = agreeing, trial
            if agreeing >= _FEWEST_AGREEING and share > _MOST_AGREE:
                break
        x[:] = aligned
        return best >= _FEWEST_AGREEING

    def _bar_px(self, x: Floats) -> float:
        """Return the width of a bar of the cross in the image, px; 0 if it is not in front of the camera."""
        offset, _, width = self._features.cross
        depth = x[2] - offset
        return float(self._features.lens[0] * width / depth) if width > 0.0 and depth > 0.05 else 0.0

    def _measure(self, frame: VideoFrame, x: Floats, tracked: bool) -> FrameResult:
        """Measure with the near features if the cross is large enough and valid, else with the far ones."""
        first: FrameResult | None = None
        if self._bar_px(x) >= self._settings.near_bar_px:
            first = self._measure_with(frame, x.copy(), NEAR, tracked)
            if first.used:
                return first
            if first.status == "rejected_boxes":
                for rolled in self._rolled:
                    other = self._measure_with(frame, x.copy(), NEAR, tracked, rolled)
                    if other.used:
                        return other
        second = self._measure_with(frame, x.copy(), FAR, tracked)
        return second if second.used or first is None else first

    def _measure_with(
        self, frame: VideoFrame, x: Floats, mode: str, tracked: bool, rolled: TargetFeatures | None = None
    ) -> FrameResult:
        """Measure with the features of a mode. rolled: features of the target rolled by 90, 180 or 270 deg.

        The roll is open then: a ship may be rolled beyond the limits of the pose, or beyond what the scene states.
        """
        model, state = rolled or self._features, self._state.copy()
        status, count = measure.measure(
            frame.image, float(frame.first_line), float(frame.line_step), model.lens, model.circles, model.lines,
            model.borders, x, state, self._tuning, self._near if mode == NEAR else self._far, self._samples, self._left,
            self._normal, self._sums,
        )  # fmt: skip
        if status != measure.MEASURED:
            return self._no_result(frame, "rejected_measurement", "too few edges: contrast, noise, or a part is hidden")
        if validation.is_implausible(x):
            return self._no_result(frame, "rejected_pose", "pose out of bounds")
        if why := validation.camera_contradiction(x, self._tolerances):
            return self._no_result(frame, "rejected_camera", why)
        samples = self._samples[:count]
        noise = math.sqrt(float(state["noise_0"] + 100.0 * state["noise_1"]))
        verdict = validation.Validation(model, samples, self._left[:count], noise)
        labels = np.full(len(model.circles), np.nan)
        if mode == NEAR:
            measure.label_contrasts(
                frame.image, float(frame.first_line), float(frame.line_step), model.lens, x, model.circles, labels
            )
            why = validation.near_rejection(model, verdict, labels, noise)
        else:
            why = validation.far_rejection(model, verdict)
        if why:
            return self._no_result(frame, f"rejected_{why}", f"{mode}: {why}")
        self._state = state
        self._last = (frame.t_s, x.copy())
        if not tracked:
            self._excluded[:] = False
        if rolled is None and self._is_roll_open(x):
            self._excluded |= validation.excluded_turns(model, verdict, labels, noise, float(x[2] / model.lens[0]))
        measured = self._measured(frame, x, mode, tracked, samples, noise)
        return measured if rolled is None else replace(measured, roll_open=True)

    def _is_roll_open(self, x: Floats) -> bool:
        """Return whether another roll within the scene's range shows the same cross, and no part excludes it."""
        if self._roll_max + abs(float(x[5])) < 0.5 * math.pi:
            return False
        others = np.abs(np.remainder(x[5] + _TURNS + math.pi, 2.0 * math.pi) - math.pi)
        return bool(np.any((others <= self._roll_max) & ~self._excluded))

    def field_difference(self, frame: VideoFrame, result: FrameResult) -> FieldDifference | None:
        """Return the difference of the poses by the odd and the even lines of a whole frame, measured as ``result``.

        None if one of the two cannot be measured.
        """
        model, poses, covariances = self._features, [], []
        samples, residuals = np.zeros(_MOST_SAMPLES, EDGE_SAMPLE), np.zeros(_MOST_SAMPLES)
        normal, sums = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(4)
        for field in (UPPER, LOWER):
            x, state = result.pose.copy(), self._state.copy()
            status, _ = measure.measure(
                np.ascontiguousarray(frame.image[lines_of(field)]), float(field == LOWER), 2.0, model.lens,
                model.circles, model.lines, model.borders, x, state, self._tuning,
                self._near if result.status == NEAR else self._far, samples, residuals, normal, sums,
            )  # fmt: skip
            if status != measure.MEASURED:
                return None
            # both fields have the same camera: its unknowns are those of the whole frame
            full = normal + np.diag(result.prior)
            camera = np.linalg.solve(full[:6, :6], full[:6, 6:] @ (x[6:] - result.pose[6:]))
            poses.append(x[:6] + camera)
            covariances.append(np.linalg.inv(full[:6, :6]))
        return FieldDifference(poses[1] - poses[0], np.linalg.inv(covariances[0] + covariances[1]))

    def _measured(
        self, frame: VideoFrame, x: Floats, mode: str, tracked: bool, samples: Any, noise: float
    ) -> FrameResult:
        used = samples["good"] == 1
        places = np.column_stack(
            (samples["u"] + samples["shift"] * samples["nu"], samples["v"] + samples["shift"] * samples["nv"])
        )
        prior = np.zeros(UNKNOWNS)
        prior[:2] = 1.0 / (self._settings.passive_angle_rad * x[2]) ** 2
        prior[GROWTH:] = np.maximum(self._sigmas, NOT_ESTIMATED) ** -2.0
        low, high = places[used].min(axis=0) - _MARGIN_PX, places[used].max(axis=0) + _MARGIN_PX
        detection = FrameDetection(
            frame.number, frame.t_s, mode, (low[0], low[1], high[0] - low[0], high[1] - low[1]), places[used],
            self._cross_at(x) if mode == NEAR else None, self._circle_at(x, near=True), self._circle_at(x, near=False),
            self._corners_at(x),
        )  # fmt: skip
        return FrameResult(
            detection, "", x, self._normal.copy(), prior, self._sums.copy(), tracked, float(self._state["blur"]), noise,
            self._is_roll_open(x),
        )  # fmt: skip

    def _point_at(self, x: Floats, y: Floats) -> tuple[float, float, float]:
        """Return u, v, px, and the depth, m, of the point y (3,) of C."""
        p = docking_view.to_camera(docking_view.attitude(x[3:6]), x[:3], y)
        f, cx, cy = self._features.lens[:3]
        u, v = docking_view.project_point(f, cx, cy, p)
        return float(u), float(v), float(p[2])

    def _middle(self, x: Floats) -> tuple[float, float]:
        """Return u, v, px, of the disc's centre, without a disc of the outline's."""
        target, centre = self._features.target, np.zeros(3)
        if target.disc is None and target.outline is not None:
            centre[:] = *target.outline.middle_m, target.outline.offset_m
        return self._point_at(x, centre)[:2]

    def _cross_at(self, x: Floats) -> tuple[float, float, float]:
        u, v, _ = self._point_at(x, np.array([0.0, 0.0, self._features.cross[0]]))
        return u, v, -float(x[5])

    def _circle_at(self, x: Floats, near: bool) -> tuple[float, float, float] | None:
        target = self._features.target
        part = target.disc if near else target.outline
        if part is None or part.radius_m is None:
            return None
        centre = np.zeros(3)
        if target.outline is not None and not near:
            centre[:] = *target.outline.center_m, target.outline.offset_m
        u, v, depth = self._point_at(x, centre)
        return u, v, float(self._features.lens[0] * part.radius_m / depth)

    def _corners_at(self, x: Floats) -> Floats:
        """Return the corners (n, 2) of the outline, px; n is 0 for a circle."""
        outline = self._features.target.outline
        if outline is None or not outline.corners_m:
            return np.empty((0, 2))
        return np.array([self._point_at(x, np.array([*corner, outline.offset_m]))[:2] for corner in outline.corners_m])

    def _no_result(self, frame: VideoFrame, status: str, reason: str) -> FrameResult:
        detection = FrameDetection(frame.number, frame.t_s, status)
        nothing, zeros = np.full(UNKNOWNS, np.nan), np.zeros(UNKNOWNS)
        return FrameResult(detection, reason, nothing, np.zeros((UNKNOWNS, UNKNOWNS)), zeros, np.zeros(4), False)


def _fresh_camera(image: Image | None = None) -> Any:
    """Return the assumed state of a camera before its first frame; of one with much noise by its image."""
    state = np.zeros(1, measure.CAMERA_STATE)[0]
    state["blur"], state["noise_0"] = 1.0, _USUAL_NOISE
    if image is not None:
        lines = image[::4].astype(np.float32)
        bends = np.abs(lines[:, 2:] - 2.0 * lines[:, 1:-1] + lines[:, :-2])  # of a variance of six pixels
        state["noise_0"] = max(_USUAL_NOISE, float(np.median(bends) / 0.6745) ** 2 / 6.0)
    return state
