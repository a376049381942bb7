"""Numbers of a run that is too long for its rows to be kept: accumulated part by part, in bounded memory.

``accumulate`` attaches to a runner. In real time a thread evaluates one part while the loop fills the next.

The same functions as for a short run are applied to each part; sums are added, extremes kept, mean squares weighted.
Percentiles are those of a sample that is thinned as it grows; extremes are exact.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import Array, new
from hil.gnc import ready_phase
from hil.loop.overrun_monitor import lateness_percentiles_us
from hil.loop.runner import Outcome, Runner
from hil.params.ready import ROW_NAMES, ready_params
from hil.report import summary
from hil.report.bench_energy import ENERGY_KEYS, judge_energy_added
from hil.report.bench_error import judge_bench_error
from hil.report.device_times import NAMES, count_beyond, execution_times_s, judge_times
from hil.report.integrity import IntegrityJudge
from hil.report.latency import measured, percentiles, pose_to_command_s
from hil.report.navigation_bound import NavigationBound
from hil.report.verdict import Verdict, deviations, until_abort, verdict_of
from hil.report.verdict_parts import (
    energy_part,
    frame_delta_v,
    impulsive_delta_v,
    is_secure,
    judge_field_of_view,
    judge_security,
    later_abort,
)
from hil.setup.assembly import Job

_SLICE: Final = 1024  # rows that are evaluated at once
_PAUSE_WALL_S: Final = 0.02  # between two slices while the loop runs in real time
_SAMPLE_MAX: Final = 100_000
_NEES: Final = (("nees_pkf", "nees_position"), ("nees_akf", "nees_attitude"))


class ThinnedSample:
    """Values for percentiles: all of them, then every second, every fourth ...; the largest is exact."""

    def __init__(self) -> None:
        self._parts: list[Array] = []
        self._kept = self._seen = 0
        self._every = 1
        self.largest = -math.inf

    def add(self, values: Array) -> None:
        """Add ``values`` (n,)."""
        if not len(values):
            return
        self.largest = max(self.largest, float(values.max()))
        self._parts.append(values[-self._seen % self._every :: self._every].copy())
        self._seen += len(values)
        self._kept += len(self._parts[-1])
        if self._kept > _SAMPLE_MAX:
            self._parts = [np.concatenate(self._parts)[::2]]
            self._kept, self._every = len(self._parts[0]), 2 * self._every

    def values(self) -> Array:
        """Return the sample with the largest value as its last."""
        return np.concatenate([*self._parts, [self.largest]]) if self._parts else np.empty(0)


class MeanSquares:
    """Root mean squares of several quantities over parts of different lengths."""

    def __init__(self) -> None:
        self._sums: dict[str, Any] = {}
        self._counts: dict[str, int] = {}

    def add(self, name: str, rms: list[float] | float | None, n: int) -> None:
        """Add a part of ``n`` values whose root mean square is ``rms``; None for a part without."""
        if rms is not None and n:
            self._sums[name] = self._sums.get(name, 0.0) + n * np.square(rms)
            self._counts[name] = self._counts.get(name, 0) + n

    def rms(self, name: str) -> Any:
        """Return the root mean square over all parts, None without any."""
        if name not in self._sums:
            return None
        found = np.sqrt(self._sums[name] / self._counts[name])
        return found.tolist() if found.ndim else float(found)


class NavigationSums:
    """Errors of the estimate over parts of a run: ``summary.navigation_errors`` of all rows, in bounded memory."""

    def __init__(self) -> None:
        self._squares = {name: MeanSquares() for name in ("known", "settled")}
        self._nees: dict[tuple[str, str], tuple[float, int]] = {}
        self._only: dict[str, Any] | None = None
        self._parts = 0

    def add(self, rows: np.ndarray) -> None:
        """Add the next ``rows`` (n,) of CYCLE."""
        self._parts += 1
        self._only = summary.navigation_errors(rows) if self._parts == 1 else None
        known = rows[rows["navigation"]["valid"] == 1]
        for span, chosen in (("known", known), ("settled", known[known["t_s"] >= summary.SETTLED_S])):
            found = summary.navigation_errors(chosen)
            for name in summary.RMS_KEYS:
                self._squares[span].add(name, found[name], len(chosen))
            for name, column in _NEES:
                finite = chosen[column][np.isfinite(chosen[column])]
                total, count = self._nees.get((span, name), (0.0, 0))
                self._nees[span, name] = (total + float(finite.sum()), count + len(finite))

    def errors(self) -> dict[str, Any]:
        """Return them, by the keys of the JSON; of one part exactly those of its rows."""
        if self._only is not None:
            return self._only
        is_settled = self._squares["settled"].rms(summary.RMS_KEYS[0]) is not None
        span = "settled" if is_settled else "known"
        sums = {name: self._nees.get((span, name), (0.0, 0)) for name, _ in _NEES}
        nees = {name: total / count if count else None for name, (total, count) in sums.items()}
        return {name: self._squares[span].rms(name) for name in summary.RMS_KEYS} | nees


class LongRun:
    """Accumulates the rows of a run in order; ``numbers`` are those of ``summary.numbers_of`` for all of them.

    pause_s: wall time between two slices of a part.
    """

    def __init__(self, scenario: Scenario, rig: Rig, pause_s: float = 0.0) -> None:
        self._scenario, self._rig, self._pause_s = scenario, rig, pause_s
        self._ready_params = ready_params(scenario.requirements)
        self._ready = new(ready_phase.READY_STATE)
        self._integrity = IntegrityJudge(scenario, rig)
        self._bound = NavigationBound(scenario, rig, summary.SETTLED_S)
        self._last: np.ndarray | None = None
        self._sums: dict[str, Any] = {}
        self._eclipse_s = 0.0
        self._security: dict[str, Any] = {}
        self._view: dict[str, Any] = {}
        self._squares = MeanSquares()
        self._largest: dict[str, Any] = {}
        self._nees: dict[str, tuple[float, int]] = {}
        self._latency = {
            name: ThinnedSample()
            for name in ("pose_to_command_ms", "pose_to_wire_ms", "setpoint_to_encoder_ms", "pose_behind_imu_ms")
        }
        self._lateness = ThinnedSample()
        self._times = {name: ThinnedSample() for name in NAMES}
        self._beyond = dict.fromkeys(NAMES, 0)
        self._histogram: list[dict[str, Any]] = []

    def add(self, rows: np.ndarray) -> None:
        """Add the next ``rows`` (n,) of CYCLE."""
        for start in range(0, len(rows), _SLICE):
            self._add(rows[start : start + _SLICE])
            if self._pause_s and start + _SLICE < len(rows):
                time.sleep(self._pause_s)

    def _add(self, rows: np.ndarray) -> None:
        found = deviations(until_abort(rows), self._scenario.requirements)
        table = np.ascontiguousarray(np.hstack([getattr(found, name) for name in ROW_NAMES]))
        ready_phase.update_all(self._ready_params, self._ready, np.ascontiguousarray(found.t_s), table)
        self._integrity.add(rows)
        self._bound.add(rows)
        joined = rows if self._last is None else np.concatenate([self._last, rows])
        self._add_sums(joined)
        self._add_security(joined)
        self._add_view(rows)
        self._eclipse_s += summary.eclipse_s(rows, self._scenario.step_s)
        self._add_errors(rows, joined)
        self._add_times(rows, joined)
        self._last = rows[-1:].copy()

    def _add_sums(self, joined: np.ndarray) -> None:
        """Add what is a sum over the rows: that of ``joined`` less that of the row before."""
        for sign, rows in ((1.0, joined), (-1.0, self._last)):
            if rows is None:
                continue
            sums = summary.thrusters_of(rows, self._scenario)
            sums["line_mps"] = impulsive_delta_v(rows["reference"]["v_CT_H"]) + frame_delta_v(rows, self._scenario)
            for name, value in sums.items():
                self._sums[name] = self._sums.get(name, 0.0) + sign * np.asarray(value)

    def _add_security(self, joined: np.ndarray) -> None:
        kept = self._security
        if kept and kept["abort"] is not None:
            kept["abort"] = later_abort(kept["abort"], joined, self._scenario)
            kept["nearest_m"] = min(kept["nearest_m"], float(np.linalg.norm(joined["truth"]["r_CT_H"], axis=1).min()))
            return
        entered = bool(kept) and kept["corridor_margin_m"] >= 0.0
        found = judge_security(joined, self._scenario, entered)
        if not kept:
            self._security = found
            return
        for value, at in (("corridor_margin_m", "corridor_margin_at_s"), ("closing_margin_mps", "closing_margin_at_s")):
            begins = value == "corridor_margin_m" and not entered and found[value] >= 0.0
            if found[value] < kept[value] or begins:
                kept[value], kept[at] = found[value], found[at]
        kept["nearest_m"] = min(kept["nearest_m"], found["nearest_m"])
        kept["passed"], kept["abort"] = is_secure(kept["corridor_margin_m"], kept["closing_margin_mps"]), found["abort"]

    def _add_view(self, rows: np.ndarray) -> None:
        found, kept = judge_field_of_view(rows, self._rig, self._scenario.step_s, self._scenario.bench), self._view
        if not kept:
            self._view = found
            return
        lost_s = kept["lost_s"] + found["lost_s"]
        if found["margin_px"] is not None and (kept["margin_px"] is None or found["margin_px"] < kept["margin_px"]):
            kept |= found
        kept["lost_s"], kept["passed"] = lost_s, lost_s == 0.0

    def _add_errors(self, rows: np.ndarray, joined: np.ndarray) -> None:
        squares, n = self._squares, len(rows)
        settled = rows[(rows["t_s"] >= summary.SETTLED_S) & (rows["navigation"]["valid"] == 1)]
        estimate = summary.navigation_errors(settled)
        for name in summary.RMS_KEYS:
            squares.add(name, estimate[name], len(settled))
        for name, column in _NEES:
            known = settled[column][np.isfinite(settled[column])]
            total, count = self._nees.get(name, (0.0, 0))
            self._nees[name] = (total + float(known.sum()), count + len(known))
        axes = summary.axis_errors(joined)
        for name in ("rail_error", "gimbal_error"):
            unit = "m" if name == "rail_error" else "deg"
            squares.add(f"{name}_rms_{unit}", axes.get(f"{name}_rms_{unit}"), len(joined) - 1)
            self._keep_largest(f"{name}_max_{unit}", axes.get(f"{name}_max_{unit}"))
        for name, joule in judge_energy_added(joined, self._scenario, self._rig).items():
            self._sums[name] = self._sums.get(name, 0.0) + joule
        bench = judge_bench_error(rows, self._rig, self._scenario.step_s, summary.SETTLED_S, self._scenario.bench)
        for name in ("pose_error_mm", "pose_error_deg"):
            squares.add(name, bench[name]["rms"], n)
            self._keep_largest(name, bench[name]["max"])
        for name, error in (
            ("share_of_navigation_error", "position_rmse_m"),
            ("share_of_attitude_error", "attitude_rmse_deg"),
        ):
            if bench[name] is not None and estimate[error] is not None:
                whole = float(np.linalg.norm(estimate[error]))
                squares.add(f"{name} above", bench[name] * whole, len(settled))
                squares.add(f"{name} below", whole, len(settled))

    def _keep_largest(self, name: str, value: Any) -> None:
        if value is not None:
            self._largest[name] = np.maximum(self._largest.get(name, -math.inf), value)

    def _add_times(self, rows: np.ndarray, joined: np.ndarray) -> None:
        step_s = self._scenario.step_s
        latencies = measured(joined, step_s, step_s / self._rig.ticks(step_s))
        latencies["pose_to_command_ms"] = pose_to_command_s(rows)  # the others leave the first row out
        for name, values in latencies.items():
            self._latency[name].add(values)
        self._lateness.add(rows["lateness_s"])
        times_s = execution_times_s(rows)
        for name, count in count_beyond(times_s, self._rig, step_s).items():
            self._times[name].add(times_s[name])
            self._beyond[name] += count
        found = summary.lateness_counts(rows["lateness_s"], self._rig)
        for name in ("cycles", "late_wakeups"):
            self._sums[name] = self._sums.get(name, 0) + found[name]
        for kept, part in zip(self._histogram, found["lateness_histogram"], strict=False):
            kept["cycles"] += part["cycles"]
        self._histogram = self._histogram or found["lateness_histogram"]

    def take(self, rows: np.ndarray) -> np.ndarray:
        """Add ``rows``; return their memory, which may be overwritten."""
        self.add(rows)
        return rows

    def numbers(self) -> tuple[dict[str, Any], Verdict]:
        """Return the numbers of all rows so far, and the verdict."""
        verdict = verdict_of(self._ready, self._scenario.requirements)
        sums, rms = self._sums, self._squares.rms
        thrusters: dict[str, Any] = {
            name: value.tolist() if name != "thruster_firings" else [round(n) for n in value.tolist()]
            for name, value in sums.items()
            if name not in ("line_mps", "cycles", "late_wakeups", *ENERGY_KEYS)
        }
        firings = sum(thrusters["thruster_firings"])
        energy = energy_part(float(sums["line_mps"]), self._scenario, float(thrusters["propellant_kg"]), firings)
        nees = {name: total / count if count else None for name, (total, count) in self._nees.items()}
        return {
            "verdict": {
                "control_precision": summary.control_precision(verdict, self._scenario),
                "security": self._security,
                "energy": energy,
                "field_of_view": self._view,
            },
            "integrity": summary.integrity_of(self._integrity.state, self._scenario),
            "navigation": {name: rms(name) for name in summary.RMS_KEYS} | nees | self._bound.as_json(),
            "thrusters": thrusters,
            "orbit": {"eclipse_s": self._eclipse_s},
            "bench": {
                "rail_error_rms_m": rms("rail_error_rms_m"),
                "rail_error_max_m": np.asarray(self._largest["rail_error_max_m"]).tolist(),
                "gimbal_error_rms_deg": rms("gimbal_error_rms_deg"),
                "gimbal_error_max_deg": np.asarray(self._largest["gimbal_error_max_deg"]).tolist(),
                **{
                    name: {"rms": rms(name), "max": float(self._largest[name]) if name in self._largest else None}
                    for name in ("pose_error_mm", "pose_error_deg")
                },
                **{
                    name: _ratio(rms(f"{name} above"), rms(f"{name} below"))
                    for name in ("share_of_navigation_error", "share_of_attitude_error")
                },
                "energy": {name: float(sums[name]) for name in ENERGY_KEYS},
            },
            "latency": {name: percentiles(1e3 * sample.values()) for name, sample in self._latency.items()},
            "timing": {
                "cycles": int(sums["cycles"]),
                "late_wakeups": int(sums["late_wakeups"]),
                "lateness_us": lateness_percentiles_us(self._lateness.values()),
                "lateness_histogram": self._histogram,
                "devices": judge_times(
                    {name: sample.values() for name, sample in self._times.items()},
                    self._beyond,
                    self._rig,
                    self._scenario.step_s,
                ),
            },
        }, verdict


def _ratio(above: float | None, below: float | None) -> float | None:
    return above / below if above is not None and below else None


class _PartThread:
    """Adds each part to ``run`` in a thread, while the loop fills the other of two memories."""

    def __init__(self, run: LongRun, history: np.ndarray) -> None:
        self._run = run
        self._free = np.zeros(len(history), history.dtype)
        self._thread: threading.Thread | None = None

    def take(self, rows: np.ndarray) -> np.ndarray:
        """Begin to add ``rows``; return the other memory. Waits for the part before, which takes seconds of minutes."""
        self.wait()
        self._thread = threading.Thread(target=self._run.add, args=(rows,), name="long-run", daemon=True)
        self._thread.start()
        free, self._free = self._free, rows
        return free

    def wait(self) -> None:
        """Wait until the last part is added."""
        if self._thread is not None:
            self._thread.join()


def _load_kernels(job: Job, row: np.ndarray) -> None:
    """Evaluate two rows like ``row`` (1,) of CYCLE: a kernel that is first loaded in the thread would stop the loop."""
    rows = np.repeat(row, 2)
    rows["t_s"] = 0.0, job.scenario.value.step_s
    rows["truth"]["q_CH"] = rows["navigation"]["q_CH"] = rows["reference"]["q_CH"] = 0.0, 0.0, 0.0, 1.0
    with np.errstate(all="ignore"):
        LongRun(job.scenario.value, job.rig.value).add(rows)


def accumulate(runner: Runner, job: Job) -> Callable[[Outcome], tuple[dict[str, Any], Verdict] | None]:
    """Attach to ``runner`` if the run of ``job`` is longer than its memory of rows.

    Return a function that returns the ``numbers`` of the run with an outcome; None if its rows give them.
    """
    loop = runner.loop
    if job.cycles <= len(loop.history):
        return lambda _: None
    paced = runner.rate.paced
    run = LongRun(job.scenario.value, job.rig.value, _PAUSE_WALL_S if paced else 0.0)
    if paced:
        _load_kernels(job, loop.now.row)
    part_thread = _PartThread(run, loop.history) if paced else None
    loop.on_full = run.take if part_thread is None else part_thread.take

    def end(outcome: Outcome) -> tuple[dict[str, Any], Verdict] | None:
        if loop.first == 0:
            return None
        if part_thread is not None:
            part_thread.wait()
        run.add(outcome.history)
        return run.numbers()

    return end
