"""Consistency of the docking monitor on rendered approaches: errors in sigmas, column by column.

python sims/monitor_study.py independent [--portions 2000]   a new monitor for each portion
python sims/monitor_study.py continuous [--portions 200]     sequences, each portion carried over to the next
Add --scene bright-cross (50 Hz half frames, bright on dark), --seed N, --worst N to list the largest errors.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.config.load import load_scene
from hil.config.scene import PixelNoise, Scene
from hil.parts.monitor.kernels.quantities import quantities
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.render import Conditions, TargetRenderer, film
from hil.parts.monitor.results import QUANTITIES, Result
from hil.parts.monitor.settings import MonitorSettings

Floats = NDArray[np.float64]

RANGES_M = (1.3, 40.0)


@dataclass(frozen=True)
class Flight:
    """d and phi (6,) at 0 s, their rates and accelerations, SI, during one portion."""

    place: Floats
    rate: Floats
    acceleration: Floats

    def __call__(self, t_s: float) -> tuple[Floats, Floats]:
        at = self.place + t_s * self.rate + 0.5 * t_s * t_s * self.acceleration
        return at[:3], at[3:]

    def truth(self, t_s: float) -> Floats:
        """Return QUANTITIES (12,) at ``t_s``."""
        d, phi = self(t_s)
        w, out = np.empty(12), np.empty(12)
        w[0::2] = np.concatenate((d, phi))
        w[1::2] = self.rate + t_s * self.acceleration
        quantities(w, out)
        return out


def draw_flight(rng: np.random.Generator, settings: MonitorSettings, ranges: tuple[float, float] = RANGES_M) -> Flight:
    """Return a flight with the target in the image: closing or departing, up to 3 deg of passive angles and roll."""
    d3 = float(np.exp(rng.uniform(*np.log(ranges))))
    passive = rng.uniform(-0.05, 0.05, 2)
    sight = rng.uniform(-0.03, 0.03, 2) * min(1.0, (d3 - 0.5) / 3.0)
    place = np.array([
        passive[0] * d3, passive[1] * d3, d3, passive[1] + sight[1], -passive[0] + sight[0], rng.uniform(-0.06, 0.06),
    ])  # fmt: skip
    speed = min(0.02 * d3, 0.3)
    rate = np.concatenate((rng.uniform(-0.1, 0.1, 2) * speed, [rng.uniform(-1.0, 1.0) * speed], rng.normal(0, 1e-3, 3)))
    sigmas = np.repeat([settings.acceleration_mps2, settings.angular_acceleration_radps2], 3)
    return Flight(place, rate, rng.normal(size=6) * sigmas)


def draw_conditions(rng: np.random.Generator) -> Conditions:
    """Return a camera's noise of 1 to 8 grey values, blur, flicker and uneven light."""
    noise = PixelNoise(read=float(rng.uniform(1.0, 8.0)), k=float(rng.uniform(0.0, 0.05)))
    return Conditions(
        blur_px=float(rng.uniform(0.6, 1.1)), noise=noise, gain=float(rng.uniform(0.7, 1.0)),
        flicker=float(rng.uniform(0.0, 0.05)), slope_right=float(rng.uniform(-0.1, 0.1)),
        slope_down=float(rng.uniform(-0.1, 0.1)),
    )  # fmt: skip


def one_portion(scene: Scene, rng: np.random.Generator, settings: MonitorSettings) -> tuple[Flight, Result]:
    """Return a flight and the result of a new monitor after its first portion."""
    flight = draw_flight(rng, settings)
    renderer = TargetRenderer(scene, conditions=draw_conditions(rng))
    monitor = DockingMonitor(scene, settings)
    pictures = settings.portion_frames if scene.fields == "whole" else settings.portion_frames // 2
    for frame in film(renderer, flight, pictures, rng):
        for portion in monitor.feed(frame):
            return flight, portion
    return flight, monitor.finish()[0]


class Coverage:
    """Errors in their sigmas, by column, and the statuses."""

    def __init__(self) -> None:
        self.ratios: list[Floats] = []
        self.errors: list[Floats] = []
        self.sigmas: list[Floats] = []
        self.places: list[float] = []
        self.modes: list[str] = []
        self.statuses: Counter[str] = Counter()
        self.inconsistent = 0

    def add(self, truth: Floats, portion: Result) -> None:
        """Count one portion."""
        self.statuses[portion.status] += 1
        if portion.frames == 0:
            return
        self.inconsistent += not portion.consistent
        error = portion.values - truth
        self.errors.append(error)
        self.sigmas.append(portion.sigmas)
        self.ratios.append(error / portion.sigmas)
        self.places.append(truth[6])
        self.modes.append(portion.status)

    def print(self) -> None:
        """Print one row per column."""
        print(f"statuses: {dict(self.statuses)}, not consistent: {self.inconsistent}")
        ratios, sigmas = np.array(self.ratios), np.array(self.sigmas)
        print(f"{'column':20s} {'n':>5s} {'in 2 sigma, %':>14s} {'rms, sigmas':>12s} {'mean +-':>15s} {'largest':>8s}")
        for i, name in enumerate(QUANTITIES):
            column = ratios[np.isfinite(ratios[:, i]), i]
            n = len(column)
            if n == 0:
                continue
            inside = 100.0 * np.mean(np.abs(column) < 2.0)
            mean = f"{column.mean():+.3f} {column.std() / np.sqrt(n):.3f}"
            print(
                f"{name:20s} {n:5d} {inside:14.1f} {np.sqrt(np.mean(column**2)):12.3f} {mean:>15s}"
                f" {np.abs(column).max():8.2f}   sigma {np.nanmedian(sigmas[:, i]):.2e}"
            )


def independent(scene: Scene, portions: int, seed: int, worst: int) -> Coverage:
    """Return the coverage over ``portions`` portions with a separate monitor each."""
    settings = MonitorSettings()
    coverage = Coverage()
    listed: list[tuple[float, str]] = []
    for number in range(portions):
        rng = np.random.default_rng([seed, number])
        flight, portion = one_portion(scene, rng, settings)
        coverage.add(flight.truth(portion.t_s), portion)
        if worst:
            ratio = (portion.values - flight.truth(portion.t_s)) / portion.sigmas
            size = float(np.nanmax(np.abs(ratio))) if portion.frames else 99.0
            text = f"{number}: {portion.status} at {flight.place[2]:.2f} m, {portion.frames} frames, {portion.reasons}"
            squares = f"{portion.sigma2_edges:.2f} {portion.sigma2_common:.2f} {portion.sigma2_motion:.2f}"
            listed.append((size, f"{size:7.2f}  {text}  {squares}  {np.round(ratio, 1)}"))
    for _, text in sorted(listed, reverse=True)[:worst]:
        print(text)
    return coverage


def continuous(scene: Scene, portions: int, seed: int) -> Coverage:
    """Return the coverage of sequences of 20 portions, alternately approach and departure, under changing motion."""
    settings = MonitorSettings()
    coverage = Coverage()
    length = 20
    for number in range(-(-portions // length)):
        rng = np.random.default_rng([seed, 7, number])
        flight = Sway(draw_flight(rng, settings, (1.6, 36.0)), rng, settings)
        monitor = DockingMonitor(scene, settings)
        renderer = TargetRenderer(scene, conditions=draw_conditions(rng))
        pictures = length * settings.portion_frames // (1 if scene.fields == "whole" else 2)
        for frame in film(renderer, flight, pictures, rng):
            for portion in monitor.feed(frame):
                coverage.add(flight.truth(portion.t_s), portion)
    return coverage


class Sway:
    """Flight at a uniform rate with a slow sway in all six components, with accelerations of the allowed size."""

    def __init__(self, mean: Flight, rng: np.random.Generator, settings: MonitorSettings) -> None:
        self._mean = replace(mean, acceleration=np.zeros(6))
        self._omega = 2.0 * np.pi / rng.uniform(8.0, 25.0, 6)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 6)
        sigmas = np.repeat([settings.acceleration_mps2, settings.angular_acceleration_radps2], 3)
        self._size = np.sqrt(2.0) * sigmas / self._omega**2
        self._size[2] *= 0.2

    def __call__(self, t_s: float) -> tuple[Floats, Floats]:
        d, phi = self._mean(t_s)
        sway = self._size * np.sin(self._omega * t_s + self._phase)
        return d + sway[:3], phi + sway[3:]

    def truth(self, t_s: float) -> Floats:
        """Return QUANTITIES (12,) at ``t_s``."""
        d, phi = self(t_s)
        w, out = np.empty(12), np.empty(12)
        w[0::2] = np.concatenate((d, phi))
        w[1::2] = self._mean.rate + self._size * self._omega * np.cos(self._omega * t_s + self._phase)
        quantities(w, out)
        return out


def main() -> None:
    """Run the study selected on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=("independent", "continuous"))
    parser.add_argument("--portions", type=int)
    parser.add_argument("--scene", default="atv")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--worst", type=int, default=0)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    scene = load_scene(given.scene).value
    start = time.perf_counter()
    if given.study == "independent":
        coverage = independent(scene, given.portions or 2000, given.seed, given.worst)
    else:
        coverage = continuous(scene, given.portions or 200, given.seed)
    coverage.print()
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
