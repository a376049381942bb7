"""Tracker of a session: its frames against the encoders in each cycle, alarm and hold, rows, numbers."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.core.kernel_record import kernel_record
from hil.core.messages import Array
from hil.drivers.mock_axes import MockAxes
from hil.errors import Problem
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.loop.outcome import Outcome
from hil.loop.runner import Runner
from hil.loop.session_parts import PartResult, SessionParts
from hil.params import bench as bench_params
from hil.params.bench_budget import BenchSigma
from hil.parts.tracker.comparison import WINDOW_S, BenchComparison, ComparedSample, Deviation
from hil.parts.tracker.encoder_poses import EncoderPoses, pose_of
from hil.parts.tracker.frames import TrackedFrame, TrackerSource
from hil.parts.tracker.margins import table_iii_margins
from hil.parts.tracker.mock import MockTracker
from hil.parts.tracker.results import TruthStatistics
from hil.parts.tracker.rows import SAMPLE
from hil.parts.tracker.table import ROLES, Tracker
from hil.session.assembly import Job

NAME: Final = "tracker"
_WAITING: Final = 64  # frames that wait for the encoders
_PER_CYCLE: Final = 4  # frames that are compared
_ROWS_MAX: Final = 200_000  # that are kept in memory
_JUDGED_EACH: Final = 5  # cycles
_SILENT_S: Final = 2.0
_STANDING_S: Final = 3.0  # at most, for the comparison before the first motion
_GAP_S: Final = 0.5  # between two cycles, in which the bench may have moved
_RECOVERED: Final = 0.7  # of its bound, below which a difference is over


def check_run(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return why a tracker cannot be compared with this rig."""
    config: Tracker = rig.value.table_of_part("tracker")
    problems = []

    def problem(key: str, text: str) -> None:
        problems.append(Problem(rig.where(f"tracker.{key}"), f"rig.tracker.{key}", text))

    if (config.driver == "mock") != (rig.value.kind == "mock"):
        allowed = '"mock"' if rig.value.kind == "mock" else ", ".join(f'"{name}"' for name in config.on_wires)
        problem("driver", f'"{config.driver}": on a rig of kind "{rig.value.kind}" allowed are {allowed}')
    if rig.value.host.time == "lock_step" and config.driver != "text":
        problem("driver", f'"{config.driver}": keeps real time, in lock-step allowed is "text"')
    if rig.value.target_axes is not None:
        problem("target", "a target on axes: its tracked body must stand")
    if config.driver == "text" and config.port is None and rig.value.kind == "hardware":
        problem("port", "is missing: the UDP port that receives the frames")
    return problems


@contextmanager
def attach(job: Job, parts: SessionParts) -> Iterator[None]:
    """Compare the tracker of the rig with the encoders before motion and in each cycle, until the run has ended."""
    watch = TrackerWatch(job, parts)
    parts.layers.append(watch.over)
    parts.on_run_zero.append(watch.set_zero)
    parts.on_built.append(watch.begin)
    if parts.clock is not None:
        parts.before_motion.append(watch.check_standing)
    parts.results.append(watch.result)
    try:
        yield
    finally:
        watch.close()


class TrackerWatch:
    """Layer between the loop and the recording. ``put`` is called in each cycle, by the thread of the loop."""

    def __init__(self, job: Job, parts: SessionParts) -> None:
        rig = job.rig.value if parts.bench is None else parts.bench.rig
        self._config: Tracker = rig.table_of_part("tracker")
        self._job, self._clock = job, parts.clock
        scenario = job.scenario.value
        self._bench = kernel_record(bench_params.bench(rig, scenario.step_s, scenario.bench))
        self._worth = BenchSigma(rig, scenario.step_s) if rig.bench.geometry_file is not None else None
        self.comparison = self._new_comparison()
        self._standing, self._standing_s, self._stood_s = self.comparison, math.nan, math.nan
        self._out: Telemetry = parts.sinks.get("tracker_samples", NoTelemetry())
        self._row = np.zeros(1, SAMPLE)
        self._rows: Telemetry = NoTelemetry()
        self._zero_s = math.nan
        self._waiting: deque[tuple[float, TrackedFrame]] = deque(maxlen=_WAITING)
        self._statistics = TruthStatistics(self._bench, scenario.step_s)
        self._source: TrackerSource | None = None
        self._alarm = ""
        self._off, self._beyond_s = False, math.nan  # last time with all differences within their bounds
        self._first_s = math.nan
        self._cycles = 0
        self._kept: list[np.ndarray] = []

    def _new_comparison(self) -> BenchComparison:
        encoders = EncoderPoses(self._bench, self._job.scenario.value.step_s)
        return BenchComparison(self._config, encoders, self._worth)

    def over(self, rows: Telemetry) -> Telemetry:
        """Return this layer, which passes each row on to ``rows``."""
        self._rows = rows
        return self

    def set_zero(self, run_zero_s: float) -> None:
        """Take the bench time of the run's time zero; nan while the run's time stops."""
        self._zero_s = run_zero_s

    def begin(self, runner: Runner) -> None:
        """Open the tracker: a mock one sees the true axes of ``runner``."""
        self._safety, self._axis_names = runner.safety, runner.loop.bench.axis_names
        if self._config.driver != "mock":
            from hil.parts.tracker.link import open_link

            assert self._clock is not None
            self._source = open_link(self._config, self._clock)
            return
        rails, turntable = runner.loop.bench.rails, runner.loop.bench.turntable
        assert isinstance(rails, MockAxes)
        assert isinstance(turntable, MockAxes)
        servos, as_built = (rails.servo, turntable.servo), kernel_record(runner.loop.memory.params.mock.bench)

        def true_pose(_: float) -> tuple[Array, Array]:
            return pose_of(as_built, np.concatenate([servo.position for servo in servos]))

        self._source = MockTracker(self._config, self._job.seed, true_pose)

    def put(self, row: np.ndarray) -> None:
        """Pass ``row``, (1,) of CYCLE, on, and compare the newest frames whose moments its encoders have reached."""
        self._rows.put(row)
        if self._source is None:
            return
        now_s = self._zero_s + float(row["t_s"][0])
        self._add_cycle(row[0], now_s)
        if isinstance(self._source, MockTracker):
            self._source.run_zero_s = self._zero_s
        for sample in self._samples(self.comparison, now_s):
            self._statistics.add(sample)
            self._record(sample)
        self._cycles += 1
        if self._cycles % _JUDGED_EACH == 0:
            self._judge(now_s)

    def check_standing(self, now_s: float, feedback: np.record) -> bool:
        """Compare the tracker with the bench, which stands, for ``WINDOW_S``; return whether that is complete.

        feedback: FEEDBACK. It begins again when it is complete, and when the bench may have moved meanwhile. Raises
        SafetyTrip for a difference beyond its bound. A silent tracker is left to the run.
        """
        if not now_s - self._stood_s < _GAP_S:
            self._standing, self._standing_s = self._new_comparison(), now_s
            self._waiting.clear()
        standing, self._stood_s = self._standing, now_s
        standing.encoders.add(now_s, np.concatenate([feedback.rail_m, feedback.gimbal_rad]))
        for _ in self._samples(standing, now_s):
            pass
        if not standing.is_complete and now_s - self._standing_s < _STANDING_S:
            return False
        self._stood_s = math.nan
        if standing.counts["outlier"] > standing.counts["ok"]:
            raise table.BENCH_AGAINST_TRACKER.trip(NAME, "off by more than its gate", self._config.gate_m)
        deviation = standing.deviations(standing.last_s).get("chaser")
        if deviation is not None and deviation.excess > 1.0:
            raise self._alarm_of(now_s, deviation, standing.cause({"chaser": deviation}, self._axis_names)).trip()
        return True

    def _samples(self, comparison: BenchComparison, now_s: float) -> Iterator[ComparedSample]:
        """Yield the newest frames whose moments the encoders of ``comparison`` have reached, compared."""
        assert self._source is not None
        for frame in self._source.poll(now_s):
            self._waiting.append((comparison.moment_of(frame), frame))
        due: deque[tuple[float, TrackedFrame]] = deque(maxlen=_PER_CYCLE)
        while self._waiting and comparison.is_due(*self._waiting[0]):
            due.append(self._waiting.popleft())
        for late_s, frame in due:
            if (sample := comparison.compare(frame, late_s)) is not None:
                yield sample

    def result(self, outcome: Outcome) -> PartResult:
        """Return what the tracker has shown of the bench, table ``bench_truth``."""
        comparison = self.comparison
        numbers = self._statistics.numbers() | {
            "driver": self._config.driver,
            "counts": dict(comparison.counts),
            "clock": comparison.clock.numbers()
            | {"latency_ms": 1e3 * comparison.latency.value_s, "latency_sigma_ms": 1e3 * comparison.latency.sigma_s},
            "alarm": self._alarm or None,
        }
        withheld = self._alarm or ("" if comparison.counts["ok"] else "tracker: no sample could be compared")
        if self._worth is not None and len(outcome.history):
            margins, too_small = table_iii_margins(self._job.scenario.value, self._worth, outcome)
            numbers, withheld = margins | numbers, withheld or too_small
        rows = np.concatenate([np.zeros(0, SAMPLE), *self._kept])
        return PartResult("bench_truth", numbers, {"tracker_samples": rows}, withheld)

    def close(self) -> None:
        """Release the tracker."""
        if self._source is not None:
            self._source.close()

    def _add_cycle(self, row: np.void, now_s: float) -> None:
        """Take encoders, setpoint and truth of a cycle; gimbals are brought to the moment of the rails' encoders."""
        feedback, (rails_s, gimbals_s) = row["feedback"], row["sampled_s"]
        gimbals = feedback["gimbal_rad"] + (rails_s - gimbals_s) * feedback["gimbal_radps"]
        self.comparison.encoders.add(self._zero_s + float(rails_s), np.concatenate([feedback["rail_m"], gimbals]))
        self._statistics.add_cycle(row, now_s, self.comparison.encoders)

    def _record(self, sample: ComparedSample) -> None:
        """Send a row for each body of ``sample`` to the recording."""
        row, config = self._row[0], self._config
        for role, state in sample.states.items():
            pose = sample.frame.bodies.get(config.bodies[role].body)
            row["t_s"], row["received_s"] = sample.t_s - self._zero_s, sample.frame.received_s - self._zero_s
            row["age_s"], row["body"], row["status"] = sample.frame.received_s - sample.t_s, ROLES.index(role), state
            row["r_W"] = np.nan if pose is None else pose.position
            row["q_bW"] = np.nan if pose is None or pose.q is None else pose.q
            row["sigma_m"] = config.sigma_m if pose is None else max(config.sigma_m, pose.error_m)
            row["sigma_rad"] = math.radians(config.sigma_deg)
            row["off_m"], row["off_rad"] = (sample.off[:3], sample.off[3:]) if role == "chaser" else (np.nan, np.nan)
            self._out.put(self._row)
            if len(self._kept) < _ROWS_MAX:
                self._kept.append(self._row.copy())

    def _judge(self, now_s: float) -> None:
        """Raise the alarms of a difference beyond its bound, with a hold, and of a tracker that is silent."""
        alarms, last_s = self._safety.alarms, self.comparison.last_s
        self._first_s = now_s if math.isnan(self._first_s) else self._first_s
        silent_s = now_s - (self._first_s if math.isnan(last_s) else last_s)
        failure = "" if self._source is None else self._source.failure
        if failure or silent_s > _SILENT_S:
            alarms.raise_condition(table.SAMPLES.alarm(now_s, NAME, failure or silent_s, _SILENT_S))
        else:
            alarms.return_to_normal(NAME, table.SAMPLES.quantity)
        deviations = self.comparison.deviations(last_s)
        judged = {role: each for role, each in deviations.items() if role != "reference"}
        if not judged:
            return
        self._statistics.add_deviation(deviations.get("chaser"), self.comparison.sigmas())
        largest = max(judged.values(), key=lambda each: each.excess)
        if largest.excess <= 1.0 or math.isnan(self._beyond_s):
            self._beyond_s = now_s
        if now_s - self._beyond_s >= WINDOW_S and not self._off:  # then the means have its whole size
            self._raise(now_s, largest, self.comparison.cause(deviations, self._axis_names))
        elif largest.excess < _RECOVERED and self._off:
            self._off = False
            alarms.return_to_normal(NAME, table.BENCH_AGAINST_TRACKER.quantity)

    def _raise(self, now_s: float, off: Deviation, cause: str) -> None:
        alarm = self._alarm_of(now_s, off, cause)
        self._off, self._alarm = True, self._alarm or alarm.text
        self._safety.alarms.raise_condition(alarm)
        self._safety.request_hold(alarm.text)

    def _alarm_of(self, now_s: float, off: Deviation, cause: str) -> Alarm:
        (position, attitude), (position_max, attitude_max) = off.sizes, off.bounds
        rotates = attitude / attitude_max > position / position_max
        size, bound = (attitude, attitude_max) if rotates else (position, position_max)
        notes = f", {cause}", ""
        return table.BENCH_AGAINST_TRACKER.alarm(now_s, NAME, size, bound, rotates=rotates, notes=notes)
