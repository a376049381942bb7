"""Rendered approach as a video with its truth, as input for ``hil monitor``.

python sims/monitor_film.py approach.mkv truth.csv [--scene atv] [--start-m 9] [--rate-mps -0.12] [--pictures 150]
hil monitor approach.mkv --scene atv --out motion.csv --screen screen.png
"""

from __future__ import annotations

import argparse
import csv

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.config.load import load_scene
from hil.config.scene import PixelNoise
from hil.monitor.kernels.quantities import quantities
from hil.monitor.render import Conditions, TargetRenderer
from hil.monitor.results import QUANTITIES

Floats = NDArray[np.float64]

SWAYS = (  # size, m or rad, period, s, and phase of each of d and phi
    (0.25, 60.0, 0.3), (0.2, 70.0, 1.9), (0.0, 1.0, 0.0), (0.012, 40.0, 1.0), (0.012, 45.0, 2.0), (0.03, 60.0, 0.0),
)  # fmt: skip


def motion(t_s: float, start_m: float, rate_mps: float) -> Floats:
    """Return (12,): d1, d1', ... phi3' of an approach with a slow sway."""
    w = np.zeros(12)
    sways = (
        (0.25, 20.0, 0.3),
        (0.2, 26.0, 1.9),
        (0.0, 1.0, 0.0),
        (0.012, 17.0, 1.0),
        (0.012, 21.0, 2.0),
        (0.03, 30.0, 0.0),
    )
    for i, (size, period_s, phase) in enumerate(sways):
        omega = 2.0 * np.pi / period_s
        w[2 * i] = size * np.sin(omega * t_s + phase)
        w[2 * i + 1] = size * omega * np.cos(omega * t_s + phase)
    w[4], w[5] = start_m + rate_mps * t_s, rate_mps
    return w


def main() -> None:
    """Render and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video")
    parser.add_argument("truth")
    parser.add_argument("--scene", default="atv")
    parser.add_argument("--start-m", type=float, default=9.0)
    parser.add_argument("--rate-mps", type=float, default=-0.12)
    parser.add_argument("--pictures", type=int, default=150)
    parser.add_argument("--noise", type=float, default=3.0)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    scene = load_scene(given.scene).value
    renderer = TargetRenderer(scene, conditions=Conditions(noise=PixelNoise(read=given.noise)))
    rng = np.random.default_rng(given.seed)
    size = (scene.camera.width, scene.camera.height)
    writer = cv2.VideoWriter(given.video, cv2.VideoWriter.fourcc(*"FFV1"), scene.fps, size, isColor=False)
    with open(given.truth, "w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("frame", "t_s", *QUANTITIES))
        out = np.empty(12)
        for number in range(given.pictures):
            t_s = number / scene.fps
            w = motion(t_s, given.start_m, given.rate_mps)
            quantities(w, out)
            rows.writerow((number, f"{t_s:.4f}", *(f"{value:.9f}" for value in out)))
            writer.write(renderer.image(w[0:6:2], w[6::2], t_s, rng))
    writer.release()


if __name__ == "__main__":
    main()
