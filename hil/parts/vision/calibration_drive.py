"""Views taken by the bench itself, at rest at each position of a plan: for a calibration, or for the drift check.

The drift check compares its views with the calibration of the cameras.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from hil.config.camera_identity import CameraIdentity, write_identities
from hil.config.load import load_geometry
from hil.core import alarm_table as table
from hil.core.clock import WallClock
from hil.core.messages import Array, Event
from hil.core.surroundings import temporary_folder
from hil.drivers.cameras.base import SIDES
from hil.drivers.cameras.pairing import Pairing
from hil.drivers.cameras.processes import CameraProcesses, vision_cameras, vision_pairing
from hil.drivers.vmu import NAME
from hil.errors import BadInput, DeviceError
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.params import bench as bench_params
from hil.parts.vision.view_plan import Clearance, IsClear, PlanRequest, axes_record, plan_views
from hil.parts.wires.wired import WiredBench
from hil.session.build import Job
from hil.vmu.calibration import job as calibration
from hil.vmu.calibration.files import read_back
from hil.vmu.calibration.model import Setup
from hil.vmu.calibration.refine import Prior, weak_prior
from hil.vmu.calibration.report import drift_as_json
from hil.vmu.calibration.views import COLUMNS, read_views

_CLEARANCE_M: Final = 0.1  # beyond the guard volume
_LONGEST_WAIT_S: Final = 10.0  # for a pair, at rest

OnProgress = Callable[[str, float], None]


@dataclass(frozen=True)
class DrivePlan:
    """Views to take. axes: (n, 6), rails, m, gimbals, rad, in this order. sizes: (width, height) of the images, px."""

    axes: Array
    is_clear: IsClear
    sizes: list[tuple[int, int]]


def plan_drive(job: Job, setup: Setup, held: Prior, request: PlanRequest) -> DrivePlan:
    """Return a plan of views on the rig of ``job``, outside the guard volume. Raises BadInput if there is none.

    setup, held: see ``plan_views``.
    """
    scenario = job.scenario.value
    bench = bench_params.bench(job.rig.value, scenario.step_s, scenario.bench)
    is_clear = Clearance(bench, bench_params.axis_guard(job.rig.value, scenario), _CLEARANCE_M)
    axes = plan_views(setup, bench, held, request, is_clear, np.random.default_rng(0))
    return DrivePlan(axes, is_clear, [(int(width), int(height)) for width, height in setup.sizes])


@dataclass(frozen=True)
class TakenView:
    """One view. axes: (6,), mean of the encoders at rest, rails, m, gimbals, rad. images: left and right."""

    axes: Array
    images: tuple[np.ndarray, np.ndarray]


class CalibrationDrive:
    """Moves an open bench through a plan and takes an image pair at rest at each position.

    settle_s: from rest to the exposure. Raises BenchError; the caller then stops the bench.
    """

    def __init__(
        self,
        sequencer: MotionSequencer,
        cameras: CameraProcesses,
        pairing: Pairing,
        is_clear: IsClear,
        settle_s: float,
        on_progress: OnProgress,
    ) -> None:
        self._sequencer = sequencer
        self._cameras = cameras
        self._pairing = pairing
        self._is_clear = is_clear
        self._settle_s = settle_s
        self._on_progress = on_progress

    def take(self, plan: Array) -> list[TakenView]:
        """Return the views at ``plan`` (n, 6), rails, m, gimbals, rad, in that order."""
        self._sequencer.home()
        views: list[TakenView] = []
        for k, axes in enumerate(plan):
            self._on_progress(f"view {k + 1} of {len(plan)}", k / len(plan))
            if not self._is_clear(self.position(), axes):
                raise table.MOVE_TO_VIEW.trip("bench", "enters the guard volume", "a clear way", k + 1)
            exposure = _Exposure(self, self._settle_s)
            self._sequencer.visit(axes_record(axes), exposure.poll)
            views.append(exposure.view())
        return views

    def position(self) -> Array:
        """Return the encoders, (6,), rails, m, gimbals, rad."""
        feedback = self._sequencer.loop.now.feedback
        return np.concatenate([feedback.rail_m, feedback.gimbal_rad])

    def skip_images(self) -> None:
        """Skip the images taken during the move."""
        self._cameras.skip()

    def new_pairs(self, now_s: float) -> list[tuple[float, np.ndarray, np.ndarray]]:
        """Return the pairs that are complete by now: time of exposure, s, and both images. Raises DeviceError."""
        for side, frame in self._cameras.frames(0.0):
            self._pairing.put(side, frame)
        self._cameras.check(now_s)
        return [
            (pair.exposed_s, pair.left.image, pair.right.image)
            for pair in self._pairing.pairs(now_s)
            if pair.left is not None
            and pair.right is not None
            and pair.left.image is not None
            and pair.right.image is not None
        ]


class _Exposure:
    """The first pair exposed after ``settle_s`` at rest, and the encoders meanwhile."""

    def __init__(self, drive: CalibrationDrive, settle_s: float) -> None:
        self._drive = drive
        self._settle_s = settle_s
        self._begun_s: float | None = None
        self._positions: list[Array] = []
        self._images: tuple[np.ndarray, np.ndarray] | None = None

    def poll(self, now_s: float) -> bool:
        """Return whether the pair is complete. Raises DeviceError if there is none for too long."""
        if self._begun_s is None:
            self._begun_s = now_s
            self._drive.skip_images()
            return False
        pairs = self._drive.new_pairs(now_s)
        if now_s >= self._begun_s + self._settle_s:
            self._positions.append(self._drive.position())
        for exposed_s, left, right in pairs:
            if exposed_s >= self._begun_s + self._settle_s:
                self._images = left, right
                return True
        if now_s - self._begun_s > self._settle_s + _LONGEST_WAIT_S:
            raise DeviceError("vmu.left, vmu.right", f"no complete image pair for {_LONGEST_WAIT_S:g} s at rest")
        return False

    def view(self) -> TakenView:
        """Return the view."""
        assert self._images is not None
        return TakenView(np.mean(self._positions, axis=0), self._images)


def take_views(
    bench: WiredBench, plan: DrivePlan, settle_s: float, on_progress: OnProgress
) -> tuple[list[TakenView], dict[str, CameraIdentity | None]]:
    """Return the views of ``plan`` and the identities of the cameras, by ``left`` and ``right``.

    Opens cameras and axes and closes them again. Raises BenchError.

    settle_s: from rest to the exposure.
    """
    assert isinstance(bench.clock, WallClock)
    cameras = vision_cameras(bench.rig.vmu, plan.sizes, bench.clock)
    with closing(cameras), bench.axes_runner().axes_only() as sequencer:
        pairing = vision_pairing(bench.rig.vmu)
        views = CalibrationDrive(sequencer, cameras, pairing, plan.is_clear, settle_s, on_progress).take(plan.axes)
        return views, {side: cameras.identities[f"vmu.{side}"] for side in SIDES}


def write_views(folder: Path, views: Sequence[TakenView], identities: Mapping[str, CameraIdentity | None] = {}) -> None:
    """Write a folder of views: ``views.csv``, images and ``identities``. Raises BadInput if it cannot be written."""
    for side in SIDES:
        (folder / side).mkdir(parents=True, exist_ok=True)
    with (folder / "views.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for k, view in enumerate(views):
            rails, gimbals = (f"{x:.7f}" for x in view.axes[:3]), (f"{x:.6f}" for x in np.degrees(view.axes[3:]))
            writer.writerow([f"{k + 1:04d}", *rails, *gimbals])
    for k, view in enumerate(views):
        for side, image in zip(SIDES, view.images, strict=True):
            path = folder / side / f"{k + 1:04d}.png"
            if not cv2.imwrite(str(path), image):
                raise BadInput.single(str(path), "", "cannot be written")
    write_identities(identities, folder)


WHAT: Final = "drift check"
_RANGE_M: Final = 2.0  # at which its effect is stated
_LED_SIGMA_M: Final = 1e-3


@contextmanager
def attach(job: Job, parts: SessionParts) -> Iterator[None]:
    """Add to ``parts`` the check of the cameras for drift before the devices are opened, if the rig requests it.

    Not in an attended session, in which the axes move by command only: an event of the run states that.
    """
    if job.rig.value.vmu.drift_check.views:
        if parts.operator is not None and parts.operator.attended:
            text = f"no {WHAT} in an attended session"
            parts.on_built.append(lambda runner: runner.events.append(Event(0.0, NAME, text)))
        else:
            check = CameraDriftCheck(parts.bench)
            parts.on_built.append(check.begin)
            parts.before_open.append(check.run)
            parts.meters["drift_check"] = lambda: check.result
    yield


class CameraDriftCheck:
    """Takes the views of ``[vmu.drift_check]`` and compares them. result: keys of ``hil calibrate --check --json``."""

    def __init__(self, bench: WiredBench) -> None:
        self.result: dict[str, Any] = {}
        self._bench = bench
        self._events: list[Event] = []

    def begin(self, runner: Runner) -> None:
        """Take the runner to whose events the result is appended."""
        self._events = runner.events

    def run(self) -> None:
        """Check the cameras. Raises SafetyTrip for a drift, DeviceError for views that do not show one or none."""
        try:
            checked, limits = self._checked()
        except BadInput as error:
            raise DeviceError(NAME, f"{WHAT}: {'; '.join(problem.message for problem in error.problems)}") from error
        self.result = drift_as_json(checked, limits)
        since = f"calibration {checked.stored.label.id} of {checked.stored.label.date}"
        exceeded, limit = checked.refusal(limits)
        if exceeded:
            raise table.DRIFT_CHECK.trip(NAME, exceeded, limit, since)
        text = f"{WHAT}: {checked.drift.views} views agree with {since}, residuals {checked.drift.rms_px:.3f} px RMS"
        self._events.append(Event(0.0, NAME, text))

    def _checked(self) -> tuple[calibration.DriftCheck, calibration.DriftLimits]:
        rig, chosen = self._bench.rig, self._bench.rig.vmu.drift_check
        assert rig.vmu.geometry_file is not None
        geometry = load_geometry(rig.vmu.geometry_file).value
        stored = read_back(geometry, rig.vmu.geometry_file)
        setup = Setup.of(geometry, rig.bench)
        held = weak_prior(setup, (), stored.axis_sigma, _LED_SIGMA_M, 0.0)
        request = PlanRequest(chosen.views, chosen.near_m, chosen.far_m, float(np.radians(chosen.turn_deg)))
        plan = plan_drive(self._bench.job, setup, held, request)
        taken, _ = take_views(self._bench, plan, chosen.settle_s, lambda *_: None)
        with temporary_folder("views") as folder:
            write_views(Path(folder), taken)
            views = read_views(Path(folder))
            views = replace(views, axes=bench_params.ideal_axes(rig, views.axes))
            checked = calibration.check(views, stored, None, False, _RANGE_M, lambda *_: None)
        return checked, calibration.DriftLimits(chosen.max_rms_px, chosen.max_drift_px, chosen.alarm_probability)
