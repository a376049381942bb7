"""Cost of a frame of 768 x 576 in the docking monitor on one core: tracked, and searched in the whole image.

    python benchmarks/monitor.py [--frames 100]

Medians and best times, ms; other load on the machine affects the medians. One run on one machine.
"""

from __future__ import annotations

import argparse
import time

import cv2
import numpy as np

from hil.config.load import load_scene
from hil.config.scene import PixelNoise, Scene
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.render import Conditions, TargetRenderer, film
from hil.parts.monitor.sources import VideoFrame

RANGES_M = (1.4, 2.0, 4.0, 8.0, 14.0, 20.0, 35.0)


def frames_at(scene: Scene, d3: float, count: int) -> list[VideoFrame]:
    """Return the frames of a slow approach about ``d3``, m."""
    renderer = TargetRenderer(scene, conditions=Conditions(noise=PixelNoise(read=3.0)))
    rng = np.random.default_rng(1)
    return list(
        film(
            renderer,
            lambda t: (np.array([0.02 * d3, -0.02 * d3, d3 - 0.01 * d3 * t]), np.array([-0.02, -0.02, 0.03])),
            count,
            rng,
        )
    )


def main() -> None:
    """Print one row per range."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    scene = load_scene("atv").value
    print(f"{'range, m':>8s} {'status':>10s} {'followed, ms':>20s} {'frames/s':>9s} {'found, ms':>20s}")
    for d3 in RANGES_M:
        frames = frames_at(scene, d3, given.frames)
        monitor = DockingMonitor(scene)
        monitor.feed(frames[0])
        followed = []
        for frame in frames[1:]:
            start = time.perf_counter()
            monitor.feed(frame)
            followed.append(time.perf_counter() - start)
        found = []
        for frame in frames[:20]:
            fresh = DockingMonitor(scene)
            start = time.perf_counter()
            fresh.feed(frame)
            found.append(time.perf_counter() - start)
        follow, find = 1e3 * np.array(followed), 1e3 * np.array(found[1:])
        status = monitor.last.status if monitor.last is not None else ""
        print(
            f"{d3:8.1f} {status:>10s} {np.median(follow):8.2f} (best {follow.min():5.2f})"
            f" {1e3 / np.median(follow):9.0f} {np.median(find):8.1f} (best {find.min():5.1f})"
        )


if __name__ == "__main__":
    main()
