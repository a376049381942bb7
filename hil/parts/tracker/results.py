"""What a tracker has shown of a bench in a run: numbers of the summary, and the section of the report."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.bench.kinematics import show
from hil.core.messages import Array
from hil.maths import linear
from hil.parts.tracker.comparison import ComparedSample, Deviation
from hil.parts.tracker.encoder_poses import EncoderPoses, PoseTrack, difference, pose_of
from hil.report.section import Section

LINES: Final = ("commanded", "encoders", "tracker")
_EACH: Final = 5  # cycles
_DEG: Final = math.degrees(1.0)


class DifferenceSpread:
    """Mean, root mean square and largest size of differences (6,), m and rad."""

    def __init__(self) -> None:
        self._n, self._sum, self._squares = np.zeros(6), np.zeros(6), np.zeros(6)
        self._largest = np.zeros(2)

    def add(self, off: Array) -> None:
        """Add a difference; components that are nan do not count."""
        off, known = np.nan_to_num(off), ~np.isnan(off)
        self._n += known
        self._sum += off
        self._squares += off * off
        self._largest = np.maximum(self._largest, (linear.length(off[:3]), linear.length(off[3:])))

    def mean(self) -> Array:
        """Return the mean, (6,), nan for a component that was never measured."""
        return np.where(self._n > 0.0, self._sum / np.maximum(self._n, 1.0), np.nan)

    def numbers(self) -> dict[str, Any]:
        """Return root mean square and largest size, for JSON."""
        rms = np.where(self._n > 0.0, np.sqrt(self._squares / np.maximum(self._n, 1.0)), np.nan)
        return {**vectors("rms", rms), "max_m": float(self._largest[0]), "max_deg": _DEG * float(self._largest[1])}


def vectors(name: str, values: Array) -> dict[str, list[float | None]]:
    """Return ``values`` (6,), m and rad, as the keys NAME_m and NAME_deg of JSON; null for what is not known."""
    parts = {f"{name}_m": values[:3], f"{name}_deg": _DEG * values[3:]}
    return {key: [float(v) if math.isfinite(v) else None for v in part] for key, part in parts.items()}


class TruthStatistics:
    """Commanded poses, those by the encoders and those by the tracker against the truth that the bench is to show.

    bench: BENCH_PARAMS. step_s: period of the cycle.
    """

    def __init__(self, bench: np.record, step_s: float) -> None:
        self._bench = bench
        self._truth = PoseTrack(step_s)
        self._lines = {name: DifferenceSpread() for name in LINES}
        self._off = DifferenceSpread()
        self._sigmas, self._worst = np.full(6, np.nan), np.zeros(2)
        self._bounds = np.full(2, np.nan)
        self._cycles = 0
        self._last_s, self._gap_s = math.nan, 0.0

    def add_cycle(self, row: np.void, now_s: float, encoders: EncoderPoses) -> None:
        """Take truth and setpoint of ``row`` (CYCLE) at bench time ``now_s``, whose encoders ``encoders`` has."""
        r, v = np.empty(3), np.empty(3)
        truth, setpoint = row["truth"], row["setpoint"]
        show(self._bench, truth["r_CT_H"], truth["v_CT_H"], r, v)
        q = truth["q_CH"].copy()
        self._truth.add_pose(now_s, np.zeros(6), r, q)
        self._last_s = now_s if math.isnan(self._last_s) else self._last_s
        self._cycles += 1
        if self._cycles % _EACH:
            return
        commanded = np.concatenate([setpoint["rail_m"], setpoint["gimbal_rad"]])
        self._lines["commanded"].add(difference(*pose_of(self._bench, commanded), r, q))
        measured_s = encoders.newest_s
        bench, shown = encoders.at(measured_s), self._truth.at(measured_s)
        if bench is not None and shown is not None:
            self._lines["encoders"].add(difference(bench.r, bench.q, shown.r, shown.q))

    def add(self, sample: ComparedSample) -> None:
        """Take a compared sample."""
        if sample.pose is None:
            return
        self._off.add(sample.off)
        self._gap_s, self._last_s = max(self._gap_s, sample.t_s - self._last_s), sample.t_s
        if (shown := self._truth.at(sample.t_s)) is not None:
            off = difference(*sample.pose, shown.r, shown.q)
            self._lines["tracker"].add(np.where(np.isnan(sample.off), np.nan, off))

    def add_deviation(self, chaser: Deviation | None, sigmas: Array) -> None:
        """Take the mean difference of the chaser, and the standard deviations (6,) of such a mean."""
        self._sigmas = np.fmax(self._sigmas, sigmas)
        if chaser is not None:
            self._worst = np.maximum(self._worst, chaser.sizes)
            self._bounds = np.fmax(self._bounds, chaser.bounds)

    def numbers(self) -> dict[str, Any]:
        """Return the numbers for JSON."""
        bounds = [float(each) if math.isfinite(each) else None for each in self._bounds * (1.0, _DEG)]
        return {
            **vectors("sigma", self._sigmas),
            **vectors("off", self._off.mean()),
            "worst_m": float(self._worst[0]),
            "worst_deg": _DEG * float(self._worst[1]),
            "bound_m": bounds[0],
            "bound_deg": bounds[1],
            "longest_gap_s": self._gap_s,
            "lines": {name: spread.numbers() for name, spread in self._lines.items()},
        }


def section(numbers: dict[str, Any]) -> Section:
    """Return the truth of the bench as a section of the report: its budget; commanded, encoders, tracker with one."""
    budget = []
    if "since_s" in numbers:
        margins = [_three(numbers[f"margin_{name}_sigmas"], 1.0, ".0f") for name in ("position", "attitude")]
        budget = [
            f"margins to Table III from {numbers['since_s']:.1f} s on, in standard deviations of the bench's own pose: "
            f"position {margins[0]}, attitude {margins[1]}"
        ]
    if "driver" not in numbers:
        text = f"{_three(numbers['sigma_m'], 1e3, '.2f')} mm in H, {_three(numbers['sigma_deg'], 1.0, '.3f')} deg"
        return Section("Bench", [f"no tracker; sigma of its pose by geometry and encoders: {text}", *budget])
    counts, clock = numbers["counts"], numbers["clock"]
    rejected = ", ".join(f"{n} {name}" for name, n in counts.items() if name != "ok") or "none"
    notes = [
        f"{numbers['driver']}: {counts.get('ok', 0)} samples compared, rejected {rejected}, longest time without one "
        f"{numbers['longest_gap_s']:.2f} s; clock ahead by {1e-6 * clock['clock_ahead_us']:.6f} s, drift "
        f"{1e-3 * clock['clock_drift_ppb']:.1f} ppm, latency by motion {clock['latency_ms']:.2f} ms (sigma "
        f"{clock['latency_sigma_ms']:.2f} ms)",
        f"tracker less encoders: mean {_three(numbers['off_m'], 1e3, '.2f')} mm in H, "
        f"{_three(numbers['off_deg'], 1.0, '.3f')} deg; largest in half a second {1e3 * numbers['worst_m']:.2f} mm, "
        f"{numbers['worst_deg']:.3f} deg; sigma {_three(numbers['sigma_m'], 1e3, '.2f')} mm, "
        f"{_three(numbers['sigma_deg'], 1.0, '.3f')} deg",
    ]
    notes += budget
    if numbers["alarm"]:
        notes.append(numbers["alarm"])
    head = ("bench against truth", "rms x y z, mm", "max, mm", "rms about x y z, deg", "max, deg")
    rows = [
        (
            name,
            _three(line["rms_m"], 1e3, ".2f"),
            f"{1e3 * line['max_m']:.2f}",
            _three(line["rms_deg"], 1.0, ".3f"),
            f"{line['max_deg']:.3f}",
        )
        for name, line in numbers["lines"].items()
    ]
    return Section("Tracker", notes, head, rows)


def _three(values: list[float | None], scale: float, form: str) -> str:
    return " ".join("-" if value is None else f"{scale * value:{form}}" for value in values)
