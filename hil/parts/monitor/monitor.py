"""Docking monitor: frames in, portions out. The same frames give the same numbers, live or from a recording.

A portion is a batch of frames (MonitorSettings.portion_frames, portion_s) that gives one row of results.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.config.load import Loaded, load_scene
from hil.config.scene import Scene
from hil.core.public import public
from hil.parts.monitor.displacement import DISPLACED, displaced
from hil.parts.monitor.field_check import FieldCheck
from hil.parts.monitor.frame_tracker import FrameTracker
from hil.parts.monitor.kernels.quantities import derive
from hil.parts.monitor.motion import MotionFit, MotionSolution
from hil.parts.monitor.results import (
    AMBIGUOUS,
    ANY_ROLL_QUANTITIES,
    FAR,
    FAR_QUANTITIES,
    NEAR,
    NO_TARGET,
    QUANTITIES,
    FrameResult,
    Result,
)
from hil.parts.monitor.settings import MonitorSettings, Region
from hil.parts.monitor.sources import VideoFrame, exposures_of

REJECTED_FIELDS: Final = "rejected_fields"
REJECTED_DISPLACED: Final = "rejected_displaced"
TWO_FIELDS: Final = "two fields"
_EACH_CHECKED: Final = 2  # of the frames of a portion
_NAN: Final = np.full(len(QUANTITIES), np.nan)


@public
class DockingMonitor:
    """Measures the approach to one target with one camera.

    ``feed`` processes the next frame and returns the portions that it completes; ``last`` is the result of that frame.
    ``finish`` closes the portion that the end of a recording truncates. scene: camera and target, or the name of a
    shipped scene (``atv``, ``bright-cross``) or the path of its file; raises BadInput for an invalid one.
    """

    def __init__(self, scene: Scene | str | Path, settings: MonitorSettings | None = None) -> None:
        self.scene = scene if isinstance(scene, Scene) else load_scene(str(scene)).value
        self.settings = settings or MonitorSettings()
        self._tracker = FrameTracker(self.scene, self.settings)
        self._motion = MotionFit(self.settings, self.scene)
        self._frames: list[FrameResult] = []
        self._used_s = -np.inf
        self._images = 0
        self._dropped = False
        self._fields = FieldCheck(self.scene)
        self.last: FrameResult | None = None

    @public
    def feed(self, frame: VideoFrame | NDArray[np.uint8]) -> list[Result]:
        """Process the next frame; return the portions that it completes.

        frame: an exposure with its time; or an image, grey or BGR, (h, w) or (h, w, 3), uint8, of the size of the
        scene's camera, which is taken one period of the scene's ``fps`` after the one before. Of an interlaced camera
        an image has both fields. Raises BadInput for an image of another size.
        """
        if isinstance(frame, VideoFrame):
            return self._process(frame)
        exposures = exposures_of(frame, self._images, Loaded(self.scene, "scene", {}))
        self._images += 1
        return [portion for each in exposures for portion in self._process(each)]

    def search_in(self, region: Region | None) -> None:
        """Search in ``region`` alone from the next frame on, px; None: in the whole image.

        A target that is followed outside of it is dropped, with its motion; one inside is followed wherever it moves.
        """
        self._dropped = self._tracker.search_in(region) or self._dropped

    def _process(self, frame: VideoFrame) -> list[Result]:
        done: list[Result] = []
        if self._dropped:
            done += self.finish()
            self._motion.reset()
            self._tracker.expect(None)
            self._dropped = False
        if self._frames and frame.t_s - self._frames[0].detection.t_s >= self.settings.portion_s - 1e-9:
            done.append(self._close())
        result = self._tracker.process(frame)
        if not self._fields.decided and result.used and len(self._frames) % _EACH_CHECKED == 0:
            self._fields.add(self._tracker.field_difference(frame, result))
        if self.warning and not self._fields_are_stated:
            result = _unsuited(result, self.warning)
        self.last = result
        self._frames.append(result)
        if len(self._frames) >= self.settings.portion_frames:
            done.append(self._close())
        return done

    @property
    def warning(self) -> str:
        """What the images show to be wrong in the scene, "" if nothing; only frames that suit it are measured."""
        return self._fields.warning

    def finish(self) -> list[Result]:
        """Return the portion of the remaining frames, if any."""
        return [self._close()] if self._frames else []

    def _close(self) -> Result:
        frames, self._frames = self._frames, []
        t_s = frames[-1].detection.t_s
        frames = self._without_displaced(frames)
        near = [result for result in frames if result.status == NEAR]
        far = [result for result in frames if result.status == FAR]
        both = [result for result in frames if result.used]
        used, status = (both, NEAR) if len(near) >= len(far) else (far, FAR)
        if not used:
            self._fields.drop()
            return _nothing(frames, t_s)
        if used[0].detection.t_s - self._used_s > self.settings.lost_s:
            self._motion.reset()
        fit = self._motion.fit(used, t_s)
        if fit is None:
            self._fields.drop()
            return _nothing(frames, t_s, "rejected_motion")
        self._fields.update(fit.motion)
        if self.warning and not self._fields_are_stated:
            self._motion.reset()
            self._tracker.expect(None)
            return _nothing([_unsuited(result, self.warning) for result in frames], t_s)
        self._used_s = used[-1].detection.t_s
        self._tracker.expect(fit.motion)
        covariance = fit.motion.covariance + self._by_time_and_focus(fit.motion.w)
        if 2 * sum(result.roll_open for result in used) > len(used):
            status = AMBIGUOUS
        portion = _result(frames, fit, status, covariance)
        if self.warning:
            portion = replace(portion, timing=", ".join(text for text in (portion.timing, TWO_FIELDS) if text))
        return portion

    def _without_displaced(self, frames: list[FrameResult]) -> list[FrameResult]:
        """Return ``frames`` with those as not used whose image is displaced."""
        used = [result for result in frames if result.used]
        wrong = {id(result) for result, off in zip(used, displaced(used, self.scene.camera.f), strict=True) if off}
        return [_unsuited(one, DISPLACED, REJECTED_DISPLACED) if id(one) in wrong else one for one in frames]

    def _by_time_and_focus(self, w: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (12, 12) of the motion ``w`` by errors of the images' times and rate and by zoom."""
        stated, errors = self.scene.camera.tolerances, np.zeros((3, 12))
        errors[0, 0::2] = (0.5 / self.scene.fps if stated.time_s is None else stated.time_s) * w[1::2]
        errors[1, 1::2] = stated.rate_fraction * w[1::2]
        errors[2, 1:6:2] = stated.focal_drift_per_s * w[0:6:2]
        return errors.T @ errors

    @property
    def _fields_are_stated(self) -> bool:
        """Whether the scene's tolerance of time has what the fields do: half of their distance in time."""
        return (self.scene.camera.tolerances.time_s or 0.0) >= 0.25 / self.scene.fps * (1.0 - 1e-9)


def _reasons(frames: list[FrameResult]) -> tuple[tuple[str, int], ...]:
    return tuple(Counter(result.reason for result in frames if not result.used).most_common())


def _unsuited(result: FrameResult, why: str, status: str = REJECTED_FIELDS) -> FrameResult:
    """Return a frame that was measured under a wrong assumption as not used."""
    if not result.used:
        return result
    detection = replace(result.detection, status=status)
    return replace(result, detection=detection, reason=why, pose=np.full_like(result.pose, np.nan))


def _nothing(frames: list[FrameResult], t_s: float, status: str | None = None) -> Result:
    """Return the row of a portion without values: "rejected_<why>" if most of its frames showed a candidate."""
    if status is None:
        status = Counter(result.status for result in frames).most_common(1)[0][0]
    if status in (NEAR, FAR):
        status = NO_TARGET
    return Result(t_s, 0, status, _NAN, _NAN, reasons=_reasons(frames))


def _result(frames: list[FrameResult], fit: MotionSolution, status: str, covariance: NDArray[np.float64]) -> Result:
    values, sigmas = derive(fit.motion.w, covariance)
    observed = {FAR: FAR_QUANTITIES, AMBIGUOUS: ANY_ROLL_QUANTITIES}.get(status)
    if observed is not None:
        # two uncertain angles rotate the image by half their product, an effect of second order
        roll, one, two = (QUANTITIES.index(f"phi{i}_rad") for i in (3, 1, 2))
        sigmas[roll] = np.hypot(sigmas[roll], sigmas[one] * sigmas[two])
        hidden = [name not in observed for name in QUANTITIES]
        values[hidden] = np.nan
        sigmas[hidden] = np.nan
    return Result(
        fit.motion.t_s, fit.frames, status, values, sigmas,
        fit.sigma2_edges, fit.sigma2_common, fit.sigma2_motion, fit.consistent, covariance, _reasons(frames),
        fit.jitter_px, fit.timing,
    )  # fmt: skip


def process_frames(
    monitor: DockingMonitor, frames: Iterable[VideoFrame]
) -> Iterator[tuple[VideoFrame, FrameResult, list[Result]]]:
    """Yield each frame with its result and the portions it completes; the truncated last one with the last frame."""
    previous: tuple[VideoFrame, FrameResult, list[Result]] | None = None
    for frame in frames:
        if previous is not None:
            yield previous
        done = monitor.feed(frame)
        assert monitor.last is not None
        previous = (frame, monitor.last, done)
    if previous is not None:
        frame, result, done = previous
        yield frame, result, [*done, *monitor.finish()]
