"""Time and accuracy of the vision unit's detector and of OpenCV's SimpleBlobDetector, on the same images.

python benchmarks/vmu_detect.py [--range-m 3.0 ...]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np

from hil.core.messages import Array
from hil.vmu.detect import SpotDetector
from hil.vmu.kernels.lens import LENS, CameraPair
from hil.vmu.render import Extras, HotPixel, Light, RingAppearance, RingRenderer, projections

SIZE, IMAGES, REPEATS = 1024, 12, 7
RING = [(0.12 * np.cos(a), 0.12 * np.sin(a), 0.0) for a in np.arange(6) * np.pi / 3.0]
LEDS = np.array(RING) - np.array([[0.0, 0.0, 0.06]] + [[0.0] * 3] * 5)
STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0])
LOOK = RingAppearance(hot_pixels=tuple(HotPixel(0, u, 37 + 2 * u % 900) for u in (50, 333, 600, 801, 990)))


def cameras() -> CameraPair:
    lens = np.zeros(2, LENS)
    lens["fx"] = lens["fy"] = 1200.0
    lens["cx"] = lens["cy"] = 511.5
    lens["width"] = lens["height"] = SIZE
    return CameraPair(lens, np.stack([np.eye(3)] * 2), np.array([[0.0] * 3, [-0.2, 0.0, 0.0]]))


def cost_ms(call: Callable[[Array], object], images: list[Array]) -> float:
    """Return the minimum over the repeats of the mean processor time of ``call`` per image, ms."""
    for image in images:
        call(image)
    means = []
    for _ in range(REPEATS):
        start = time.thread_time()
        for image in images:
            call(image)
        means.append((time.thread_time() - start) / len(images))
    return 1e3 * min(means)


def blob_detector() -> cv2.SimpleBlobDetector:
    wanted = cv2.SimpleBlobDetector_Params()
    wanted.minThreshold, wanted.maxThreshold, wanted.thresholdStep = 18, 220, 10
    wanted.filterByColor, wanted.blobColor = True, 255
    wanted.filterByArea, wanted.minArea, wanted.maxArea = True, 2, 4000
    wanted.filterByCircularity = wanted.filterByConvexity = wanted.filterByInertia = False
    wanted.minDistBetweenBlobs, wanted.minRepeatability = 3, 1
    return cv2.SimpleBlobDetector.create(wanted)


def missed_and_error(found: list[Array], places: list[Array]) -> tuple[int, int, float]:
    """Return the number of missed LEDs, the number of other detected lights, and the RMS error of the rest, px."""
    missed, others, squares = 0, 0, []
    for spots, leds in zip(found, places, strict=True):
        others += len(spots)
        for place in leds:
            distance = np.hypot(*(spots - place).T) if len(spots) else np.array([np.inf])
            if distance.min() > 2.0:
                missed += 1
            else:
                others -= 1
                squares += list((spots[distance.argmin()] - place) ** 2)
    return missed, others, float(np.sqrt(np.mean(squares))) if squares else float("nan")


def measure(range_m: float) -> None:
    rng = np.random.default_rng(1)
    pair, detector, blobs = cameras(), SpotDetector((SIZE, SIZE)), blob_detector()
    renderer = RingRenderer(pair, LEDS, LOOK)
    images, places, windows = [], [], []
    for _ in range(IMAGES):
        t_v = np.array([0.1, 0.0, range_m]) + rng.uniform(-0.01, 0.01, 3)
        lights = [Light(tuple(range_m * np.array([*rng.uniform(-0.3, 0.3, 2), 1.0]))) for _ in range(2)]
        images.append(renderer.image(0, t_v, STRAIGHT, None, rng, Extras(lights=lights)))
        seen = projections(pair, LEDS, t_v, STRAIGHT)[0]
        places.append(seen[(seen.min(axis=1) > 12.0) & (seen.max(axis=1) < SIZE - 12.0)])
        half = 12.0 + 12.0 / range_m
        windows.append(np.hstack([seen - half, seen + half]))
    drawing = cost_ms(lambda _: renderer.image(0, t_v, STRAIGHT, None, rng), images)
    # one window for all images: the target hardly moves
    full, tracked = cost_ms(detector.spots, images), cost_ms(lambda i: detector.spots(i, windows[0]), images)
    blob = cost_ms(blobs.detect, images)
    own = [np.column_stack([s["u"], s["v"]]) for s in map(detector.spots, images)]
    theirs = [np.array([k.pt for k in blobs.detect(image)]).reshape(-1, 2) for image in images]
    print(
        f"{range_m:5.1f} m  full {full:6.2f} ms  tracked {tracked:6.2f} ms  "
        f"blobs {blob:6.2f} ms  draw {drawing:5.2f} ms"
    )
    for name, found in (("hil", own), ("SimpleBlobDetector", theirs)):
        missed, others, error = missed_and_error(found, places)
        print(
            f"         {name:19} missed {missed:3d} of {sum(map(len, places))}, others {others:3d}, RMS {error:.4f} px"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--range-m", type=float, nargs="*", default=[0.5, 0.7, 1.0, 2.0, 3.0, 6.0, 9.0, 12.0])
    cv2.setNumThreads(1)
    print(f"{SIZE} x {SIZE}, one camera, processor time of one core; 2 other lights, 5 hot pixels")
    for given in parser.parse_args().range_m:
        measure(given)
