"""Errors of the disc's centre and radius and of the cross' centre in pixels, compared with the bound and with OpenCV.

    python sims/monitor_pixels.py [--pictures 200]

The bound is that of edges between known grey values, blurred by a known Gaussian, in white noise: a length of edge
carries the information ``c^2 / (2 sqrt(pi) b s^2)`` per pixel about its position (c: contrast, b: blur, s: noise). A
circle of radius R has ``sigma_R = (2 pi R I)^-1/2`` and ``sqrt(2)`` times that for each coordinate of its centre.
OpenCV: HoughCircles on the smoothed image and fitEllipse on the disc's border at Otsu's threshold, both in a
square about the disc. All use the same images, with the disc head-on so that its image is a circle.
"""

from __future__ import annotations

import argparse
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.config.load import load_scene
from hil.config.scene import PixelNoise, Scene
from hil.parts.monitor.render import Conditions, TargetRenderer
from hil.parts.monitor.settings import MonitorSettings
from hil.parts.monitor.sources import VideoFrame
from sims.monitor_paper import PaperTracker

Floats = NDArray[np.float64]
BLUR_PX = 0.8


def truth_px(scene: Scene, d: Floats) -> Floats:
    """Return u, v, radius of the disc and u, v of the cross' centre for a camera at d without rotation, px."""
    f, target = scene.camera.f, scene.target
    assert target.disc is not None
    assert target.cross is not None
    near = d[2] - target.cross.offset_m
    cx, cy = scene.camera.cx, scene.camera.cy
    return np.array([
        cx - f * d[0] / d[2], cy - f * d[1] / d[2], f * target.disc.radius_m / d[2],
        cx - f * d[0] / near, cy - f * d[1] / near,
    ])  # fmt: skip


def bound_px(scene: Scene, d3: float, noise: float) -> Floats:
    """Return the bound's sigmas of the same five."""
    target, f = scene.target, scene.camera.f
    assert target.disc is not None
    assert target.cross is not None
    assert target.plate is not None
    blur = math.sqrt(BLUR_PX**2 + 1.0 / 12.0)

    def information(contrast: float) -> float:
        return contrast**2 / (2.0 * math.sqrt(math.pi) * blur * noise**2)

    radius = f * target.disc.radius_m / d3
    disc = information(target.disc.level - target.plate.level)
    bar = information(target.disc.level - target.cross.level)
    length = 2.0 * (2.0 * target.cross.arm_length_m - target.cross.arm_width_m) * f / (d3 - target.cross.offset_m)
    centre, cross = 1.0 / math.sqrt(math.pi * radius * disc), 1.0 / math.sqrt(length * bar)
    return np.array([centre, centre, 1.0 / math.sqrt(2.0 * math.pi * radius * disc), cross, cross])


def by_opencv(image: NDArray[np.uint8], truth: Floats) -> tuple[Floats | None, Floats | None]:
    """Return u, v, radius by HoughCircles and by fitEllipse in a square of 1.3 radii about the disc."""
    half = 1.3 * truth[2]
    left, top = max(int(truth[0] - half), 0), max(int(truth[1] - half), 0)
    patch = np.ascontiguousarray(image[top : int(truth[1] + half) + 1, left : int(truth[0] + half) + 1])
    offset = np.array([left, top, 0.0])
    smooth = cv2.GaussianBlur(patch, (0, 0), 1.0)
    low, high = max(int(0.85 * truth[2]), 3), int(1.15 * truth[2]) + 1
    circles = cv2.HoughCircles(
        smooth, cv2.HOUGH_GRADIENT, 1, 4 * truth[2], param1=120, param2=15, minRadius=low, maxRadius=high
    )
    hough = None if circles is None else np.asarray(circles, float).reshape(-1, 3)[0] + offset
    _, binary = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    contours = cv2.findContours(binary, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    ellipse = None
    if contours:
        border = max(contours, key=len)
        if len(border) >= 5:
            (u, v), (one, two), _ = cv2.fitEllipse(border)
            ellipse = np.array([u, v, 0.25 * (one + two)]) + offset
    return hough, ellipse


def study(scene: Scene, d3: float, noise: float, pictures: int) -> dict[str, Floats]:
    """Return the errors (n, 5) or (n, 3) of each method, px."""
    renderer = TargetRenderer(scene, conditions=Conditions(blur_px=BLUR_PX, noise=PixelNoise(read=noise)))
    errors: dict[str, list[Floats]] = {
        "one feature alone": [],
        "all features": [],
        "HoughCircles": [],
        "fitEllipse": [],
    }
    for number in range(pictures):
        rng = np.random.default_rng([number, int(1000 * d3)])
        d = np.array([*(rng.uniform(-0.03, 0.03, 2) * d3), d3 * rng.uniform(0.97, 1.03)])
        phi = np.array([0.0, 0.0, rng.uniform(-0.1, 0.1)])
        image = renderer.image(d, phi, 0.0, rng)
        true = truth_px(scene, d)
        # roll about the optical axis rotates the position of the disc in the image
        c, s = math.cos(phi[2]), math.sin(phi[2])
        axis = np.array([scene.camera.cx, scene.camera.cy])
        turn = np.array([[c, -s], [s, c]])
        true[:2], true[3:] = axis + turn @ (true[:2] - axis), axis + turn @ (true[3:] - axis)
        tracker = PaperTracker(scene, MonitorSettings())
        look = tracker.process(VideoFrame(0, 0.0, image))
        if tracker.paper is not None and look.detection.disc is not None and look.detection.cross is not None:
            v = tracker.paper.values
            alone = np.array([axis[0] + v[3], axis[1] - v[4], v[5], axis[0] + v[0], axis[1] - v[1]])
            errors["one feature alone"].append(alone - true)
            errors["all features"].append(np.array([*look.detection.disc, *look.detection.cross[:2]]) - true)
        hough, ellipse = by_opencv(image, true)
        if hough is not None:
            errors["HoughCircles"].append(hough - true[:3])
        if ellipse is not None:
            errors["fitEllipse"].append(ellipse - true[:3])
    return {name: np.array(rows) for name, rows in errors.items()}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=200)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    scene = load_scene("atv").value
    print("root mean square errors, px; centres by coordinate")
    for d3, noise in ((3.0, 3.0), (8.0, 1.0), (8.0, 3.0), (8.0, 8.0), (14.0, 3.0)):
        bound = bound_px(scene, d3, math.sqrt(noise**2 + 1.0 / 12.0))
        print(f"\n{d3:g} m, noise {noise:g} grey values")
        print(
            f"{'':20s} {'n':>4s} {'disc centre':>12s} {'radius':>9s} {'cross centre':>13s} {'mean radius error':>18s}"
        )
        print(f"{'bound':20s} {'':4s} {bound[0]:12.5f} {bound[2]:9.5f} {bound[3]:13.5f}")
        for name, rows in study(scene, d3, noise, given.pictures).items():
            if len(rows) == 0:
                print(f"{name:20s} {0:4d}")
                continue
            rms = np.sqrt(np.mean(rows**2, axis=0))
            cross = f"{math.hypot(rms[3], rms[4]) / math.sqrt(2.0):13.5f}" if rows.shape[1] == 5 else f"{'-':>13s}"
            centre = math.hypot(rms[0], rms[1]) / math.sqrt(2.0)
            print(f"{name:20s} {len(rows):4d} {centre:12.5f} {rms[2]:9.5f} {cross} {rows[:, 2].mean():+18.5f}")


if __name__ == "__main__":
    main()
