"""Cost of a stereo pair of 1024 x 1024, and of OpenCV's SimpleBlobDetector and solvePnP on the same images.

python benchmarks/vmu.py [images]

One thread, processor time. tracked: in windows about the predicted LEDs. full frame: the whole images,
without a predicted pose. OpenCV gets the identities of the blobs from the truth and starts at the true pose; left
camera only, as in solvePnP. Freed memory stays with the process: else the buffers that OpenCV allocates for each
image cost seven times as much as its computation.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy, as `hil` does: idle threads spin, and would count

import ctypes
import sys
import time
from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.vmu.geometry import EXACT, camera_pair, led_positions
from hil.vmu.render import Extras, Light, RingAppearance, RingRenderer, projections
from hil.vmu.unit import VisionUnit

REPEATS = 7
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


def blob_detector() -> cv2.SimpleBlobDetector:
    chosen = cv2.SimpleBlobDetector.Params()
    chosen.filterByColor, chosen.blobColor = True, 255
    chosen.minThreshold, chosen.maxThreshold, chosen.thresholdStep = 20, 250, 10
    chosen.filterByArea, chosen.minArea, chosen.maxArea = True, 3, 20000
    chosen.filterByCircularity = chosen.filterByConvexity = chosen.filterByInertia = False
    chosen.minDistBetweenBlobs, chosen.minRepeatability = 4, 2
    return cv2.SimpleBlobDetector.create(chosen)


class OpenCv:
    """Blobs of both images, then solvePnP on the left ones."""

    def __init__(self, chosen: VmuGeometry) -> None:
        camera = chosen.left
        self._matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        self._distortion = np.array(camera.distortion)
        self._leds = led_positions(chosen)
        self._detector = blob_detector()

    def solve(self, left: np.ndarray, right: np.ndarray, places: Array, turn: Array, t: Array) -> Array | None:
        self._detector.detect(right)
        blobs = np.array([blob.pt for blob in self._detector.detect(left)]).reshape(-1, 2)
        if len(blobs) < len(self._leds):
            return None
        away = np.hypot(*(blobs[None] - places[:, None]).transpose(2, 0, 1))
        if away.min(axis=1).max() > 3.0:
            return None
        seen = blobs[away.argmin(axis=1)]
        _, _, found = cv2.solvePnP(
            self._leds, seen, self._matrix, self._distortion, turn.copy(), t.copy(), True, cv2.SOLVEPNP_ITERATIVE
        )
        return found[:, 0]


def main(count: int) -> None:
    cv2.setNumThreads(1)
    for option in (-1, -3):  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD of glibc
        ctypes.CDLL(None).mallopt(option, 1 << 30)
    chosen, rng = geometry(), np.random.default_rng(0)
    pair, leds = camera_pair(chosen), led_positions(chosen)
    renderer, unit, opencv = RingRenderer(pair, leds, RingAppearance()), VisionUnit(chosen), OpenCv(chosen)
    unit.warm_up()
    print(
        "range, m | tracked, ms  full frame, ms  OpenCV, ms | RMS error of position, mm: here, OpenCV | found by OpenCV"
    )
    for range_m in (1.0, 2.0, 4.0, 8.0, 12.0):
        tracked, full, other, own_error, other_error = [], [], [], [], []
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
            places = projections(pair, leds, t, q)[0]
            other.append(median_ms(lambda: opencv.solve(left, right, places, turn, t)))  # noqa: B023
            found = opencv.solve(left, right, places, turn, t)
            if found is not None:
                other_error.append(found - t)
        errors = [1e3 * np.sqrt(np.square(e).sum(axis=1).mean()) if e else np.nan for e in (own_error, other_error)]
        print(
            f"{range_m:8.1f} | {np.median(tracked):11.2f}  {np.median(full):14.2f}  {np.median(other):10.2f} | "
            f"{errors[0]:8.3f} {errors[1]:8.3f} | {len(other_error)} of {count}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
