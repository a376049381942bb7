"""Comparison of a tracker with the encoders of a bench: which samples count, and what their means show."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from hil.core.messages import Array
from hil.maths import linear, quat
from hil.params.bench_budget import BenchSigma
from hil.parts.tracker.encoder_poses import EncoderPoses, Moment, difference, mean_pose
from hil.parts.tracker.frames import BodyPose, Mounting, TrackedFrame
from hil.parts.tracker.table import Tracker
from hil.parts.tracker.times import LatencyEstimate, TrackerClock

WINDOW_S: Final = 0.5
"""Time over which differences are averaged."""
_LEAST: Final = 5  # samples in it
_MEASURED: Final = 50  # frames by which a body that stands is measured
_EARLY_S: Final = 2e-3  # by which a moment may be in the future
_INDEPENDENT: Final = 4.0  # samples of a window, whose noise is correlated
_LOCAL: Final = 0.3  # part of what the bench is worth that may change within a second
_SINGLE: Final = 0.8  # part of a difference that the error of a single axis explains at least
_NAN: Final = np.full(6, np.nan)


class SampleStatus(IntEnum):
    """What became of a sample of a body."""

    OK = 0
    LOST = 1
    SWAPPED = 2
    OUTLIER = 3
    OLD = 4
    FROZEN = 5


class ComparedSample(NamedTuple):
    """A frame after its comparison. t_s: its moment in bench time. states: of each body, by its role.

    off: tracker less encoders, (6,), m in H and rad in c, nan if it does not count. moment: the bench by its encoders.
    pose: by the tracker, r in H (3,), m, and H to c (4,).
    """

    frame: TrackedFrame
    t_s: float
    states: Mapping[str, SampleStatus]
    off: Array = _NAN
    moment: Moment | None = None
    pose: tuple[Array, Array] | None = None


class WindowSample(NamedTuple):
    """Sample of a body, or a mean. off: (6,), m and rad. rate: (6,), of the bench. sigma_m: of the tracker."""

    t_s: float
    off: Array
    rate: Array
    sigma_m: float


class Deviation(NamedTuple):
    """Mean difference of a body over ``WINDOW_S``, (6,), and its bounds, m and rad."""

    mean: Array
    bounds: tuple[float, float]

    @property
    def sizes(self) -> tuple[float, float]:
        """Size in position, m, and in attitude, rad; 0 for an attitude that a point does not have."""
        attitude = linear.length(self.mean[3:])
        return linear.length(self.mean[:3]), 0.0 if math.isnan(attitude) else attitude

    @property
    def excess(self) -> float:
        """Largest size over its bound."""
        return max(size / bound for size, bound in zip(self.sizes, self.bounds, strict=True))


class BenchComparison:
    """Frames of a tracker against the poses of the encoders, and of bodies that stand against where they stood.

    worth: what these poses are worth by a measured geometry; None: what the table states.
    """

    def __init__(self, table: Tracker, encoders: EncoderPoses, worth: BenchSigma | None = None) -> None:
        self._table, self.encoders, self._worth = table, encoders, worth
        self._mountings = {role: Mounting.of(b.position_m, b.rotation_deg) for role, b in table.bodies.items()}
        self._stood: dict[str, tuple[Array, Array]] = {}  # r in W, and W to its axes, of a body that stands
        self._first: dict[str, list[tuple[Array, Array]]] = {role: [] for role in table.bodies if role != "chaser"}
        self._frame: tuple[Array, Array] | None = None  # target in W, and W to H
        self._frame_sigma = 0.0  # of its attitude, rad
        if table.frame is not None:
            given = Mounting.of(table.frame.position_m, table.frame.rotation_deg)
            self._frame = given.position, given.q
        self._windows: dict[str, deque[WindowSample]] = {role: deque() for role in table.bodies}
        self._outlier_since: dict[str, float] = {}
        self._moment: Moment | None = None
        self._places: list[bytes] = []
        self._recent: deque[tuple[float, Array, Array, Array]] = deque()
        self._is_beyond = False
        self.clock = TrackerClock()
        self.latency = LatencyEstimate(np.repeat((table.sigma_m, math.radians(table.sigma_deg)), 3))
        self.counts: Counter[str] = Counter()
        """Frames that count, and others by the reason."""
        self.last_s = math.nan
        """Bench time of the last sample that counted."""
        self._begun_s = math.nan

    def moment_of(self, frame: TrackedFrame) -> float:
        """Return the moment of ``frame`` in bench time, s, with its latency. Once for each frame, in their order."""
        return self.clock.bench_s(frame)

    def is_due(self, late_s: float, frame: TrackedFrame) -> bool:
        """Return whether the encoders have reached the moment of ``frame``, or it is ahead of its receipt.

        late_s: of ``moment_of``.
        """
        return late_s - self.latency.value_s <= self.encoders.newest_s or late_s > frame.received_s + _EARLY_S

    def compare(self, frame: TrackedFrame, late_s: float) -> ComparedSample | None:
        """Return ``frame``, compared; None before the encoders, or the frame of the tracker, are known.

        late_s: of ``moment_of``.
        """
        t_s = late_s - self.latency.value_s
        states = dict.fromkeys(self._mountings, SampleStatus.OK)
        if late_s > frame.received_s + _EARLY_S or t_s < frame.received_s - self._table.max_age_s:
            return self._rejected(frame, t_s, dict.fromkeys(states, SampleStatus.OLD), SampleStatus.OLD)
        moment = self.encoders.at(t_s)
        if moment is None:
            return None
        places = [pose.position.tobytes() for pose in frame.bodies.values()]
        places, self._places = self._places, places
        if places and places == self._places:
            return self._rejected(frame, t_s, dict.fromkeys(states, SampleStatus.FROZEN), SampleStatus.FROZEN)
        bodies = {role: frame.bodies.get(self._table.bodies[role].body) for role in states}
        states |= {role: SampleStatus.LOST for role, pose in bodies.items() if pose is None}
        if self._frame is None and not self._measure_frame(bodies, moment):
            return None
        sample = ComparedSample(frame, t_s, states, moment=moment)
        return self._judge(sample, {role: pose for role, pose in bodies.items() if pose is not None})

    def _judge(self, sample: ComparedSample, bodies: Mapping[str, BodyPose]) -> ComparedSample:
        """Return ``sample`` with what its ``bodies`` show; their differences are added to the windows."""
        frame, t_s, states, _, moment, _ = sample
        assert moment is not None
        states = dict(states)
        offs = {role: self._off(role, pose, moment) for role, pose in bodies.items()}
        far = [role for role, off in offs.items() if off is not None and self._is_far(off)]
        if far and self._is_swapped(bodies, moment):
            return self._rejected(
                frame, t_s, states | dict.fromkeys(("chaser", "target"), SampleStatus.SWAPPED), SampleStatus.SWAPPED
            )
        for role, off in offs.items():
            since_s = self._outlier_since.setdefault(role, t_s) if role in far else self._outlier_since.pop(role, t_s)
            if role in far and t_s - since_s < WINDOW_S:
                states[role] = SampleStatus.OUTLIER
            elif off is not None:
                sigma = max(self._table.sigma_m, bodies[role].error_m)
                rate = moment.rate if role == "chaser" else np.zeros(6)
                self._windows[role].append(WindowSample(t_s, off, rate, sigma))
            elif role in self._first:
                self._measure_body(role, bodies[role])
        if states["chaser"] is not SampleStatus.OK:
            return self._rejected(frame, t_s, states, states["chaser"])
        self.counts["ok"] += 1
        self.last_s, self._moment = t_s, moment
        self._begun_s = t_s if math.isnan(self._begun_s) else self._begun_s
        off, pose = offs["chaser"], self._in_bench(bodies["chaser"], moment)
        assert off is not None
        self._add_latency(t_s, off, moment)
        return sample._replace(states=states, off=off, pose=pose)

    def _add_latency(self, t_s: float, off: Array, moment: Moment) -> None:
        """Let the latency be estimated from the samples that are so old that a displacement would have been noticed."""
        reached = np.concatenate([moment.r, quat.to_rotation_vector(moment.q)])
        self._recent.append((t_s, off - self.latency.value_s * moment.rate, reached, moment.rate))
        if self._is_beyond:
            self._recent.clear()
        while self._recent and self._recent[0][0] < t_s - 2.0 * WINDOW_S:
            self.latency.add(*self._recent.popleft()[1:])

    def _rejected(
        self, frame: TrackedFrame, t_s: float, states: Mapping[str, SampleStatus], reason: SampleStatus
    ) -> ComparedSample:
        self.counts[reason.name.lower()] += 1
        return ComparedSample(frame, t_s, states)

    def _in_bench(self, body: BodyPose, moment: Moment) -> tuple[Array, Array]:
        """Return r in H (3,), m, and q, H to c, (4,), of the chaser's ``body``; of a point with the encoders' q."""
        assert self._frame is not None
        (origin, q_HW), mounting = self._frame, self._mountings["chaser"]
        q_body = body.q
        if q_body is None:
            q_body = quat.multiply(quat.conjugate(mounting.q), quat.multiply(moment.q, q_HW))
        position, q = mounting.apply(body.position, q_body)
        return quat.transform(q_HW, position - origin), quat.multiply(q, quat.conjugate(q_HW))

    def _off(self, role: str, body: BodyPose, moment: Moment) -> Array | None:
        """Return the difference of a body, (6,), of the chaser to its encoders; None before it has been measured."""
        if role == "chaser":
            off = difference(*self._in_bench(body, moment), moment.r, moment.q)
            if body.q is None:
                off[3:] = np.nan
            return off
        if role not in self._stood or body.q is None:
            return None
        assert self._frame is not None
        place, q_place = self._stood[role]
        position, q = self._mountings[role].apply(body.position, body.q)
        off = difference(position, q, place, q_place)
        off[:3] = quat.transform(self._frame[1], off[:3])
        return off

    def _is_far(self, off: Array) -> bool:
        attitude = linear.length(off[3:])
        return linear.length(off[:3]) > self._table.gate_m or attitude > math.radians(self._table.gate_deg)

    def _is_swapped(self, bodies: Mapping[str, BodyPose], moment: Moment) -> bool:
        """Return whether chaser and target fit once each is taken for the other."""
        if "chaser" not in bodies or "target" not in bodies:
            return False
        exchanged = {"chaser": bodies["target"], "target": bodies["chaser"]}
        offs = [self._off(role, pose, moment) for role, pose in exchanged.items()]
        return not any(off is not None and self._is_far(off) for off in offs)

    def _measure_frame(self, bodies: Mapping[str, BodyPose | None], moment: Moment) -> bool:
        """Take the target into the measurement of H in W; return whether it is complete. A frame in which the chaser
        is not where the encoders show it counts as one without a target."""
        body, chaser = bodies.get("target"), bodies["chaser"]
        if body is None or body.q is None or chaser is None:
            return False
        self._frame = self._mountings["target"].apply(body.position, body.q)
        off = self._off("chaser", chaser, moment)
        self._frame = None
        if off is None or self._is_far(off):
            self.counts["outlier"] += 1
            return False
        self._measure_body("target", body)
        if "target" not in self._stood:
            return False
        self._frame = self._stood["target"]
        self._frame_sigma = math.radians(self._table.sigma_deg) / math.sqrt(_MEASURED)
        return True

    def _measure_body(self, role: str, body: BodyPose) -> None:
        """Take a pose of a body that stands; after enough of them its place is their mean."""
        if body.q is None:
            return
        first = self._first[role]
        first.append(self._mountings[role].apply(body.position, body.q))
        if len(first) == _MEASURED:
            self._stood[role] = mean_pose(first)

    @property
    def is_complete(self) -> bool:
        """Whether the samples that count cover ``WINDOW_S``."""
        return self.last_s - self._begun_s >= WINDOW_S

    def deviations(self, now_s: float) -> dict[str, Deviation]:
        """Return the mean difference of each body in the last ``WINDOW_S``, by its role, or the change of that mean
        within a second if it is farther beyond its own bound."""
        by_role: dict[str, Deviation] = {}
        moment = self._moment
        if moment is None:
            return by_role
        worth = self._worth_at(moment)
        for role, window in self._windows.items():
            while window and window[0].t_s < now_s - 3.0 * WINDOW_S:
                window.popleft()
            now = _mean([each for each in window if each.t_s > now_s - WINDOW_S])
            before = _mean([each for each in window if each.t_s < now_s - 2.0 * WINDOW_S])
            if now is None:
                continue
            deviations = [Deviation(now.off, self._bounds(now.sigma_m, worth, moment.rate, moment.r))]
            if before is not None:
                sigma, rate = math.sqrt(2.0) * now.sigma_m, now.rate - before.rate
                bounds = self._bounds(sigma, (_LOCAL * worth[0], _LOCAL * worth[1]), rate, np.zeros(3))
                deviations.append(Deviation(now.off - before.off, bounds))
            by_role[role] = max(deviations, key=lambda each: each.excess)
        self._is_beyond = any(each.excess > 1.0 for each in by_role.values())
        return by_role

    def _worth_at(self, moment: Moment) -> tuple[float, float]:
        """Return what a pose by the encoders is worth at ``moment``, 1 sigma, m and rad."""
        if self._worth is None:
            return self._table.bench_sigma_m, math.radians(self._table.bench_sigma_deg)
        sigmas = self._worth(moment.axes[:3], moment.axes[3:])
        return float(sigmas.sigma_m.max()), math.radians(sigmas.sigma_deg.max())

    def _bounds(self, sigma_m: float, worth: tuple[float, float], rate: Array, r: Array) -> tuple[float, float]:
        """Return the bounds of a mean difference, m and rad. sigma_m: of a sample of the tracker. worth: of the bench.

        rate: (6,), with which an unknown latency displaces. r: (3,), m, over which H of the tracker is rotated.
        """
        scale, late_s = sigma_m / self._table.sigma_m, self.latency.sigma_s
        sigmas = self._table.sigma_m, math.radians(self._table.sigma_deg)
        rates = linear.length(rate[:3]), linear.length(rate[3:])
        of_frame = self._frame_sigma * linear.length(r), self._frame_sigma if r.any() else 0.0
        position, attitude = (
            _root(scale * sigmas[k] / math.sqrt(_INDEPENDENT), worth[k], of_frame[k], late_s * rates[k]) for k in (0, 1)
        )
        return self._table.bound_sigmas * position, self._table.bound_sigmas * attitude

    def sigmas(self) -> Array:
        """Return the standard deviation of a mean difference at the last sample, (6,), m and rad; nan without one."""
        if self._moment is None:
            return _NAN
        moment = self._moment
        position, attitude = self._bounds(self._table.sigma_m, self._worth_at(moment), moment.rate, moment.r)
        return np.repeat((position, attitude), 3) / self._table.bound_sigmas

    def cause(self, deviations: Mapping[str, Deviation], axis_names: tuple[str, ...]) -> str:
        """Return what most likely has moved, or the axis whose error alone explains the chaser's difference best."""
        chaser = deviations.get("chaser")
        if chaser is None or chaser.excess < 1.0:
            return "the target has moved"
        together = {role for role, each in deviations.items() if role != "chaser" and _is_alike(each, chaser)}
        if "reference" in together:
            return "all bodies have moved alike: the tracker has moved"
        if "target" in together:
            return (
                "chaser and target have moved alike, the body on the floor has not: the base of the bench has moved"
                if "reference" in deviations
                else "chaser and target have moved alike: the tracker or the whole bench (see tracker.reference)"
            )
        assert self._moment is not None
        off = np.nan_to_num(chaser.mean)
        axis, error, part = self.encoders.blame(self._moment.axes, off, self.sigmas())
        if part < _SINGLE:
            shown = " ".join(f"{1e3 * each:+.2f}" for each in off[:3])
            return f"no single axis explains it: the base of the rails, or the geometry, off by {shown} mm in H"
        shown = f"{1e3 * error:+.2f} mm" if axis < 3 else f"{math.degrees(error):+.3f} deg"
        return f"{axis_names[axis]} or its base: {shown} explains {100.0 * part:.0f} %"


def _root(*values: float) -> float:
    """Return the root of the sum of squares."""
    return linear.length(values)


def _mean(samples: list[WindowSample]) -> WindowSample | None:
    """Return the mean of enough samples, None of fewer."""
    if len(samples) < _LEAST:
        return None
    off, rate = (np.array(each).mean(axis=0) for each in ([s.off for s in samples], [s.rate for s in samples]))
    return WindowSample(samples[-1].t_s, off, rate, linear.total(each.sigma_m for each in samples) / len(samples))


def _is_alike(one: Deviation, other: Deviation) -> bool:
    """Return whether two bodies have moved alike in position."""
    apart = linear.length(one.mean[:3] - other.mean[:3])
    return apart < 0.5 * linear.length(other.mean[:3])
