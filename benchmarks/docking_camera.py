"""Images per second of the rendered docking camera, on one core: drawing, and with light and noise.

python benchmarks/docking_camera.py [images]
"""

from __future__ import annotations

import sys
import time

import cv2
import numpy as np

from hil.config.load import load_scene
from hil.monitor.render import Conditions, Glare, TargetRenderer

PICTURES = int(sys.argv[1]) if len(sys.argv) > 1 else 100


def main() -> None:
    """Print a table of times."""
    cv2.setNumThreads(1)
    phi = np.array([0.01, -0.01, 0.02])
    glare = Conditions(glare=(Glare((0.5, 0.3, 0.0), 300.0, 15.0),))
    print(f"{'scene':14}{'range, m':>10}{'draw, ms':>10}{'whole, ms':>11}{'with glare':>12}")
    for name in ("atv", "bright-cross"):
        scene = load_scene(name).value
        for range_m in (1.5, 5.0, 10.0, 30.0):
            d = np.array([0.05, -0.03, 1.0]) * range_m
            plain, shining = TargetRenderer(scene), TargetRenderer(scene, conditions=glare)
            rng = np.random.default_rng(0)
            draw = _median_ms(lambda plain=plain, d=d: plain.draw(d, phi))
            whole = _median_ms(lambda plain=plain, d=d, rng=rng: plain.image(d, phi, 0.0, rng))
            lit = _median_ms(lambda shining=shining, d=d, rng=rng: shining.image(d, phi, 0.0, rng))
            print(f"{name:14}{range_m:10.1f}{draw:10.2f}{whole:11.2f}{lit:12.2f}")


def _median_ms(call: object) -> float:
    assert callable(call)
    call()
    times = []
    for _ in range(PICTURES):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


if __name__ == "__main__":
    main()
