"""LED layouts and boards over their ranges: poses that are solved, their errors over their sigmas, and OpenCV's errors.

python benchmarks/vmu_layouts.py [pairs]

pairs: of images of 1024 x 1024 for each layout and range, each by itself, without a track. solved: share with a whole
pose; position: with at least a position. error: RMS over the stated sigmas of all components, 1 if these are true.
OpenCV: RMS error of the position by solvePnP on the left image over that of the unit, on the pairs that both solved; it
gets the identities of the blobs from the truth and starts at the true pose. A board's corners are the same for both.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from vmu import OpenCv, geometry

from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.vmu.board_render import BoardRenderer
from hil.vmu.boards import apriltag, charuco
from hil.vmu.geometry import camera_pair, led_positions
from hil.vmu.render import RingAppearance, RingRenderer, projections
from hil.vmu.unit import VisionUnit

RINGS = ((4, 0.12), (6, 0.12), (9, 0.12), (16, 0.12), (16, 0.32))
"""Number of LEDs, and radius of the ring, m; in those of 16 neighbours are 33 and 88 mm apart at least."""
RAISED_M = 0.06
LED_RANGES_M = (0.3, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 20.0)
BOARD_RANGES_M = (0.3, 0.5, 1.0, 2.0, 3.0, 5.0)
BOARDS = {
    "apriltag, 4 of 80 mm": (apriltag, {"tags": [[k, 0.08, x, y] for k, (x, y) in enumerate(
        ((-0.07, -0.07), (0.07, -0.07), (0.07, 0.07), (-0.07, 0.07)))]}),
    "charuco, 7 x 5 of 40 mm": (charuco, {}),
}  # fmt: skip


def ring(n: int, radius_m: float) -> VmuGeometry:
    """Return the geometry with a ring of ``n`` LEDs, spread unevenly but for six, the first one raised."""
    angles = 2.0 * np.pi / n * (np.arange(n) if n == 6 else np.cumsum(np.linspace(0.7, 1.3, n)))
    leds = np.column_stack([radius_m * np.cos(angles), radius_m * np.sin(angles), np.zeros(n)])
    leds[0, 2] = -RAISED_M
    return geometry().model_copy(update={"leds_m": tuple(map(tuple, leds.tolist()))})


def pose(range_m: float, tilt: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return position, attitude and rotation vector of a target in both images."""
    t = np.array([0.1 + rng.uniform(-0.02, 0.02) * range_m, rng.uniform(-0.05, 0.05) * range_m, range_m])
    turn = np.array([*rng.uniform(-tilt, tilt, 2), rng.uniform(-3.0, 3.0)])
    return t, np.asarray(Rotation.from_rotvec(-turn).as_quat()), turn


def row(name: str, range_m: float, measure: Callable[[], tuple[str, Array | None, Array | None, Array | None]],
        count: int) -> None:  # fmt: skip
    """Print a row. measure: returns status, errors of a pose over its sigmas, its position's and OpenCV's error, m."""
    whole, placed, ratios, own, other = 0, 0, [], [], []
    for _ in range(count):
        status, ratio, error, theirs = measure()
        whole, placed = whole + (status == "ok"), placed + (status in ("ok", "ok_position"))
        if ratio is not None:
            ratios.append(ratio)
        if error is not None and theirs is not None:
            own.append(error)
            other.append(theirs)
    rms = np.sqrt(np.mean(np.square(ratios))) if ratios else np.nan
    against = np.sqrt(np.sum(np.square(other)) / np.sum(np.square(own))) if own else np.nan
    share = f"{100.0 * whole / count:6.0f} %  {100.0 * placed / count:6.0f} %"
    print(f"{name:24} {range_m:6.1f} | {share} | {rms:6.2f} | {against:6.1f}")


def of_leds(chosen: VmuGeometry, range_m: float, rng: np.random.Generator) -> Callable[[], tuple]:
    pair, leds, unit = camera_pair(chosen), led_positions(chosen), VisionUnit(chosen)
    renderer, opencv = RingRenderer(pair, leds, RingAppearance()), OpenCv(chosen)

    def measure() -> tuple:
        t, q, turn = pose(range_m, 0.2, rng)
        left, right = renderer.pair(t, q, None, rng)
        unit.track.drop()
        found = unit.solve(left, right, 0.0)
        theirs = opencv.solve((left, right), projections(pair, leds, t, q), turn, t)
        if found.pose is None:
            return found.status, None, None, None
        away = found.pose.t_v - t
        small = Rotation.from_quat(found.pose.q_vt) * Rotation.from_quat(q).inv()
        errors = np.concatenate([away, -small.as_rotvec()])
        ratio = errors / np.sqrt(np.diag(found.covariance))
        return found.status, ratio, away, None if theirs is None else theirs[0] - t

    return measure


def of_board(name: str, range_m: float, rng: np.random.Generator) -> Callable[[], tuple]:
    chosen = geometry()
    make, settings = BOARDS[name]
    pair, estimator = camera_pair(chosen), make(chosen, settings)
    renderer = BoardRenderer(pair, estimator.board, RingAppearance())
    matrix = np.array([[chosen.left.fx, 0, chosen.left.cx], [0, chosen.left.fy, chosen.left.cy], [0, 0, 1.0]])

    def measure() -> tuple:
        t, q, turn = pose(range_m, 0.4, rng)
        left, right = (renderer.image(c, t, q, rng) for c in range(2))
        found = estimator.solve(left, right, 0.0)
        if found.t_v is None:
            return found.status, None, None, None
        seen = next(filter(None, (read(estimator._detect(left)) for read in estimator._readers)))
        points = np.array([estimator._points[k] for k in seen])
        pixels = np.array(list(seen.values()))
        _, _, theirs = cv2.solvePnP(
            points, pixels, matrix, np.array(chosen.left.distortion), turn.copy(), t.copy(), True,
            cv2.SOLVEPNP_ITERATIVE,
        )  # fmt: skip
        away = found.t_v - t
        small = Rotation.from_quat(found.q_vt) * Rotation.from_quat(q).inv()
        ratio = np.concatenate([away, -small.as_rotvec()]) / np.sqrt(np.diag(found.covariance))
        return found.status, ratio, away, theirs[:, 0] - t

    return measure


def main(count: int) -> None:
    cv2.setNumThreads(1)
    VisionUnit(geometry()).warm_up()
    print("layout                   range,m |  solved  position |  error | OpenCV")
    for n, radius_m in RINGS:
        for range_m in LED_RANGES_M:
            measure = of_leds(ring(n, radius_m), range_m, np.random.default_rng(n))
            row(f"{n} LEDs, radius {radius_m} m", range_m, measure, count)
    for name in BOARDS:
        for range_m in BOARD_RANGES_M:
            row(name, range_m, of_board(name, range_m, np.random.default_rng(1)), count)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
