"""Cost and errors of a stereo pair of 1024 x 1024, and of OpenCV's functions on the same images.

python benchmarks/vmu.py [images]

One thread, processor time. tracked: in windows about the predicted LEDs. full frame: the whole images,
without a predicted pose. OpenCV: intensity-weighted centroids of connected components above the background; their
identities are taken from the truth; solvePnP and solvePnPRefineLM of the left camera from the true pose, and least
squares of both cameras' projections from there. Freed memory stays with the process: else the buffers that OpenCV
allocates for each image cost seven times as much as its computation.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy, as `hil` does: idle threads spin, and would count

import argparse
import ctypes
import time
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.vmu.geometry import EXACT, camera_pair, led_positions
from hil.vmu.render import Extras, Light, RingAppearance, RingRenderer, projections
from hil.vmu.unit import VisionUnit

REPEATS = 7
_AROUND = 3  # px around a component
LENS = {"fx": 1200.0, "fy": 1200.0, "width": 1024, "height": 1024, "distortion": (-0.08, 0.02, 3e-4, -2e-4, 0.0)}


def geometry() -> VmuGeometry:
    angles = np.radians(60.0 * np.arange(6))
    leds = np.column_stack([0.12 * np.cos(angles), 0.12 * np.sin(angles), np.zeros(6)])
    leds[0, 2] = -0.06
    return VmuGeometry.model_validate(
        {
            "leds_m": tuple(tuple(float(v) for v in led) for led in leds),
            "left": LENS | {"cx": 511.5, "cy": 511.5},
            "right": LENS | {"cx": 509.0, "cy": 512.5},
            "baseline_m": (0.2, 0.0, 0.0),
            "tolerances": EXACT,
        }
    )


def median_ms(call: Callable[[], object]) -> float:
    costs = []
    for _ in range(REPEATS):
        start = time.process_time()
        call()
        costs.append(1e3 * (time.process_time() - start))
    return float(np.median(costs))


def centroids(image: np.ndarray) -> Array:
    """Return the centroids (n, 2), px, of the lights of an image, weighted by what is above their surroundings."""
    level = float(np.median(image[::4, ::4]))
    noise = max(1.4826 * float(np.median(np.abs(image[::4, ::4] - level))), 1.0)
    _, mask = cv2.threshold(image, level + 5.0 * noise, 255, cv2.THRESH_BINARY)
    count, _, boxes, _ = cv2.connectedComponentsWithStats(mask)
    found = []
    for u, v, wide, high, area in boxes[1:count]:
        if area < 3 or u < _AROUND or v < _AROUND:
            continue
        patch = image[v - _AROUND : v + high + _AROUND, u - _AROUND : u + wide + _AROUND].astype(float)
        edge = np.concatenate([patch[0], patch[-1], patch[:, 0], patch[:, -1]])
        moments = cv2.moments(np.maximum(patch - np.median(edge) - 2.0 * noise, 0.0))
        found.append([u - _AROUND + moments["m10"] / moments["m00"], v - _AROUND + moments["m01"] / moments["m00"]])
    return np.array(found).reshape(-1, 2)


class OpenCv:
    """Centroids of both images, the refined pose of the left one, and the least squares of both."""

    def __init__(self, chosen: VmuGeometry) -> None:
        self._cameras = [
            (np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1.0]]), np.array(c.distortion))
            for c in (chosen.left, chosen.right)
        ]
        self._leds, self._baseline = led_positions(chosen), np.array(chosen.baseline_m)

    def solve(
        self, images: Sequence[np.ndarray], places: Sequence[Array], turn: Array, t: Array
    ) -> tuple[Array, Array] | None:
        """Return the position by the left image and by both, None unless both show all LEDs. places: true pixels."""
        seen = []
        for image, true in zip(images, places, strict=True):
            lights = centroids(image)
            away = np.hypot(*(lights[None] - true[:, None]).transpose(2, 0, 1)) if len(lights) else np.full((1, 1), 9.0)
            if away.min(axis=1).max() > 3.0:
                return None
            seen.append(lights[away.argmin(axis=1)])
        _, turned, moved = cv2.solvePnP(
            self._leds, seen[0], *self._cameras[0], turn.copy(), t.copy(), True, cv2.SOLVEPNP_ITERATIVE
        )
        turned, moved = cv2.solvePnPRefineLM(self._leds, seen[0], *self._cameras[0], turned, moved)

        def left_over(x: Array) -> Array:
            shifts = (x[3:], x[3:] - self._baseline)
            pixels = [
                cv2.projectPoints(self._leds, x[:3], shift, *camera)[0][:, 0]
                for shift, camera in zip(shifts, self._cameras, strict=True)
            ]
            return (np.array(seen) - pixels).ravel()

        both = least_squares(left_over, np.concatenate([turned[:, 0], moved[:, 0]]), method="lm")
        return moved[:, 0], both.x[3:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=10, help="pairs at each range")
    count = parser.parse_args().count
    cv2.setNumThreads(1)
    for option in (-1, -3):  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD of glibc
        ctypes.CDLL(None).mallopt(option, 1 << 30)
    chosen, rng = geometry(), np.random.default_rng(0)
    pair, leds = camera_pair(chosen), led_positions(chosen)
    renderer, unit, opencv = RingRenderer(pair, leds, RingAppearance()), VisionUnit(chosen), OpenCv(chosen)
    unit.warm_up()
    print(
        "range, m | tracked, ms  full frame, ms  OpenCV, ms | RMS error of position, mm: hil, OpenCV left, both | pairs"
    )
    for range_m in (1.0, 2.0, 4.0, 8.0, 12.0):
        tracked, full, other, own_error, errors_left, errors_both = [], [], [], [], [], []
        for _ in range(count):
            t = np.array([0.1 + rng.uniform(-0.02, 0.02) * range_m, rng.uniform(-0.05, 0.05) * range_m, range_m])
            turn = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(-3.0, 3.0)])
            q = np.asarray(Rotation.from_rotvec(-turn).as_quat())
            lights = [Light((rng.uniform(-0.3, 0.3) * range_m, rng.uniform(-0.3, 0.3) * range_m, range_m))] * 2
            left, right = renderer.pair(t, q, None, rng, Extras(lights))

            def whole(left: np.ndarray = left, right: np.ndarray = right) -> object:
                unit.track.drop()
                return unit.solve(left, right, 0.0)

            full.append(median_ms(whole))
            unit.track.drop()
            for k in range(3):
                unit.solve(left, right, 0.16 * k)
            moments = iter(range(3, 3 + REPEATS))
            tracked.append(median_ms(lambda: unit.solve(left, right, 0.16 * next(moments))))  # noqa: B023
            solution = unit.solve(left, right, 0.16 * (3 + REPEATS))
            if solution.pose is not None:
                own_error.append(solution.pose.t_v - t)
            places = projections(pair, leds, t, q)
            other.append(median_ms(lambda: opencv.solve((left, right), places, turn, t)))  # noqa: B023
            found = opencv.solve((left, right), places, turn, t)
            if found is not None:
                errors_left.append(found[0] - t)
                errors_both.append(found[1] - t)
        each = (own_error, errors_left, errors_both)
        errors = [1e3 * np.sqrt(np.square(e).sum(axis=1).mean()) if e else np.nan for e in each]
        print(
            f"{range_m:8.1f} | {np.median(tracked):11.2f}  {np.median(full):14.2f}  {np.median(other):10.2f} | "
            f"{errors[0]:8.3f} {errors[1]:8.3f} {errors[2]:8.3f} | {len(errors_both)} of {count}"
        )


if __name__ == "__main__":
    main()
