"""Pose estimator for hil: five AprilTags on a board, in two calibrated cameras, jointly by least squares."""

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hil.vmu.boards import refined
from hil.vmu.estimators import FlatTarget, PoseEstimate

TAGS = {0: (0.06, 0.0), 1: (0.14, -0.12), 2: (0.14, 0.12), 3: (0.36, -0.42), 4: (0.36, 0.42)}  # number: side, x, m
CORNER_PX, CALIBRATION_PX, PER_M, SIZE_M = 0.1, 0.05, 3000, (1.3, 0.5)


class BoardEstimator:
    """Solves a pair; ``board`` is what emulated cameras draw."""

    def __init__(self, geometry, settings):
        tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36H11)
        self.detector = cv2.aruco.ArucoDetector(tags)
        self.lenses = [
            (np.array([[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]]), np.array(c.distortion))
            for c in (geometry.left, geometry.right)
        ]
        self.turn, self.base = Rotation.from_rotvec(geometry.right_rotation_rad).inv(), np.array(geometry.baseline_m)
        wide, high = (round(PER_M * size) for size in SIZE_M)
        picture, self.points = np.full((high, wide), 255, np.uint8), np.zeros((4 * len(TAGS), 3))
        for k, (side, x) in TAGS.items():
            square = 0.5 * side * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
            self.points[4 * k : 4 * k + 4] = square + np.array([x, 0.0, 0.0])
            pixels = round(PER_M * side)
            u, v = (wide - pixels) // 2 + round(PER_M * x), (high - pixels) // 2
            picture[v : v + pixels, u : u + pixels] = tags.generateImageMarker(k, pixels)
        self.board = FlatTarget(picture, *SIZE_M)

    def warm_up(self):
        """OpenCV compiles nothing."""

    def project(self, side, ids, x):
        """Return the pixels (n, 2) of corners in a camera, for x: rotation vector and position of the board."""
        p = Rotation.from_rotvec(x[:3]).apply(self.points[ids]) + x[3:]
        p = self.turn.apply(p - self.base) if side else p
        return cv2.projectPoints(p, np.zeros(3), np.zeros(3), *self.lenses[side])[0].reshape(-1, 2)

    def find(self, image):
        """Return numbers and pixels (n, 2) of the corners in an image."""
        quads, tags, _ = ((), None, ()) if image is None else self.detector.detectMarkers(image)
        ids, pixels = [], []
        for quad, k in zip(quads, np.ravel(tags), strict=False):
            corners = refined(image, np.reshape(quad, (4, 2)), 8) if k in TAGS else None
            if corners is not None:
                ids += range(4 * k, 4 * k + 4)
                pixels += corners.tolist()
        return ids, np.reshape(pixels, (-1, 2))

    def solve(self, left, right, t_s):
        """Return the pose by the images (h, w), uint8, at t_s; None for a missing image."""
        found = [self.find(image) for image in (left, right)]
        if min(len(ids) for ids, _ in found) < 4:
            return PoseEstimate(t_s, "too_few")
        (ids, pixels), lens = found[0], self.lenses[0]
        _, turn, place = cv2.solvePnP(self.points[ids], pixels, *lens, flags=cv2.SOLVEPNP_IPPE)

        def residuals(x):
            return (
                np.concatenate([(self.project(s, *f[:1], x) - f[1]).ravel() for s, f in enumerate(found)]) / CORNER_PX
            )

        fit = least_squares(residuals, np.concatenate([turn.ravel(), place.ravel()]), x_scale="jac")
        turn, t_v = Rotation.from_rotvec(fit.x[:3]), fit.x[3:]
        if 2.0 * fit.cost > 4.0 * len(fit.fun) or not t_v[2] > 0.0:
            return PoseEstimate(t_s, "rejected_no_match")
        step = 1e-6 * np.eye(3)  # the covariance is of the position and of a small rotation about v's axes
        slope = np.array([(Rotation.from_rotvec(fit.x[:3] + d) * turn.inv()).as_rotvec() for d in step]).T / 1e-6
        change = np.block([[np.zeros((3, 3)), np.eye(3)], [slope, np.zeros((3, 3))]])
        noise = change @ np.linalg.inv(fit.jac.T @ fit.jac) @ change.T
        whole = noise.copy()  # with an error of the calibration: of the disparity, alike in all images
        range_sigma_m = CALIBRATION_PX * t_v[2] ** 2 / (lens[0][0, 0] * np.linalg.norm(self.base))
        whole[:3, :3] += range_sigma_m**2 * np.outer(t_v, t_v) / (t_v @ t_v)
        return PoseEstimate(t_s, "ok", t_v, turn.inv().as_quat(), whole, noise)
