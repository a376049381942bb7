"""Comparison of the docking monitor with the vision unit and the truth, each in its own sigmas."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.params import bench as bench_params
from hil.parts.monitor.camera import EncoderTrack
from hil.parts.monitor.kernels.quantities import of_chaser, of_measured_pose, quantities
from hil.parts.monitor.params import mounting
from hil.parts.monitor.results import QUANTITIES
from hil.parts.monitor.setup import MonitorOutcome
from hil.report.section import Section
from hil.sensors.vision_unit import columns as vmu_columns

Floats = NDArray[np.float64]

_RATE: Final = QUANTITIES.index("range_rate_mps")
_RANGE: Final = QUANTITIES.index("range_m")
_ANGLES: Final = np.array([i for i, name in enumerate(QUANTITIES) if name.endswith("_rad")])
_BENCH_RATE_S: Final = 0.5  # half the time over which the encoders' positions are differenced
_SHORTEST_S: Final = 0.1


def judge_monitor(watched: MonitorOutcome, history: np.ndarray, scenario: Scenario, rig: Rig) -> dict[str, Any]:
    """Return the JSON content: counts, times, and for each of QUANTITIES the errors and their size in sigmas.

    truth: the simulated chaser. bench: the camera's position by the encoders, from which its images were rendered;
    the lag of the axes behind the truth is an error of the monitor against the truth only.
    """
    compared = [portion for portion in watched.portions if portion.frames and len(history)]
    compared = [portion for portion in compared if portion.t_s <= history["t_s"][-1]]
    values = np.array([portion.values for portion in compared]).reshape(-1, len(QUANTITIES))
    sigmas = np.array([portion.sigmas for portion in compared]).reshape(-1, len(QUANTITIES))
    times = np.array([portion.t_s for portion in compared])
    truth = _Truth(history, mounting(scenario.monitor))
    against_truth = _difference(values, truth.at(times))
    against_bench = _difference(values, _bench(history, scenario, rig, times))
    vmu_t, vmu_error, vmu_sigma = _vision_unit(history, truth)
    beside = _nearest(vmu_t, times)
    apart = _difference(against_truth, vmu_error[beside]) if len(vmu_t) else np.full_like(against_truth, np.nan)
    both = np.hypot(sigmas, vmu_sigma[beside]) if len(vmu_t) else np.full_like(sigmas, np.nan)
    return {
        "source": scenario.monitor.source,
        "scene": watched.scene,
        "frames": watched.frames,
        "portions": len(watched.portions),
        "status": dict(Counter(portion.status for portion in watched.portions)),
        "longest_gap_s": _longest_gap(watched, history),
        "frame_ms": {"mean": 1e3 * watched.frame_mean_s, "max": 1e3 * watched.frame_max_s},
        "lag_s": watched.lag_s,
        "missed_rows": watched.missed_rows,
        "failure": watched.failure,
        "warning": watched.warning,
        "quantities": {
            name: {
                "truth": _figures(against_truth[:, i], sigmas[:, i]),
                "bench": _figures(against_bench[:, i], sigmas[:, i]),
                "vmu": _figures(vmu_error[:, i], vmu_sigma[:, i]),
                "monitor_minus_vmu": _figures(apart[:, i], both[:, i]),
            }
            for i, name in enumerate(QUANTITIES)
        },
    }


def _longest_gap(watched: MonitorOutcome, history: np.ndarray) -> float | None:
    """Return the longest time, s, without a row of the monitor's table, from the run's start to its end."""
    if not len(history):
        return None
    times = [0.0, *(portion.t_s for portion in watched.portions), float(history["t_s"][-1])]
    return float(np.max(np.diff(times)))


def _figures(errors: Floats, sigmas: Floats) -> dict[str, float | int] | None:
    """Return the figures of one quantity; None if it was never observed."""
    finite = np.isfinite(errors) & np.isfinite(sigmas)
    if not finite.any():
        return None
    error, sigma = errors[finite], sigmas[finite]
    ratio = np.abs(error) / np.maximum(sigma, 1e-300)
    return {
        "n": len(error),
        "mean": float(np.mean(error)),
        "rms": float(np.sqrt(np.mean(error**2))),
        "sigma_rms": float(np.sqrt(np.mean(sigma**2))),
        "share_in_2_sigma": float(np.mean(ratio <= 2.0)),
        "most_sigmas": float(np.max(ratio)),
    }


def _difference(one: Floats, other: Floats) -> Floats:
    """Return one - other, (n, 12); angles within +-pi."""
    difference = one - other
    difference[:, _ANGLES] = (difference[:, _ANGLES] + np.pi) % (2.0 * np.pi) - np.pi
    return difference


class _Truth:
    """QUANTITIES of the simulated chaser at any time of the run."""

    def __init__(self, history: np.ndarray, places: np.record) -> None:
        self.places = places
        self._t = history["t_s"]
        self._values = np.empty((len(history), len(QUANTITIES)))
        truth = history["truth"]
        for row, r, q in zip(self._values, truth["r_CT_H"], truth["q_CH"], strict=True):
            of_chaser(places, r, q, row)
        if len(history) > 1:
            self._values[:, _RATE] = np.gradient(self._values[:, _RANGE], self._t)

    def at(self, times: Floats) -> Floats:
        """Return (n, 12), SI, interpolated linearly between the rows."""
        if not len(self._t):
            return np.full((len(times), len(QUANTITIES)), np.nan)
        return np.column_stack([np.interp(times, self._t, column) for column in self._values.T])


def _bench(history: np.ndarray, scenario: Scenario, rig: Rig, times: Floats) -> Floats:
    """Return QUANTITIES (n, 12), SI, of the camera by the encoders."""
    track = EncoderTrack(bench_params.bench(rig, scenario.step_s, scenario.bench), mounting(scenario.monitor))
    track.add(history)
    truth = np.empty((len(times), len(QUANTITIES)))
    for row, t_s in zip(truth, times, strict=True):
        d, phi = track(t_s)
        half = min(_BENCH_RATE_S, max(t_s - history["t_s"][0], _SHORTEST_S), max(history["t_s"][-1] - t_s, _SHORTEST_S))
        start, stop = max(t_s - half, history["t_s"][0]), min(t_s + half, history["t_s"][-1])
        w = np.zeros(12)
        w[0:6:2], w[6::2] = d, phi
        w[1:6:2] = (track(stop)[0] - track(start)[0]) / max(stop - start, 1e-9)
        quantities(w, row)
    return truth


def _vision_unit(history: np.ndarray, truth: _Truth) -> tuple[Floats, Floats, Floats]:
    """Return times (n,), s, errors and sigmas (n, 12), SI, of the vision unit's poses in the monitor's quantities."""
    poses = vmu_columns.poses(history)
    poses = poses[(poses["t_s"] >= 0.0)]
    values, sigmas = np.empty((len(poses), len(QUANTITIES))), np.empty((len(poses), len(QUANTITIES)))
    for i, pose in enumerate(poses):
        of_measured_pose(
            truth.places,
            pose["z_TC_C"],
            pose["covariance_position"],
            pose["q_CH"],
            pose["covariance_attitude"],
            values[i],
            sigmas[i],
        )
    return poses["t_s"], _difference(values, truth.at(poses["t_s"])), sigmas


def _nearest(sorted_times: Floats, times: Floats) -> NDArray[np.int64]:
    """Return the index of the one of ``sorted_times`` (not empty) that is nearest to each of ``times``."""
    if not len(sorted_times):
        return np.zeros(len(times), np.int64)
    after = np.clip(np.searchsorted(sorted_times, times), 1, max(len(sorted_times) - 1, 1))
    after = np.minimum(after, len(sorted_times) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(sorted_times[before] - times) <= np.abs(sorted_times[after] - times)
    return np.where(closer, before, after)


_ROWS: Final = (  # quantity, label, unit in SI, unit
    ("range_m", "range", 1e-3, "mm"),
    ("range_rate_mps", "range rate", 1e-3, "mm/s"),
    ("d1_m", "d1", 1e-3, "mm"),
    ("d2_m", "d2", 1e-3, "mm"),
    ("d3_m", "d3", 1e-3, "mm"),
    ("phi1_rad", "active pitch", np.pi / 180.0, "deg"),
    ("phi2_rad", "active yaw", np.pi / 180.0, "deg"),
    ("phi3_rad", "active roll", np.pi / 180.0, "deg"),
    ("pitch_passive_rad", "passive pitch", np.pi / 180.0, "deg"),
    ("yaw_passive_rad", "passive yaw", np.pi / 180.0, "deg"),
)


def monitor_section(content: dict[str, Any]) -> Section:
    """Return the comparison as a section of the report."""
    status = ", ".join(f"{count} {name}" for name, count in content["status"].items()) or "none"
    notes = [
        f"{content['scene']}: {content['frames']} frames of {content['frame_ms']['mean']:.1f} ms each, "
        f"portions: {status}, longest time without one {content['longest_gap_s'] or 0.0:.2f} s"
    ]
    if content["failure"] or content["missed_rows"]:
        notes.append(f"{content['failure'] or 'late'}, {content['missed_rows']} cycles missed")
    if content["warning"]:
        notes.append(content["warning"])
    head = (
        "rms error (sigma, in 2 sigma)", "monitor to truth", "monitor to encoders", "vision unit to truth",
        "one to the other",
    )  # fmt: skip
    rows = [
        (f"{label}, {name}", *(_cell(figures, unit) for figures in content["quantities"][quantity].values()))
        for quantity, label, unit, name in _ROWS
    ]
    return Section("Monitor", notes, head, rows)


def _cell(figures: dict[str, float] | None, unit: float) -> str:
    if figures is None:
        return "-"
    share = f"{100.0 * figures['share_in_2_sigma']:.0f} %"
    return f"{figures['rms'] / unit:.3g} ({figures['sigma_rms'] / unit:.3g}, {share})"
