"""Measurement of the bench's geometry: moves through a plan, and observes the pose at rest at each place."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from hil.config.bench_geometry import errors_as_built
from hil.config.tables.machine import PARAMETERS
from hil.core import alarm_table as table
from hil.core.messages import Array
from hil.core.part import provided
from hil.drivers.mock_axes import MockAxes
from hil.errors import BadInput
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.runner import Runner
from hil.maths import quat
from hil.maths.random_streams import stream
from hil.params import bench as bench_params
from hil.parts.geometry.model import MachineModel, with_noise
from hil.parts.geometry.observations import PoseObservations, joined
from hil.parts.geometry.tracked import TrackedPoses
from hil.parts.tracker.encoder_poses import mean_pose
from hil.parts.tracker.link import open_link
from hil.parts.tracker.table import Tracker
from hil.parts.vision.view_plan import Clearance, IsClear, axes_record
from hil.session import build
from hil.session.build import Job
from hil.session.pose_model import PoseSensor, make_pose_sensor

CLEARANCE_M: Final = 0.15  # beyond the guard volume
_SETTLE_S: Final = 0.5  # at rest, before the first sample

OnProgress = Callable[[str, float], None]
TrueAxes = Callable[[float], Array]
"""Returns where the axes of a mock or emulated rig are, (6,), m and rad, at a bench time."""


class PoseObserver(Protocol):
    """Source of observed poses. source: as in the CSV file. sigma: (6,), m and rad, of one sample."""

    source: str
    sigma: Array

    def sample(self, now_s: float) -> Array | None:
        """Return the newest pose, (6,), m and rotation vector, rad; None without a new one."""


class SimulatedTracker:
    """Tracker of a mock or emulated rig: the pose of the machine as it is built, with white noise."""

    source = "tracker"

    def __init__(self, model: MachineModel, vector: Array, true_axes: TrueAxes, sigma: Array, seed: int) -> None:
        self.sigma = sigma
        self._model, self._vector, self._true_axes = model, vector, true_axes
        self._rng = np.random.default_rng(stream(seed, "geometry", self.source).integers(2**31))

    def sample(self, now_s: float) -> Array | None:
        """Return the pose of the chaser's body relative to the target's."""
        pose = self._model.observed(self._vector, self._true_axes(now_s)[None], self.source)
        observed: Array = with_noise(pose, self.sigma[None], self._rng)[0]
        return observed


class SimulatedVision:
    """Vision unit of a mock or emulated rig, as the scenario has it."""

    source = "vmu"

    def __init__(self, sensor: PoseSensor, true_axes: TrueAxes, rate_hz: float) -> None:
        self.sigma = np.full(6, math.nan)
        self._sensor, self._true_axes, self._period_s = sensor, true_axes, 1.0 / rate_hz
        self._next_s = -math.inf

    def sample(self, now_s: float) -> Array | None:
        """Return the pose of the LED ring relative to the left camera, None without a new one."""
        if now_s < self._next_s:
            return None
        self._next_s = now_s + self._period_s
        axes = self._true_axes(now_s)
        frame = self._sensor.measure(axes[:3], axes[3:], now_s)
        if frame is None:
            return None
        self.sigma = np.sqrt(np.diag(frame.covariance))
        return np.concatenate([frame.t_v, quat.to_rotation_vector(np.asarray(frame.q_vt))])


@dataclass
class _Series:
    """Samples of a source at one place."""

    observer: PoseObserver
    poses: list[Array]
    sigmas: list[Array]

    def mean(self) -> tuple[Array, Array]:
        """Return mean and its standard deviation, (6,) each, m and rad."""
        r, q = mean_pose([(pose[:3], quat.from_rotation_vector(pose[3:])) for pose in self.poses])
        mean = np.concatenate([r, quat.to_rotation_vector(q)])
        return mean, np.sqrt(np.mean(np.square(self.sigmas), axis=0) / len(self.poses))


class GeometryDrive:
    """Moves an open bench through a plan and observes it at rest for ``average_s`` at each place.

    Raises BenchError; the caller then stops the bench.
    """

    def __init__(
        self,
        sequencer: MotionSequencer,
        observers: list[PoseObserver],
        is_clear: IsClear,
        average_s: float,
        on_progress: OnProgress,
    ) -> None:
        self._sequencer, self._observers, self._is_clear = sequencer, observers, is_clear
        self._average_s, self._on_progress = average_s, on_progress
        self._begun_s = math.nan
        self._axes: list[Array] = []
        self._series: list[_Series] = []

    def observe(self, plan: Array) -> PoseObservations:
        """Return the observations at ``plan`` (n, 6), rails, m, gimbals, rad, in that order."""
        self._sequencer.home()
        rows: list[PoseObservations] = []
        for k, axes in enumerate(plan):
            self._on_progress(f"pose {k + 1} of {len(plan)}", k / len(plan))
            if not self._is_clear(self._position(), axes):
                raise table.MOVE_TO_VIEW.trip("bench", "enters the guard volume", "a clear way", k + 1)
            self._begun_s, self._axes = math.nan, []
            self._series = [_Series(observer, [], []) for observer in self._observers]
            self._sequencer.visit(axes_record(axes), self._poll)
            rows += self._rows(k + 1)
        if not rows:
            raise BadInput.single("observations", "", "no source has observed a pose")
        return joined(rows)

    def _poll(self, now_s: float) -> bool:
        if math.isnan(self._begun_s):
            self._begun_s = now_s
        rest_s = now_s - self._begun_s - _SETTLE_S
        if rest_s < 0.0:
            return False
        self._axes.append(self._position())
        for series in self._series:
            if (pose := series.observer.sample(now_s)) is not None:
                series.poses.append(pose)
                series.sigmas.append(series.observer.sigma)
        return rest_s >= self._average_s

    def _rows(self, number: int) -> Iterator[PoseObservations]:
        axes = np.mean(self._axes, axis=0)
        for series in self._series:
            if series.poses:
                mean, sigma = series.mean()
                source = np.array([series.observer.source])
                yield PoseObservations(np.array([number]), axes[None], mean[None], sigma[None], source)

    def _position(self) -> Array:
        feedback = self._sequencer.loop.now.feedback
        return np.concatenate([feedback.rail_m, feedback.gimbal_rad])


def clearance(job: Job) -> Clearance:
    """Return the guard volume of ``job`` for moves outside a run."""
    rig, scenario = job.rig.value, job.scenario.value
    bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
    return Clearance(bench, bench_params.axis_guard(rig, scenario), CLEARANCE_M, brakes=True)


@contextmanager
def opened(job: Job, announce: Callable[[str], None]) -> Iterator[tuple[Runner, TrueAxes | None, TrackedPoses | None]]:
    """Give a Runner, where the axes of a mock or emulated rig are, and the tracker that a rig has on a wire."""
    rig = job.rig.value
    if rig.kind == "mock":
        with build.runner(job, announce=announce) as runner:
            rails, turntable = runner.loop.bench.rails, runner.loop.bench.turntable
            assert isinstance(rails, MockAxes)
            assert isinstance(turntable, MockAxes)
            yield runner, lambda now_s: np.concatenate([rails.position_at(now_s), turntable.position_at(now_s)]), None
        return
    with build.wired_bench(job, announce) as bench, ExitStack() as stack:
        config: Tracker | None = bench.rig.table_of_part("tracker")
        tracker = None
        if config is not None and config.driver in config.on_wires:
            tracker = stack.enter_context(closing(TrackedPoses(config, open_link(config, bench.clock))))
        true_axes: TrueAxes | None = None
        if rig.kind == "emulated":
            operator = provided("rig.kind=emulated: operator")(bench.board, bench.addresses)
            true_axes = lambda now_s: np.array([operator.position(axis, now_s) for axis in range(6)])  # noqa: E731
        yield bench.axes_runner(), true_axes, tracker


def check_sources(job: Job, sources: list[str]) -> None:
    """Raise BadInput unless the rig has the ``sources``: hardware a tracker on a wire, and no other."""
    rig = job.rig.value
    config: Tracker | None = rig.table_of_part("tracker")
    if rig.kind == "hardware" and (sources != ["tracker"] or config is None or config.driver not in config.on_wires):
        text = "is missing: poses of hardware come from a tracker on a wire, or by its own CSV file to hil geometry fit"
        raise BadInput.single(job.rig.where("tracker"), "rig.tracker", text)


def measure(
    job: Job,
    plan: Array,
    sources: list[str],
    tracker_sigma: Array,
    average_s: float,
    on_progress: OnProgress,
    announce: Callable[[str], None],
) -> PoseObservations:
    """Return the observations of a rig at ``plan`` (n, 6). Raises BadInput, BenchError.

    tracker_sigma: (6,), m and rad, of the simulated tracker of a mock or emulated rig without one on a wire.
    """
    rig, truth = job.rig.value, job.truth
    check_sources(job, sources)
    with opened(job, announce) as (runner, true_axes, tracker), runner.axes_only() as sequencer:
        vector = errors_as_built(rig, truth.bench.errors)
        observers: list[PoseObserver] = []
        if tracker is not None and "tracker" in sources:
            observers.append(tracker)
        elif true_axes is not None and "tracker" in sources:
            known = np.zeros(PARAMETERS) if vector is None else vector
            observers.append(SimulatedTracker(MachineModel(rig), known, true_axes, tracker_sigma, job.seed))
        if true_axes is not None and "vmu" in sources:
            observers.append(SimulatedVision(make_pose_sensor(truth, rig, job.seed), true_axes, rig.vmu.rate_hz))
        return GeometryDrive(sequencer, observers, clearance(job), average_s, on_progress).observe(plan)
